"""The number of tracked lights that `error_percent` chooses."""

import numpy as np
import pytest

from vemlight.light.sphere import direction_from_angles
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from vemlight.sampler.required_lights import DARK_PROBE
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler


def sky(seed):
    """A smooth sky with a few lamps and sometimes a sun."""
    generator = np.random.default_rng(seed)
    theta, phi = (np.arange(45) + 0.5) * np.pi / 90, (np.arange(180) + 0.5) * np.pi / 90
    directions = direction_from_angles(theta[:, None], phi[None])
    radiance = 0.3 + generator.uniform(0, 1) * directions[..., 2]
    for _ in range(int(generator.integers(2, 7))):
        axis = direction_from_angles(np.arccos(generator.random()), 2 * np.pi * generator.random())
        radiance = radiance + generator.lognormal(0, 1) * np.exp(generator.uniform(5, 300) * (directions @ axis - 1))
    radiance[10, 20] += generator.choice([0.0, 2e3])
    return (radiance[..., None] * generator.uniform(0.6, 1, 3)).astype(np.float32)


def lights_of(radiance, **settings):
    wanted = Sampler(method="tracked", filter="none", count=512, **settings)
    state, counts = initial_state(), []
    for k in range(20):
        state, lights, _ = step(wanted, state, SamplerInput(radiance, "hemisphere", k / 25))
        counts.append(len(lights.ids))
    return lights, counts


def error_elsewhere(radiance, lights):
    """As `required_lights` defines it, on probes that it does not use."""
    at = probes(700, "hemisphere")
    truth = irradiance_of_map(at, radiance.astype(float), "hemisphere")[300:]
    got = irradiance_of_lights(at, lights.directions, lights.irradiance)[300:]
    return float(np.sqrt(np.mean(((got - truth) / (truth + DARK_PROBE * truth.mean())) ** 2)))


@pytest.mark.parametrize("limit", [30.0, 10.0])
def test_the_error_limit_holds_on_other_probes(limit):
    errors = [error_elsewhere(sky(seed), lights_of(sky(seed), error_percent=limit)[0]) for seed in range(100, 106)]
    # 96 probes estimate the error to 7 %, and lights are evaluated on other ones.
    assert np.sqrt(np.mean(np.square(errors))) < limit / 100
    assert max(errors) < 1.6 * limit / 100


def test_a_smaller_error_takes_more_lights_and_the_number_settles():
    few, many = (lights_of(sky(3), error_percent=percent)[1] for percent in (40.0, 10.0))
    assert few[-1] < many[-1] < 512
    assert len(set(many[-5:])) == 1


def test_two_lamps_in_the_dark_take_a_few_lights():
    """One light for two lamps is wrong by many times what the dark side receives; that is no reason for dozens."""
    for seed in range(12):
        generator, radiance = np.random.default_rng(seed), np.zeros((45, 180, 3), np.float32)
        for row, col in zip(generator.integers(5, 39, 2), generator.integers(0, 174, 2), strict=True):
            radiance[row : row + 6, col : col + 6] = generator.lognormal(3, 1)
        _, counts = lights_of(radiance, error_percent=40.0)
        assert max(counts) <= 8
        assert len(set(counts[-5:])) == 1
