"""Levels of fixtures: the kernel, what soft lights weigh, the fit and its bounds, steps of slots, minima, powers, delays."""

import math

import msgspec
import numpy as np
import pytest

from tests.support.fixture_rigs import BICOLOUR, RGB, RGBAL, beam, dome, light_set, rig_of
from vemlight.fixtures.irradiance_kernel import SoftLights, fibonacci_normals, gathered, irradiance_at, kernel_matrix
from vemlight.fixtures.levels import AUTO_LEVEL, emitter_watts, initial_state, step
from vemlight.fixtures.photometrics import emitter_colours
from vemlight.fixtures.report import report_of, report_words
from vemlight.fixtures.rig import Group
from vemlight.fixtures.rig_system import RigSystem, light_of_slots, slots_of_light
from vemlight.fixtures.solver import KEPT_STEPS, solve
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import rotation_xyz

EVERY = fibonacci_normals(100_000)


def error_of(levels) -> float:
    return float(np.linalg.norm(levels.given - levels.target) / np.linalg.norm(levels.target))


def settled(rig, lights, frames: int = 3):
    system = RigSystem.of(rig)
    state = initial_state(system)
    for k in range(frames):
        state, levels = step(system, state, lights, k / 25)
    return system, levels


def test_the_kernel_is_the_integral_over_all_normals_and_edges():
    angles = np.array([0.0, 0.3, 1.0, 2.0, 3.0])
    directions = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    alike = kernel_matrix(directions)[0]
    lit = np.maximum(EVERY @ directions.T, 0)
    alone = 4 * np.pi * np.mean(lit * lit[:, :1], axis=0) / (2 * np.pi / 3)
    behind = (EVERY @ directions.T > 0) & (EVERY[:, 2] > 0)[:, None]  # half-spaces that hold both
    np.testing.assert_allclose(alike, alone * (0.7 + 0.3 * 2 * behind.mean(axis=0)), atol=1e-4)


@pytest.mark.parametrize("cap_deg", [10, 45, 90])
def test_a_wide_light_weighs_as_the_points_that_it_stands_for(cap_deg):
    """The cosine with a fixture has a mean and a variance, and two points have both; without extent the error is .02 to .4."""
    z = 1 - (1 - math.cos(math.radians(cap_deg))) * (np.arange(2000) + 0.5) / 2000
    phi = np.arange(2000) * 2.39996
    points = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1) * [1.0, 0.5, 1.0]
    points = points / np.linalg.norm(points, axis=1, keepdims=True) @ rotation_xyz((35.0, 50.0, 20.0)).T
    mean, covariance = points.mean(axis=0), np.cov(points.T, bias=True)
    one = LightSet.of(np.zeros(1), (mean / np.linalg.norm(mean))[None], np.ones((1, 3)), covariance[np.triu_indices(3)][None])
    many = LightSet.of(np.arange(2000), points, np.full((2000, 3), 1 / 2000))
    alike = [gathered(fibonacci_normals(50), *(vars(SoftLights(lights)).values())) for lights in (one, many)]
    np.testing.assert_allclose(*alike, atol=6e-3)
    received = [irradiance_at(fibonacci_normals(50), *(vars(SoftLights(lights)).values())) for lights in (one, many)]
    np.testing.assert_allclose(*received, atol=0.09)


def test_a_rig_that_can_make_the_light_makes_it():
    """Lights where fixtures hang, of levels that they can have, come back as those levels."""
    rig = rig_of([beam(k, d) for k, d in enumerate(dome(9))], gain=1.0)
    system = RigSystem.of(rig)
    wanted = np.random.default_rng(1).uniform(0.4, 0.6, len(system.owners))
    irradiance = system.light_of(wanted) * system.pieces.strengths[:, None]
    assert (irradiance > 0).all()
    _, levels = settled(rig, light_set(system.pieces.directions, irradiance), 20)
    np.testing.assert_allclose(levels.levels, wanted, atol=2e-3)
    assert error_of(levels) < 1e-3


def test_light_between_fixtures_is_matched_better_than_by_the_nearest_one():
    rig = rig_of([beam(k, d) for k, d in enumerate(dome(16))], gain=1.0)
    lights = light_set([[0.4, 0.3, 0.866]], [[300.0, 200.0, 100.0]])
    system, levels = settled(rig, lights)
    nearest = int(np.argmax(system.pieces.directions @ lights.directions[0]))
    alone = np.maximum(system.normals @ system.pieces.directions[nearest], 0)[:, None] * lights.irradiance
    assert error_of(levels) < 0.6 * np.linalg.norm(alone - levels.target) / np.linalg.norm(levels.target)


def test_four_and_five_emitters_have_one_solution():
    """The ridge makes it unique: a cold start ends where a warm one does."""
    rig = rig_of([beam(k, d, RGBAL) for k, d in enumerate(dome(6))], gain=1.0)
    lights = light_set(dome(6)[1:4], 3 * [[50.0, 60.0, 40.0]])
    system, cold = settled(rig, lights, 60)
    state = initial_state(system)._replace(levels=np.random.default_rng(2).uniform(0, 1, len(system.owners)))
    for k in range(60):
        state, warm = step(system, state, lights, k / 25)
    np.testing.assert_allclose(warm.levels, cold.levels, atol=0.02)


def test_what_a_fixture_cannot_give_goes_to_its_neighbours():
    directions = [[0.0, 0.0, 1.0], [0.5, 0.0, 0.866], [-0.5, 0.0, 0.866]]
    rig = rig_of([beam(k, d) for k, d in enumerate(directions)], gain=1.0)
    weak, strong = (light_set(directions[:1], [[one, one, one]]) for one in (500.0, 3000.0))
    system, below = settled(rig, weak)
    _, above = settled(rig, strong)
    assert system.light_of(below.levels)[1:].sum() < 0.05
    assert above.levels.max() == 1
    assert system.light_of(above.levels)[1:].sum() > 0.5
    assert report_of(system, above).limited[0] == "beam 0"
    assert "At full: beam 0" in report_words(report_of(system, above))


def test_no_light_no_levels_and_no_error():
    system, levels = settled(rig_of([beam(0, [0, 0, 1])]), LightSet.none())
    assert not levels.levels.any()
    assert not levels.slots.any()
    assert report_of(system, levels).unmatched == 0


def test_a_colour_outside_the_gamut_is_reported():
    rig = rig_of([beam(0, [0, 0, 1], RGB)], gain=1.0)
    system, levels = settled(rig, light_set([[0, 0, 1]], [[300.0, -0.0, 0.0]]))
    assert report_of(system, levels).off_gamut == ()  # deep red is inside these primaries
    whites = rig_of([beam(0, [0, 0, 1], BICOLOUR)], gain=1.0)
    system, levels = settled(whites, light_set([[0, 0, 1]], [[10.0, 30.0, 400.0]]))
    assert report_of(system, levels).off_gamut == ("beam 0",)
    assert "Cannot mix the colour: beam 0" in report_words(report_of(system, levels))


def test_fixtures_without_colour_match_luminance():
    """Squares of RGB would give half of this blue light's luminance too much."""
    lights = light_set([[0, 0, 1]], [[20.0, 60.0, 400.0]])
    system, levels = settled(rig_of([beam(0, [0, 0, 1], BICOLOUR)], gain=1.0), lights)
    weights = np.array([0.2126, 0.7152, 0.0722])
    given = system.light_of(levels.levels)[0] * system.pieces.strengths[0]
    assert given @ weights == pytest.approx(lights.irradiance[0] @ weights, rel=0.15)
    assert np.allclose(RigSystem.of(rig_of([beam(0, [0, 0, 1])])).metric, np.eye(3))


def test_emitters_add_up_to_their_fixture():
    colours = emitter_colours(RGBAL)
    assert colours.sum(axis=0) @ [0.2126, 0.7152, 0.0722] == pytest.approx(1, abs=1e-3)
    assert (colours[2] < 0).any()  # a deep primary is outside Rec. 709


@pytest.mark.parametrize("curve", ["linear", "square", ((0.0, 0.0), (0.1, 0.0), (0.5, 0.2), (1.0, 1.0))])
def test_slots_undo_their_curve(curve):
    fixture = msgspec.structs.replace(beam(0, [0, 0, 1]), curve=curve)
    light = light_of_slots(fixture, 256)
    numbers = slots_of_light(fixture, light, 256)
    np.testing.assert_allclose(light[numbers], light, atol=1e-12)
    assert numbers[0] == 0
    assert numbers[-1] == 255
    assert slots_of_light(fixture, np.array([0.5]), 65_536)[0] / 65_535 == pytest.approx({"linear": 0.5, "square": 0.5**0.5}.get(
        curve if isinstance(curve, str) else "", 0.6875), abs=1e-4)  # fmt: skip


def test_whole_numbers_near_the_lower_end_make_up_for_each_other():
    """With 8 bits and a top level of some steps, rounding each level by itself has a larger error than the search in steps."""
    lights = light_set(dome(11), np.random.default_rng(3).uniform(1, 6, (11, 3)) * 8)
    rig = rig_of([beam(k, d, bits=8) for k, d in enumerate(dome(16))], gain=1.0)
    system, levels = settled(rig, lights)
    exact = settled(rig_of([beam(k, d, bits=16) for k, d in enumerate(dome(16))], gain=1.0), lights)[1]
    rounded = system.irradiance_of(np.rint(exact.levels * 255) / 255)
    assert exact.levels.max() < 10 / 255
    assert error_of(levels) < 0.8 * np.linalg.norm(rounded - levels.target) / np.linalg.norm(levels.target)
    np.testing.assert_allclose(levels.slots, levels.levels * 255, atol=1e-9)


def best_numbers(factor: np.ndarray, y: np.ndarray, limit: float) -> float:
    """The least |y - factor u|^2 of whole numbers u of 0 and more, at most `limit`: depth first, the nearest number first (Schnorr and
    Euchner 1994, "Lattice basis reduction: improved practical algorithms and solving subset sum problems"). factor: upper triangular."""
    chosen, least = np.zeros(len(y)), limit

    def descend(k: int, spent: float) -> None:
        nonlocal least
        if k < 0:
            least = spent
            return
        centre = (y[k] - factor[k, k + 1 :] @ chosen[k + 1 :]) / factor[k, k]
        reach = np.sqrt(max(least - spent, 0)) / factor[k, k]
        numbers = np.arange(max(np.ceil(centre - reach), 0), np.floor(centre + reach) + 1)
        for number in numbers[np.argsort(np.abs(numbers - centre))]:
            more = spent + (factor[k, k] * (number - centre)) ** 2
            if more >= least:
                return
            chosen[k] = number
            descend(k - 1, more)

    descend(len(y) - 1, 0.0)
    return least


def test_the_search_in_steps_comes_near_the_best_numbers_that_there_are():
    """Of small rigs, for which these can be found: what rounding adds to the error is mostly the least possible, at most a quarter more."""
    random, more = np.random.default_rng(8), []
    for _ in range(20):
        directions = random.normal(size=(3, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        lights = light_set(dome(11), random.uniform(1, 6, (11, 3)) * 4)
        system, levels = settled(rig_of([beam(k, d, bits=8) for k, d in enumerate(directions)], gain=1.0), lights)
        root, b = np.linalg.cholesky(system.matrix), system.target_of(SoftLights(lights))
        factor, y = root.T / 255, np.linalg.solve(root, b)
        continuous = np.zeros(len(b))
        solve(system.matrix, b, continuous * 0, continuous + 1, continuous)
        found, without = (float(((y - 255 * factor @ x) ** 2).sum()) for x in (levels.levels, continuous))
        more.append(np.sqrt((found - without) / (best_numbers(factor, y, found * (1 + 1e-9)) - without)))
    assert max(more) < 1.25
    assert np.median(more) < 1.03


def test_no_step_of_two_numbers_is_better():
    """Nor of one: the search ends at a minimum of the quadratic form among its neighbours, but for what keeps numbers where they are."""
    lights = light_set(dome(11), np.random.default_rng(3).uniform(1, 6, (11, 3)) * 8)
    system, levels = settled(rig_of([beam(k, d, bits=8) for k, d in enumerate(dome(16))], gain=1.0), lights)
    rest = system.target_of(SoftLights(lights)) - system.matrix @ levels.levels
    steps = np.concatenate([np.eye(len(rest)), -np.eye(len(rest))]) / 255
    steps = steps[((levels.levels + steps >= 0) & (levels.levels + steps <= 1)).all(axis=1)]
    pairs = (steps[:, None] + steps).reshape(-1, len(rest))
    cost = np.einsum("ni,ij,nj->n", pairs, system.matrix, pairs) - 2 * pairs @ rest
    own = pairs**2 @ np.diag(system.matrix)
    assert (cost >= -(2 * KEPT_STEPS - 1) * own - 1e-12 * own.max()).all()


def test_a_number_stays_while_the_light_trembles():
    rig = rig_of([beam(0, [0, 0, 1], bits=8)], gain=1.0)
    system = RigSystem.of(rig)
    state, seen = initial_state(system), set()
    for k in range(20):
        light = (100.5 + 0.04 * (-1) ** k) / 255 * system.pieces.strengths[0]  # on the border of two numbers
        state, levels = step(system, state, light_set([[0, 0, 1]], [[light, light, light]]), k / 25)
        seen.add(tuple(levels.slots.tolist()))
    assert len(seen) == 1


def test_a_minimum_has_hysteresis():
    rig = rig_of([msgspec.structs.replace(beam(0, [0, 0, 1]), minimum=0.2)], gain=1.0)
    system = RigSystem.of(rig)
    white = system.light_of(np.ones(3))[0] * system.pieces.strengths[0]
    state, seen = initial_state(system), []
    for part in (0.14, 0.16, 0.19, 0.11, 0.09, 0.14, 0.3):
        state, levels = step(system, state, light_set([[0, 0, 1]], [part * white]), 0.0)
        seen.append(round(float(levels.levels.max()), 3))
    assert seen == [0, 0.2, 0.2, 0.2, 0, 0, 0.3]


@pytest.mark.parametrize("bits", [8, 16])
def test_a_group_keeps_its_power(bits):
    fixtures = [msgspec.structs.replace(beam(k, d, bits=bits), watts=100.0) for k, d in enumerate(dome(6))]
    rig = msgspec.structs.replace(rig_of(fixtures, gain=1.0), group=(Group(fixtures=("beam 0", "beam 2"), watts=60.0),))
    system, levels = settled(rig, light_set(dome(6), 6 * [[900.0, 900.0, 900.0]]))
    power = emitter_watts(system) * levels.levels
    assert 50 < power[np.isin(system.owners, [0, 2])].sum() <= 60 * (1 + 1e-4)
    assert power[system.owners == 1].sum() > 40


def test_smoothing_delays_by_what_it_says():
    """A ramp of light arrives smooth_ms later."""
    rig = msgspec.structs.replace(rig_of([beam(0, [0, 0, 1])], gain=1.0), smooth_ms=200.0)
    system = RigSystem.of(rig)
    white = system.light_of(np.ones(3))[0] * system.pieces.strengths[0]
    state = initial_state(system)
    for k in range(100):
        state, levels = step(system, state, light_set([[0, 0, 1]], [k / 200 * white]), k / 25)
    assert (99 / 200 - levels.levels.max()) * 200 / 25 == pytest.approx(0.2, rel=0.02)


def test_an_automatic_gain_is_found_in_the_first_second_and_stays():
    system = RigSystem.of(rig_of([beam(k, d) for k, d in enumerate(dome(6))], gain="auto"))
    state, gains, tops = initial_state(system), [], []
    for k in range(60):
        power = 5.0 if k < 3 else 20.0 if k < 20 else 2.0 if k < 40 else 21.0
        state, levels = step(system, state, light_set([[0, 0, 1]], [[power] * 3]), k / 25)
        gains.append(levels.gain)
        tops.append(levels.levels.max())
    assert gains[0] == pytest.approx(4 * gains[10])
    assert len(set(gains[10:])) == 1
    assert tops[10] == pytest.approx(AUTO_LEVEL, abs=0.01)
    assert tops[50] > tops[10] > tops[30]
