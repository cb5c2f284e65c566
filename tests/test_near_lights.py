"""Near lights: their law of distance, and what none can be."""

import numpy as np
import pytest

from vemlight.light.near_lights import MAX_INTENSITY, MAX_NEAR_LIGHTS, NearLightSet


def lamps(count: int = 2, **changes: np.ndarray) -> NearLightSet:
    place = np.arange(3 * count).reshape(count, 3) + 1.0
    fields = {"ids": np.arange(count), "at": place, "intensity": place, "radius": np.zeros(count), "sigma": np.zeros(count)}
    return NearLightSet.of(**fields | changes)


def test_irradiance_falls_with_the_square_of_the_distance_until_the_surface():
    lamp = lamps(1, at=np.array([[0, 0, 2]]), intensity=np.array([[8, 4, 2]]), radius=np.array([0.5]))
    assert lamp.irradiance_at((0, 0, 0)).tolist() == [[2, 1, 0.5]]
    assert lamp.irradiance_at((0, 0, -2)).tolist() == [[0.5, 0.25, 0.125]]
    surface = lamp.irradiance_at((0, 0, 1.5))
    assert surface.tolist() == [[32, 16, 8]]
    assert lamp.irradiance_at((0, 0, 2)).tolist() == surface.tolist()
    assert np.isfinite(lamps().irradiance_at((1, 2, 3))).all()
    assert NearLightSet.empty().irradiance_at((0, 0, 0)).shape == (0, 3)


def test_a_directional_light_is_a_near_one_far_away():
    lamp = lamps(1, at=np.array([[0, 0, 1000]]), intensity=np.array([[1e6, 0, 0]]))
    np.testing.assert_allclose(lamp.irradiance_at((1, 1, 1)), [[1, 0, 0]], rtol=3e-3)


def test_the_strongest_light_there_can_be_is_finite_in_float32_as_near_as_can_be():
    lamp = lamps(1, at=np.zeros((1, 3)), intensity=np.full((1, 3), MAX_INTENSITY))
    assert not lamp.fault()
    assert np.isfinite(lamp.irradiance_at((0, 0, 0)).astype(np.float32)).all()


def test_arrays_have_their_types_whatever_they_came_as():
    assert [array.dtype.str for array in lamps().arrays()] == ["<i8", "<f4", "<f4", "<f4", "<f4"]


@pytest.mark.parametrize(
    ("lights", "words"),
    [
        (lamps(), ""),
        (NearLightSet.empty(), ""),
        (lamps(MAX_NEAR_LIGHTS), ""),
        (lamps(MAX_NEAR_LIGHTS + 1), "are 257, and 256 is the most"),
        (lamps(ids=np.zeros(2)), "have an id twice"),
        (lamps(at=np.full((2, 3), np.nan)), "have a number that is not finite"),
        (lamps(radius=np.array([0, np.inf])), "have a number that is not finite"),
        (lamps(intensity=np.array([[1, 1, -1], [0, 0, 0]])), "have a negative intensity, radius or sigma"),
        (lamps(radius=np.array([0, -1])), "have a negative intensity, radius or sigma"),
        (lamps(sigma=np.array([-1, 0])), "have a negative intensity, radius or sigma"),
        (lamps(at=np.full((2, 3), 1e6)), ""),
        (lamps(at=np.array([[0, 0, -1.1e6], [0, 0, 1]])), "have a place, radius or sigma beyond 1e+06 m"),
        (lamps(radius=np.array([1.1e6, 0])), "have a place, radius or sigma beyond 1e+06 m"),
        (lamps(sigma=np.array([0, 1.1e6])), "have a place, radius or sigma beyond 1e+06 m"),
        (lamps(intensity=np.full((2, 3), 1e31)), "have an intensity above 1e+30 W/sr"),
    ],
)
def test_what_no_near_lights_can_be_has_words(lights, words):
    assert lights.fault() == words
