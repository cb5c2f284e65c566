import numpy as np
import pytest

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_directions, cell_solid_angles, direction_from_angles
from vemlight.sampler.score import Score, score, score_text


def radiance(seed=1):
    return np.random.default_rng(seed).lognormal(0, 1, (12, 24, 3)).astype(np.float32)


def all_cells(of):
    irradiance = (of * cell_solid_angles(12, 24, "hemisphere")[:, None, None]).reshape(-1, 3)
    return LightSet.of(np.arange(288), cell_directions(12, 24, "hemisphere").reshape(-1, 3), irradiance)


def one(theta_deg=30.0, phi_deg=40.0, power=1.0, ident=0):
    return LightSet.of(np.array([ident]), direction_from_angles(np.radians(theta_deg), np.radians(phi_deg))[None], np.full((1, 3), power))


def test_a_light_for_every_cell_is_perfect():
    maps = [radiance(k) for k in range(3)]
    result = score((m, all_cells(m)) for m in maps)
    assert result.frames == 3
    assert result.lights_min == result.lights_max == 288
    assert max(result.error, result.error_worst, result.flicker, result.power_error, abs(result.power_drift)) < 1e-5
    assert result.change > 0.05  # the maps themselves change
    assert result.motion_worst_deg == result.births == result.deaths == result.jumps == 0


def test_too_much_power_is_error_and_drift():
    m = radiance()
    lights = all_cells(m)
    result = score([(m, lights._replace(irradiance=lights.irradiance * np.float32(1.1)))] * 2)
    assert result.power_error == pytest.approx(0.1, rel=1e-4)
    assert result.power_drift == pytest.approx(0.1, rel=1e-4)
    assert 0.1 < result.error < 0.15  # RMS over the probes: 0.1 of their root mean square, which is above their mean
    assert result.flicker == 0


def test_motion_jumps_births_and_deaths_are_counted_by_id():
    m = radiance()
    frames = [one(30), one(32), one(52), one(52, ident=7), one(52, ident=7)]
    result = score([(m, lights) for lights in frames])
    assert result.motion_worst_deg == pytest.approx(20, abs=1e-3)
    assert result.motion_deg == pytest.approx((2 + 20 + 0) / 3, abs=1e-3)
    assert (result.jumps, result.births, result.deaths) == (1 / 4, 1 / 4, 1 / 4)
    result = score([(m, lights) for lights in (LightSet.none(), one(), one(), one(), one())])
    assert (result.births, result.deaths) == (1 / 4, 0)


def test_black_frames_count_without_dividing_by_zero():
    black = np.zeros((12, 24, 3), np.float32)
    result = score([(black, one(power=0.0))] * 3)
    assert result == Score(3, 1, 1.0, 1, *[0.0] * 12)
    result = score([(radiance(), all_cells(radiance())), (black, one(power=0.0))])
    assert result.error < 1e-6
    assert np.isfinite(result).all()


def test_a_sequence_without_frames_has_no_score():
    with pytest.raises(ValueError, match="at least one frame"):
        score([])


def test_the_text_fits_one_screen():
    lines = score_text(score([(radiance(), one())] * 2)).splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100
    assert lines[0].split() == ["frames", "2"]


@pytest.mark.parametrize(("degrees", "jumps"), [(7.0, 0), (9.5, 0), (10.5, 1), (15.0, 1)])
def test_a_move_of_more_than_ten_degrees_is_a_jump(degrees, jumps):
    assert score([(radiance(), one(30.0)), (radiance(), one(30.0 + degrees))]).jumps == jumps
