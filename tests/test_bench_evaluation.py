"""The measure of the charts: an error follows from where light is, not from the positions that the occluders happen to have."""

import numpy as np
import pytest

from bench.evaluation import CIRCLES, PROBES, TURNS, Points, probe_irradiance, relative_rms, relative_rms_rgb
from vemlight.sampler.probes import probes

GRAY = np.ones((1, 3))


def places(count: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed).standard_normal((count, 3))
    random[:, 2] = np.abs(random[:, 2])
    return random / np.linalg.norm(random, axis=1, keepdims=True)


def test_half_of_the_turns_let_a_light_through():
    (place,) = places(1, 0)
    hard = probe_irradiance(Points(place[None], GRAY)).hard.reshape(CIRCLES, TURNS, 3)
    cosine = np.maximum(probes(CIRCLES, "hemisphere").normals @ place, 0)
    lit = hard[..., 0] > 0
    assert (lit.sum(axis=1) == np.where(cosine > 0, TURNS // 2, 0)).all()
    assert ((lit != np.roll(lit, 1, axis=1)).sum(axis=1) == np.where(cosine > 0, 2, 0)).all()  # one half turn, not pieces
    np.testing.assert_allclose(hard.max(axis=(1, 2)), cosine, atol=1e-6)


def test_the_turns_are_those_of_an_occluder():
    """Each turn's sum is that of the lights on one side of a plane through the axis."""
    at, lights = probes(CIRCLES, "hemisphere"), Points(places(40, 1), np.random.default_rng(1).random((40, 3)))
    hard = probe_irradiance(lights).hard.reshape(CIRCLES, TURNS, 3)
    for k in range(0, CIRCLES, 9):
        across = np.linalg.svd(at.occluders[k][None])[2][1:]
        turn = np.linspace(0, 2 * np.pi, 8 * TURNS)
        side = np.stack([np.cos(turn), np.sin(turn)], axis=-1) @ across @ lights.directions.T > 0
        possible = side @ (np.maximum(lights.directions @ at.normals[k], 0)[:, None] * lights.irradiance)
        assert max(np.abs(possible - one).max(axis=1).min() for one in hard[k, ::37]) < 1e-5


def test_a_sun_in_a_wrong_place_costs_the_same_wherever_it_is():
    """A step parts two directions an angle apart with the probability angle / pi."""
    angle, normals = np.radians(0.3), probes(CIRCLES, "hemisphere").normals
    ratios = []
    for place in places(24, 2):
        side = np.linalg.svd(place[None])[2][1]
        moved = np.cos(angle) * place + np.sin(angle) * side
        difference = probe_irradiance(Points(place[None], GRAY)).hard - probe_irradiance(Points(moved[None], GRAY)).hard
        expected = np.mean(np.maximum(normals @ place, 0) ** 2) * angle / np.pi
        ratios.append(np.sqrt(np.mean(difference[:, 0] ** 2) / expected))
    # 100 circles leave 8 % of uncertainty (60 places); 6000 free probes left 45 %.
    assert np.std(ratios) < 0.15
    assert np.mean(ratios) == pytest.approx(1, abs=0.06)


def test_light_adds_up_in_each_channel():
    a, b = Points(places(5, 3), np.random.default_rng(3).random((5, 3))), Points(places(7, 4), np.random.default_rng(4).random((7, 3)))
    both = probe_irradiance(Points(*(np.concatenate(pair) for pair in zip(a, b, strict=True))))
    for one, other, whole in zip(probe_irradiance(a), probe_irradiance(b), both, strict=True):
        np.testing.assert_allclose(one + other, whole, atol=1e-5)
    assert both.soft.shape == (PROBES, 3)


def test_no_light_is_no_irradiance():
    dark = probe_irradiance(Points(np.zeros((0, 3)), np.zeros((0, 3))))
    assert not dark.hard.any()
    assert not dark.soft.any()


def test_the_error_of_one_channel_counts_with_its_luminance():
    truth = np.full((10, 3), 2.0)
    red = truth * [1.1, 1.0, 1.0]
    assert relative_rms(red - truth, truth) == pytest.approx(0.1 * 0.2126)
    assert relative_rms_rgb(red - truth, truth) == pytest.approx(0.1 / np.sqrt(3))
