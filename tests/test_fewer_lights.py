"""A coarser level of detail: what is left out joins, nothing is lost, and the error is the one that is said."""

import numpy as np
import pytest

from vemlight.exchange.fewer_lights import error_of, fewer_lights
from vemlight.light.light_set import LightSet, are_covariances

NOBODY = np.zeros(0, np.int64)


def some_lights(count: int, soft: bool, seed: int = 0) -> LightSet:
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    covariances = (across * random.uniform(0, 0.05, (count, 1, 1)))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return LightSet.of(random.permutation(count), directions, random.random((count, 3)) ** 3, covariances if soft else None)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("count", [1, 7, 71])
def test_nothing_is_lost_and_the_strongest_keep_their_ids(soft, count):
    lights = some_lights(72, soft)
    fewer = fewer_lights(lights, count, NOBODY)
    power = lights.irradiance @ [0.2126, 0.7152, 0.0722]
    assert set(fewer.ids) == set(lights.ids[np.argsort(-power)[:count]])
    assert np.allclose(fewer.irradiance.sum(axis=0, dtype=float), lights.irradiance.sum(axis=0, dtype=float), rtol=1e-6)
    assert np.allclose(np.linalg.norm(fewer.directions, axis=1), 1, atol=1e-6)
    assert (fewer.covariances is not None) == soft


@pytest.mark.parametrize("count", [72, 100])
def test_few_lights_stay_as_they_are(count):
    lights = some_lights(72, True)
    assert fewer_lights(lights, count, NOBODY) is lights


def test_a_joined_light_has_the_mean_and_the_covariance_of_its_parts():
    """Of all of a frame, joined in one: the moments of many directions drawn from each light."""
    lights = some_lights(20, True)
    assert lights.covariances is not None
    one = fewer_lights(lights, 1, NOBODY)
    assert one.covariances is not None
    power = (lights.irradiance @ [0.2126, 0.7152, 0.0722]).astype(float)
    weights = power / power.sum()
    full = lights.covariances.astype(float)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    means = lights.directions * np.sqrt(1 - np.trace(full, axis1=1, axis2=2))[:, None]
    mean = weights @ means
    second = np.einsum("n,nij->ij", weights, full + means[:, :, None] * means[:, None, :])
    assert np.allclose(one.directions[0], mean / np.linalg.norm(mean), atol=1e-5)
    covariance = second - np.outer(mean, mean)
    assert np.allclose(one.covariances[0], covariance[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], atol=1e-6)
    assert np.trace(covariance) == pytest.approx(1 - mean @ mean, abs=1e-5)
    assert are_covariances(one.covariances)


def test_lights_of_like_strength_do_not_take_turns():
    lights = LightSet.of(np.array([5, 6]), np.array([[0, 0, 1], [1.0, 0, 0]]), np.array([[1.0, 1, 1], [1.1, 1.1, 1.1]]))
    assert fewer_lights(lights, 1, NOBODY).ids.tolist() == [6]
    assert fewer_lights(lights, 1, np.array([5])).ids.tolist() == [5]
    stronger = lights._replace(irradiance=lights.irradiance * np.array([[1], [2]], np.float32))
    assert fewer_lights(stronger, 1, np.array([5])).ids.tolist() == [6]


def test_darkness_has_fewer_lights_too():
    lights = some_lights(9, True)
    fewer = fewer_lights(lights._replace(irradiance=np.zeros((9, 3), np.float32)), 4, NOBODY)
    assert len(fewer.ids) == 4
    assert np.isfinite(fewer.directions).all()
    assert error_of(fewer, fewer) == 0


@pytest.mark.parametrize("count", [3, 12, 60])
def test_the_error_is_that_over_all_normals(count):
    lights = some_lights(72, False, 4)
    fewer = fewer_lights(lights, count, NOBODY)
    k = np.arange(20_000)
    z, phi = 1 - (2 * k + 1) / len(k), k * np.pi * (3 - np.sqrt(5))
    normals = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1)
    whole, less = (np.maximum(normals @ some.directions.T, 0) @ some.irradiance for some in (lights, fewer))
    assert error_of(fewer, lights) == pytest.approx(np.sqrt(((less - whole) ** 2).mean() / (whole**2).mean()), rel=1e-3)


def test_joining_has_a_third_of_the_error_of_leaving_out():
    """Of the strongest alone, made stronger until each channel's sum is right."""
    for seed in range(5):
        lights = some_lights(72, False, seed)
        fewer = fewer_lights(lights, 24, NOBODY)
        alone = lights.irradiance[np.isin(lights.ids, fewer.ids)]
        directions = lights.directions[np.isin(lights.ids, fewer.ids)]
        scaled = alone * (lights.irradiance.sum(axis=0) / alone.sum(axis=0))
        assert error_of(fewer, lights) < error_of(LightSet.of(fewer.ids, directions, scaled), lights) / 3
