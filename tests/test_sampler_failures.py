"""What happens where the method is not at home: each case with its defined answer, for every method and filter that it concerns."""

from functools import partial
from typing import Literal

import numpy as np
import pytest

from vemlight.light.sphere import angle_between, direction_from_angles, map_irradiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import score
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler as Settings

Sampler = partial(Settings, method="havran-azimuth")  # the filters, gloss set and clusters of 2005

ROWS, COLS = 45, 180  # cells of 2 degrees
METHODS = ["havran-azimuth", "havran-radius", "standard"]
FILTERS: tuple[Literal["fir2005", "fir", "binomial", "iir", "none"], ...] = ("fir2005", "fir", "binomial", "iir", "none")
SKY = np.ones((ROWS, COLS, 3), np.float32)


def lamp(theta_deg, phi_deg, radiance, base=SKY):
    out = base.copy()
    out[int(theta_deg // 2) % ROWS, int(phi_deg // 2) % COLS] += radiance
    return out


def run(maps, settings, fps=25.0, times=None):
    state, lights, reports = initial_state(), [], []
    for k, radiance in enumerate(maps):
        state, now, report = step(settings, state, SamplerInput(radiance, "hemisphere", k / fps if times is None else times[k]))
        assert np.isfinite(now.directions).all()
        assert np.isfinite(now.irradiance).all()
        assert (now.irradiance >= 0).all()
        np.testing.assert_allclose(np.linalg.norm(now.directions, axis=1), 1, atol=1e-5)
        assert now.directions[:, 2].min() > -1e-6
        lights.append(now)
        reports.append(report)
    return lights, reports


def totals(lights):
    return np.array([one.irradiance.sum(axis=0, dtype=float) for one in lights])


@pytest.mark.parametrize("filter", FILTERS)
def test_black_frames_amid_light_darken_and_do_not_move(filter):
    black = np.zeros_like(SKY)
    maps = [lamp(40, 100, 500.0)] * 12 + [black] + [lamp(40, 100, 500.0)] * 12
    lights, _ = run(maps, Sampler(filter=filter))
    for one in lights[12:]:
        np.testing.assert_allclose(one.directions, lights[11].directions, atol=2e-3)
    power = totals(lights)[:, 1]
    assert power[12 + {"fir2005": 4, "fir": 4, "binomial": 2, "iir": 0, "none": 0}[filter]] < 0.9 * power[0]
    assert power[-1] == pytest.approx(power[0], rel=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_sun_a_million_times_its_sky_takes_all_lights_but_the_floors(method):
    maps = [lamp(40, 100, 1e6)] * 3
    lights, _ = run(maps, Sampler(method=method, filter="none", count=216))
    near = angle_between(lights[-1].directions.astype(float), direction_from_angles(np.radians(41), np.radians(101))) < np.radians(3)
    assert near.mean() > 0.98
    np.testing.assert_allclose(totals(lights)[-1], map_irradiance(maps[0], "hemisphere"), rtol=1e-6)


def passing(path, steps=40, radiance=1e4):
    """A sun of one cell on a path (theta, phi) in degrees, drawn over the four nearest cells, so that it moves without steps."""
    maps = []
    for k in range(steps):
        theta, phi = path(k / (steps - 1))
        row, col = theta / 2 - 0.5, phi / 2 - 0.5
        out = SKY.copy()
        for i, down in ((int(np.floor(row)), 1 - row % 1), (int(np.floor(row)) + 1, row % 1)):
            for j, across in ((int(np.floor(col)), 1 - col % 1), (int(np.floor(col)) + 1, col % 1)):
                turned = j if i >= 0 else j + COLS // 2  # beyond the zenith lies the opposite side
                out[max(i, -1 - i), turned % COLS] += radiance * down * across / max(np.sin(np.radians(abs(theta))), 0.02)
        maps.append(out)
    return maps


@pytest.mark.parametrize("filter", ["fir2005", "none"])
def test_a_sun_through_azimuth_zero_moves_few_others(filter):
    maps = passing(lambda t: (50, (340 + 40 * t) % 360))
    settings = Sampler(filter=filter, count=216)
    lights, _ = run(maps, settings)
    result = score(zip(maps, lights, strict=True))
    assert result.motion_deg < 2.0
    assert result.jumps < 3.0  # of 216
    assert result.births == result.deaths == 0


@pytest.mark.parametrize("filter", ["fir2005", "none"])
def test_a_sun_through_the_zenith_stays_one_sun(filter):
    maps = passing(lambda t: (20 - 40 * t, 90) if t < 0.5 else (40 * t - 20, 270))
    lights, _ = run(maps, Sampler(filter=filter, count=72))
    late = 4 if filter == "fir2005" else 0
    for k in range(late, 40):
        height = 20 - 40 * (k - late) / 39
        sun = direction_from_angles(np.radians(abs(height)), np.radians(90 if height > 0 else 270))
        strength = lights[k].irradiance[:, 1].astype(float)
        near = angle_between(lights[k].directions.astype(float), sun) < np.radians(12)
        # Filtered, a light half of whose past lies on either side of the zenith is as wide as the way of nine frames, 8 degrees.
        assert strength[near].sum() > (0.4 if late else 0.5) * strength.sum()


@pytest.mark.parametrize("filter", FILTERS)
def test_a_lamp_switched_off_and_on_settles_within_the_filters_length(filter):
    on, off = lamp(40, 100, 5e3), SKY
    lights, reports = run([on] * 15 + [off] * 15 + [on] * 15, Sampler(filter=filter))
    power = totals(lights)[:, 0]
    want = [float(map_irradiance(m, "hemisphere")[0]) for m in (on, off)]
    settled = 12  # frames: three delays of the slowest filter
    assert power[14 + settled + 1] == pytest.approx(want[1], rel=0.02)
    assert power[29 + settled + 1] == pytest.approx(want[0], rel=0.02)
    assert reports[-1].delay_frames <= 4
    assert power.max() <= 1.2 * want[0]  # the equiripple filters overshoot by 6 %, the others not at all


def fractions_at_opposite_lamps(settings, radius_deg: float) -> list[float]:
    """Of the power, within that radius of two equal lamps on opposite sides of a dark sky."""
    maps = [lamp(60, 0, 1e5, lamp(60, 180, 1e5, SKY * np.float32(1e-3)))] * 12
    lights = run(maps, settings)[0][-1]
    power = lights.irradiance[:, 1].astype(float)
    lamps = direction_from_angles(np.radians(61), np.radians([1.0, 181.0]))
    angles = [angle_between(lights.directions.astype(float), at) for at in lamps]
    return [power[angle < np.radians(radius_deg)].sum() / power.sum() for angle in angles]


@pytest.mark.parametrize("filter", ["fir2005", "none"])
@pytest.mark.parametrize("method", METHODS)
def test_two_opposite_equal_lamps_get_half_of_the_lights_each_and_none_lies_between(method, filter):
    assert fractions_at_opposite_lamps(Sampler(method=method, filter=filter, count=200), 3) == pytest.approx([0.5, 0.5], abs=0.02)


@pytest.mark.parametrize("filter", ["fir2005", "none"])
@pytest.mark.parametrize("clusters", [3, 8])  # one for the few lights of the dark sky, or several for a lamp, too
def test_clusters_of_two_opposite_equal_lamps_lie_at_them_and_none_between(clusters, filter):
    assert fractions_at_opposite_lamps(Sampler(filter=filter, count=300, clusters=clusters), 4) == pytest.approx([0.5, 0.5], abs=0.03)


def test_two_opposite_lamps_that_take_turns_keep_their_lights_apart_and_safe():
    # The hardest for a mean of directions: every light goes to and fro between opposite places. What comes out is dim, not wrong: unit
    # directions, nothing below the horizon, the power of the filtered sum.
    maps = [lamp(60, 180 * (k % 2), 1e5, SKY * np.float32(1e-3)) for k in range(30)]
    for filter in FILTERS:
        lights, _ = run(maps, Sampler(filter=filter, count=100))
        np.testing.assert_allclose(totals(lights)[-1], map_irradiance(maps[0], "hemisphere"), rtol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_light_on_the_horizon_alone_stays_there(method):
    ring = np.zeros_like(SKY)
    ring[-1] = 1.0
    lights, _ = run([ring] * 10, Sampler(method=method, count=200))
    height = np.degrees(np.arcsin(np.clip(lights[-1].directions[:, 2], -1, 1)))
    strength = lights[-1].irradiance[:, 1]
    assert strength[height <= 3].sum() > 0.99 * strength.sum()
    assert np.abs((strength[:, None] * lights[-1].directions[:, :2]).sum(axis=0)).max() < 0.02 * strength.sum()
    clusters, _ = run([ring] * 10, Sampler(method=method, count=200, clusters=24))
    height = np.degrees(np.arcsin(clusters[-1].directions[:, 2]))
    assert height @ clusters[-1].irradiance[:, 1] < 3 * strength.sum()  # a row and a half on average


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("sun", [0.0, 500.0])
def test_pixel_noise_moves_no_light_far(method, sun):
    # A sun of one cell with 6 % of all light has 13 of 216 lights; as its own noise moves its share, one of them may leave it in a frame.
    generator, base = np.random.default_rng(1), lamp(40, 100, sun)
    maps = [np.maximum(base * (1 + 0.05 * generator.standard_normal((ROWS, COLS, 1))), 0).astype(np.float32) for _ in range(30)]
    result = score(zip(maps, run(maps, Sampler(method=method, count=216))[0], strict=True))
    assert result.motion_deg < 0.5
    assert result.jumps <= (1 if sun else 0)
    assert result.flicker < (0.015 if sun else 0.005)


@pytest.mark.parametrize("filter", FILTERS)
def test_dropped_frames_do_not_shake_a_slow_sun(filter):
    times = [k / 25 for k in range(60) if k % 10 not in (6, 7)]
    maps = [np.float32(1 + 0.2 * t) * SKY for t in times]
    lights, reports = run(maps, Sampler(filter=filter), times=times)
    power = totals(lights)[:, 0] / float(map_irradiance(SKY, "hemisphere")[0])
    lag_s = (np.array([1 + 0.2 * t for t in times]) - power)[12:] / 0.2
    assert np.abs(lag_s - reports[-1].delay_s).max() < 0.045  # one frame: where no frame is, the line between neighbours stands in


@pytest.mark.parametrize(("fps", "hertz", "seen"), [(21.0, 100.0, 5.0), (25.0, 100.0, 0.0), (30.0, 100.0, 10.0), (30.0, 120.0, 0.0)])
def test_mains_flicker_is_reported_and_removed_on_request(fps, hertz, seen):
    times = np.arange(110) / fps
    maps = [np.float32(1 + 0.3 * np.sin(2 * np.pi * hertz * t)) * SKY for t in times]
    swing = {}
    for deflicker in (False, True):
        lights, reports = run(maps, Sampler(filter="none", count=16, deflicker=deflicker), fps)
        power = totals(lights)[70:, 0]
        swing[deflicker] = np.ptp(power) / power.mean()
        assert reports[-1].flicker_hz == pytest.approx(seen, abs=0.05)
        assert (reports[-1].flicker_depth > 0.2) == (seen > 0)
    assert swing[True] < 0.03
    assert seen == 0 or swing[False] > 0.3


@pytest.mark.parametrize("method", METHODS)
def test_invalid_pixels_are_counted_and_affect_no_others(method):
    damaged = lamp(40, 100, 500.0)
    damaged[3, 3], damaged[4, 4], damaged[5, 5] = np.nan, np.inf, -7.0
    clean = damaged.copy()
    clean[3, 3] = clean[4, 4] = clean[5, 5] = 0
    settings = Sampler(method=method)
    lights, reports = run([damaged], settings)
    expected, _ = run([clean], settings)
    assert reports[0].invalid_cells == 3
    for one, other in zip(lights[0], expected[0], strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_frame_without_a_valid_pixel_is_a_black_frame():
    lights, reports = run([SKY] * 5 + [np.full_like(SKY, np.nan)], Sampler(filter="none"))
    assert reports[-1].invalid_cells == ROWS * COLS
    assert (lights[-1].irradiance == 0).all()
    np.testing.assert_array_equal(lights[-1].directions, lights[-2].directions)
