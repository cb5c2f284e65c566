import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.lights import Lights
from services.renderer.pace import LEAST_RENEWED, Pace, affordable_lights, affordable_maps, first_lights, learnt


def test_nothing_is_promised_before_anything_is_known():
    assert affordable_lights(Pace(), 40.0) is None
    assert affordable_maps(Pace(), 40.0, 7) == 7


def test_lights_that_stand_still_are_counted_without_their_maps():
    pace = learnt(Pace(), 4.0, 0, 0.1, 72, 36.0)
    assert affordable_lights(pace, 40.0) == 72
    assert affordable_maps(pace, 40.0, 7) == 7


def test_a_steady_machine_is_learnt_at_once_and_kept():
    pace = Pace()
    for _ in range(5):
        pace = learnt(pace, 4.0, 10, 9.0, 72, 36.0)
    assert pace == pytest.approx((4.0, 0.9, 0.5))
    assert learnt(pace, 4.0, 0, 0.1, 72, 36.0).map_ms == pytest.approx(0.9)  # a frame without maps tells nothing about maps


@given(st.floats(0, 10), st.floats(0.01, 5), st.floats(0.01, 5), st.floats(1, 100), st.integers(1, 500))
def test_what_is_promised_fits(fixed, map_ms, light_ms, frame_ms, lights):
    pace = Pace(fixed, map_ms, light_ms)
    most = affordable_lights(pace, frame_ms)
    assert most is not None
    assert most == 1 or fixed + most * (light_ms + LEAST_RENEWED * map_ms) <= frame_ms * (1 + 1e-9)
    assert fixed + (most + 1) * (light_ms + LEAST_RENEWED * map_ms) > frame_ms * (1 - 1e-9)
    maps = affordable_maps(pace, frame_ms, lights)
    least = int(np.ceil(lights * LEAST_RENEWED))
    assert least <= maps <= lights
    assert maps == least or fixed + lights * light_ms + maps * map_ms <= frame_ms * (1 + 1e-9)


@given(st.integers(1, 30), st.integers(0, 40))
def test_fewer_lights_keep_the_power_in_each_channel(n, count):
    rng = np.random.default_rng(n)
    irradiance = rng.uniform(0, 1, (n, 3)) * (rng.uniform(0, 1, (n, 3)) > 0.3)
    lights = Lights.of(np.arange(n), rng.normal(size=(n, 3)), irradiance)
    chosen = first_lights(lights, count)
    assert len(chosen.ids) == min(max(count, 1), n)
    assert np.array_equal(chosen.directions, lights.directions[: len(chosen.ids)])
    assert np.allclose(chosen.irradiance.sum(axis=0), lights.irradiance.sum(axis=0), rtol=1e-5)


def test_a_learnt_cost_follows_the_machine():
    pace = learnt(Pace(), 1.0, 10, 10.0, 10, 10.0)
    for _ in range(30):
        pace = learnt(pace, 1.0, 10, 40.0, 10, 10.0)
    assert pace.map_ms == pytest.approx(4.0, rel=0.01)
