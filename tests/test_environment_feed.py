"""The map for browsers' pictures: its bytes are its light, and it goes out seldom."""

import zlib

import numpy as np
import pytest

from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_directions, cell_solid_angles, map_irradiance
from vemlight.viewer.environment_binary import HEAD, MAX_CELLS, SOURCE, environment_binary, rgb9e5
from vemlight.viewer.environment_feed import PERIOD_S, EnvironmentFeed
from vemlight.viewer.feeds import Condition


def colours(words: np.ndarray) -> np.ndarray:
    """(..., 3) float64 of words of RGB9E5, as EXT_texture_shared_exponent says."""
    mantissas = np.stack([words & 511, words >> 9 & 511, words >> 18 & 511], axis=-1)
    return np.ldexp(mantissas.astype(float), (words >> 27).astype(int)[..., None] - 15 - 9)


def test_words_are_colours_to_a_512th_of_the_largest_channel():
    random = np.random.default_rng(3)
    rgb = np.vstack(
        [random.lognormal(0, 4, (5000, 3)).clip(0, 65408), [[0, 0, 0], [65408, 1, 0], [511.9, 0, 0], [2.0**-15, 0, 0], [1, 1, 1]]]
    )
    words = rgb9e5(rgb)
    assert words.dtype == np.dtype("<u4")
    assert (np.abs(colours(words) - rgb) <= np.maximum(rgb.max(axis=1, keepdims=True) / 512, 2.0**-25)).all()


def read(data: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The map, the map without sources (rows, cols, 3), its scale and the sources."""
    *_, rows, cols, sources, changed, unit, red, green, blue = HEAD.unpack_from(data)
    body = zlib.decompress(data[HEAD.size :])
    words = np.frombuffer(body, "<u4", rows * cols, SOURCE.itemsize * sources)
    cells, others = np.frombuffer(body, "<u4", offset=SOURCE.itemsize * sources + 4 * rows * cols).reshape(2, changed)
    rest = words.copy()
    rest[cells] = others
    whole, without = (colours(each).reshape(rows, cols, 3) * unit for each in (words, rest))
    return whole, without, np.array([red, green, blue]), np.frombuffer(body, SOURCE, sources)


def sunny(rows: int = 90, cols: int = 360, level: float = 1e4) -> tuple[EnvironmentMap, LightSet]:
    """A blue sky with a sun of one cell, which is one of its two lights."""
    radiance = np.full((rows, cols, 3), (0.3, 0.5, 0.9), np.float32)
    radiance[rows // 3, cols // 4] = level
    sun = radiance[rows // 3, cols // 4] * cell_solid_angles(rows, cols, "hemisphere")[rows // 3]
    sky = map_irradiance(radiance, "hemisphere") - sun
    directions = np.array([cell_directions(rows, cols, "hemisphere")[rows // 3, cols // 4], [0, 0, 1]])
    return EnvironmentMap(radiance, "hemisphere"), LightSet.of(np.array([7, 8]), directions, np.array([sun, sky]))


@pytest.mark.parametrize(("rows", "cols"), [(90, 360), (256, 1024)])
def test_bytes_have_the_light_and_which_of_it_lobes_reflect_as_lights(rows, cols):
    environment, lights = sunny(rows, cols)
    whole, rest, scale, sources = read(environment_binary(environment, lights))
    assert whole.shape[0] * whole.shape[1] <= MAX_CELLS
    power = map_irradiance(environment.radiance, "hemisphere")
    assert map_irradiance(whole, "hemisphere") == pytest.approx(power, rel=5e-3)
    assert scale == pytest.approx(1, rel=1e-3)
    assert sources["id"].tolist() == [7]
    assert sources["direct"] == pytest.approx(1, rel=0.01)
    assert map_irradiance(rest, "hemisphere") == pytest.approx(power - lights.irradiance[0], rel=5e-3)


@pytest.mark.parametrize("level", [0.0, 1e-20, 1e25, np.nan, np.inf])
def test_any_map_has_bytes(level):
    environment, lights = sunny(8, 32)
    whole, *_ = read(environment_binary(environment._replace(radiance=np.full((8, 32, 3), level, np.float32)), lights))
    assert whole == pytest.approx(np.full_like(whole, level if np.isfinite(level) else 0), rel=0.01)


def test_bytes_without_a_light_have_the_map_and_reflect_nothing():
    whole, rest, scale, sources = read(environment_binary(sunny()[0], LightSet.none()))
    assert whole.any()
    assert not scale.any()
    assert not len(sources)
    np.testing.assert_array_equal(whole, rest)


def test_it_takes_one_a_second_and_only_another_one():
    feed, (environment, lights) = EnvironmentFeed(Condition()), sunny(4, 8)
    feed.put_if_due(0.0)
    assert feed.number == 0, "nothing has come"
    taken = []
    for k in range(40):  # ten maps a second, the same from the 21st on
        feed.newest_map, feed.newest_lights = environment._replace(radiance=environment.radiance + np.float32(min(k, 20))), lights
        feed.put_if_due(k / 10)
        taken.append(feed.number)
    assert taken[-1] == 3
    assert [taken.index(number) / 10 for number in (1, 2, 3)] == pytest.approx([0.0, PERIOD_S, 2 * PERIOD_S], abs=0.11)
    feed.newest_lights = LightSet.of(lights.ids, lights.directions, 2 * lights.irradiance)
    feed.put_if_due(10.0)
    assert feed.number == 4, "other lights are another frame"
