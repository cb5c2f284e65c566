
import numpy as np
import pytest

from vemlight.sampler.light_map import light_map
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from vemlight.sampler.required_lights import ladder, prefix_errors, required_lights
from vemlight.sampler.warps.points import points
from vemlight.sampler.warps.warp import warp_from_map


def sky(sun=0.0, seed=1):
    theta = (np.arange(90) + 0.5) * np.pi / 180
    phi = (np.arange(360) + 0.5) * np.pi / 180
    gray = (1 + 0.5 * np.sin(theta)[:, None]) * (1.1 + np.cos(phi + seed)[None, :])
    gray[50:52, 200:202] += sun
    return np.repeat(gray[..., None], 3, axis=2).astype(np.float32)


def drawn(radiance, count):
    light = light_map(radiance, "hemisphere")
    samples = warp_from_map(light, "havran-azimuth").sample(points(count, "disc"))
    return light, samples.directions, samples.radiance / samples.density[:, None] / np.maximum(light.irradiance, 1e-30)


@pytest.mark.parametrize("sun", [0.0, 1e3, 1e5])
def test_the_error_of_blocks_is_that_of_single_cells_to_3_per_cent(sun):
    # By hand, every cell of the map one by one; the quick form takes blocks of 3 degrees except for hot cells.
    light, directions, tint = drawn(sky(sun), 64)
    at = probes(96, "hemisphere")
    truth = irradiance_of_map(at, light.radiance, "hemisphere")
    sizes, quick = ladder(64), prefix_errors(light, directions, tint)
    for size, error in zip(sizes, quick, strict=True):
        irradiance = tint[:size] * light.irradiance
        got = irradiance_of_lights(at, directions[:size], irradiance / irradiance.sum(axis=0) * light.irradiance)
        exact = np.sqrt((((got - truth) / (truth + 0.05 * truth.mean())) ** 2).mean())
        assert error == pytest.approx(exact, rel=0.03, abs=0.003)


def overcast():
    """The CIE's overcast sky, three times as bright at the zenith as at the horizon."""
    gray = (1 + 2 * np.cos((np.arange(90) + 0.5) * np.pi / 180)) / 3
    return np.repeat(np.repeat(gray[:, None, None], 360, axis=1), 3, axis=2).astype(np.float32)


def courtyard(sun):
    """Walls of 25 to 45 degrees, bright where the sun shines on them, and a blue sky above."""
    theta, phi = (np.arange(90) + 0.5) * np.pi / 180, (np.arange(360) + 0.5) * np.pi / 180
    wall = theta[:, None] > np.radians(55 + 10 * np.sin(3 * phi))
    gray = np.where(wall, 0.1 + 0.6 * np.maximum(-np.cos(phi), 0), 0.6 * overcast()[..., 0])
    gray[40:42, 10:12] += sun
    return np.repeat(gray[..., None], 3, axis=2).astype(np.float32)


def test_an_overcast_sky_takes_far_fewer_lights_than_a_sunlit_courtyard():
    for error, times in ((0.2, 2.0), (0.15, 1.8), (0.1, 1.8)):
        assert required_lights(*drawn(courtyard(3e4), 1024), error) >= times * required_lights(*drawn(overcast(), 1024), error)


def test_every_larger_prefix_is_within_the_error_limit():
    for seed in range(6):
        light, directions, tint = drawn(sky(300.0 * seed, seed), 512)
        count = required_lights(light, directions, tint, 0.15)
        errors, sizes = prefix_errors(light, directions, tint), ladder(512)
        aim = 0.85 * 0.15
        assert (errors[sizes >= count] <= aim).all()
        assert count == 4 or errors[np.flatnonzero(sizes == count)[0] - 1] > aim
        # A number in use stays while it is within the error itself, and not a step longer.
        worst = np.maximum.accumulate(errors[::-1])[::-1]
        for size, error in zip(sizes[sizes < count], worst[sizes < count], strict=True):
            assert required_lights(light, directions, tint, 0.15, int(size)) == (size if error <= 0.15 else count)
        assert required_lights(light, directions, tint, 0.15, 512) == count


def test_an_unreachable_limit_takes_all_lights_and_a_black_map_takes_one():
    assert required_lights(*drawn(sky(1e4), 32), error=1e-4) == 32
    assert required_lights(*drawn(np.zeros((90, 360, 3), np.float32), 32), error=0.1) == 1


@pytest.mark.parametrize("most", [1, 2, 4, 5, 72, 1000])
def test_the_ladder_ends_where_it_should(most):
    sizes = ladder(most)
    assert sizes[-1] == most
    assert (np.diff(sizes) > 0).all()


def test_the_ladder_has_four_steps_an_octave_from_four_on():
    assert ladder(32).tolist() == [4, 5, 6, 7, 8, 10, 11, 13, 16, 19, 23, 27, 32]
