"""Places of lights from directions and fluxes alone: as wrong as they are said to be, near only where they are, and the same from frame to
frame."""

import os

import numpy as np
import pytest

from tests.support.analytic_rooms import PAIR, SQUARE, TRIANGLE, rig_of
from tests.support.seen_sources import Eyes, Lit
from vemlight.fuse.matching import matches
from vemlight.fuse.tracks import HITS, Followed, Tracks, followed, no_tracks, tracks_of
from vemlight.fuse.triangulation import fits

FAR_FRAMES = int(os.environ.get("FAR_FRAMES", "600"))  # of skies; 12000 were run: see docs/several-cameras.md
A_SKY = 20  # frames


def next_frame(before: Followed, eyes: Eyes, lights: list[Lit], fixed, rng, is_still_lit: bool = False) -> Followed:
    seen = eyes.see(lights, fixed, rng)
    found = matches(seen)
    count = len(found.fit)
    own = found.sources.max(axis=1, initial=-1)
    measured = tracks_of(found, seen.chroma[0, own].reshape(count, 3), np.full(count, 1e-4), np.ones(count, bool))
    return followed(before, measured, np.full(len(before.tracks.ids), is_still_lit))


def start(eyes: Eyes) -> Followed:
    none = no_tracks(len(eyes.places))
    return Followed(none, none, 0)


def published(lights: Followed) -> Tracks:
    return lights.tracks.take(lights.tracks.near & (lights.tracks.hits >= HITS))


SEEDS = (*range(3), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(3, 10)))


@pytest.mark.parametrize("places", [PAIR, TRIANGLE, SQUARE], ids=len)
@pytest.mark.parametrize("at", [(0.6, 1.3, 2.2), (-1.8, 2.4, 2.6)])
def test_a_place_is_as_wrong_as_its_covariance_says(places, at):
    """The mean of error^T covariance^-1 error over its three numbers is 1."""
    rng, rig = np.random.default_rng(1), rig_of(places)
    squares = []
    for _ in range(500):
        eyes = Eyes.of(rig, rng)
        seen = eyes.see([Lit(np.array(at))], eyes.unequal(1, rng), rng)
        fit = fits(seen.table, np.zeros((1, len(places)), np.int64), seen.offsets, seen.pose)[0]
        u, rho, e1, e2 = fit[:3], fit[3], fit[38:41], fit[41:44]
        jacobian = np.stack([e1 / rho, e2 / rho, -u / rho**2], axis=1)
        covariance = jacobian @ fit[6:22].reshape(4, 4)[:3, :3] @ jacobian.T
        error = rig.centre + u / rho - at
        squares.append(error @ np.linalg.solve(covariance, error) / 3)
    assert 0.85 < np.mean(squares) < 1.15


def test_a_tracked_place_is_as_wrong_as_it_says():
    """Frames average noise and leave the errors of poses, and sigma says so: it does not go on falling."""
    rng, squares, ratios = np.random.default_rng(2), [], []
    for trial in range(60):
        rig = rig_of((PAIR, TRIANGLE, SQUARE)[trial % 3])
        eyes = Eyes.of(rig, rng)
        at = rig.centre + rng.uniform(1.5, 3.5) * np.array([np.cos(trial), np.sin(trial), 0.8])
        fixed, lights, sigmas = eyes.unequal(1, rng), start(eyes), []
        for _ in range(25):
            lights = next_frame(lights, eyes, [Lit(at)], fixed, rng)
            sigmas.append(float(np.trace(lights.tracks.place_covariances()[0])))
        error = lights.tracks.offsets()[0] + rig.centre - at
        squares.append(error @ np.linalg.solve(lights.tracks.place_covariances()[0], error) / 3)
        ratios.append(np.sqrt(sigmas[-1] / sigmas[0]))
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.3
    assert min(ratios) > 0.5


def test_no_light_of_a_far_sky_is_ever_near():
    """Twelve lights at infinity, with poses as wrong as declared and noise: wherever two of them pair by chance, nothing is published."""
    rng, frames = np.random.default_rng(3), 0
    while frames < FAR_FRAMES:
        rig = rig_of((PAIR, TRIANGLE, SQUARE)[frames // A_SKY % 3])
        eyes, sky = Eyes.of(rig, rng), []
        while len(sky) < 12:
            direction = rng.standard_normal(3) * (1, 1, 0.7)
            direction[2] = abs(direction[2]) + 0.05
            direction /= np.linalg.norm(direction)
            if all(direction @ other.at < np.cos(np.radians(2)) for other in sky):
                sky.append(Lit(direction, rng.uniform(-1.5, 1.5), True))
        fixed, lights = eyes.unequal(len(sky), rng), start(eyes)
        for _ in range(A_SKY):
            lights = next_frame(lights, eyes, sky, fixed, rng)
            assert len(published(lights).ids) == 0
            frames += 1


def ids_of(rig, moments: list[list[Lit]], seed: int) -> list[list[int]]:
    """The ids of near lights, frame by frame."""
    rng = np.random.default_rng(seed)
    eyes = Eyes.of(rig, rng)
    fixed, lights, ids = eyes.unequal(max(map(len, moments)), rng), start(eyes), []
    for moment in moments:
        lights = next_frame(lights, eyes, moment, fixed, rng)
        ids.append(published(lights).ids.tolist())
    return ids


LAMP, OTHER = Lit(np.array([1.2, 0.9, 2.3])), Lit(np.array([-1.5, 0.4, 2.0]), 0.3)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lamp_that_flickers_or_is_dimmed_keeps_its_id(seed):
    rng = np.random.default_rng(seed)
    levels = [0.0, 0.0, *rng.uniform(-2.0, 0.3, 12), *(-0.3 * np.arange(8)), 0.0]
    ids = ids_of(rig_of(TRIANGLE), [[LAMP._replace(ln_power=level), OTHER] for level in levels], seed)
    assert all(each == [0, 1] for each in ids[1:])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("level", [-2.0, -0.7, 0.7])
def test_a_lamp_that_moves_and_is_dimmed_at_once_is_the_same(seed, level):
    """A lamp that is carried, 8 cm from a frame to the next, and switched to another level; not so one that is twice as far away."""
    moved = LAMP._replace(at=LAMP.at + np.array([0.06, -0.05, 0.02]), ln_power=level)
    ids = ids_of(rig_of(TRIANGLE), [[OTHER, LAMP]] * 4 + [[OTHER, moved]] * 3, seed)
    assert all(each == [0, 1] for each in ids[1:])
    behind = LAMP._replace(at=np.array([2.4, 1.8, 3.5]), ln_power=level)
    ids = ids_of(rig_of(TRIANGLE), [[OTHER, LAMP]] * 4 + [[OTHER, behind]] * 3, seed)
    assert ids[-1] == [0, 2]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lamp_that_returns_has_its_id_in_its_first_frame(seed):
    """However long it was off, and however bright it is now."""
    off = [[OTHER]] * (3 + 7 * seed)
    ids = ids_of(rig_of(TRIANGLE), [[OTHER, LAMP]] * 4 + off + [[OTHER, LAMP._replace(ln_power=-1.0)]] * 3, seed)
    assert ids[3] == [0, 1]
    assert all(each == [0] for each in ids[5 : 4 + len(off)])
    assert ids[4 + len(off)] == ids[-1] == [0, 1]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lamp_elsewhere_is_another(seed):
    moved = LAMP._replace(at=np.array([1.0, 2.1, 2.3]))
    ids = ids_of(rig_of(TRIANGLE), [[OTHER, LAMP]] * 3 + [[OTHER]] * 2 + [[OTHER, moved]] * 3, seed)
    assert ids[-1] == [0, 2]


@pytest.mark.parametrize("seed", range(6))
def test_lamps_that_walk_past_each_other_keep_their_ids(seed):
    first, second = [], []
    for k in range(24):
        first.append(Lit(np.array([-1.0 + 0.08 * k, 1.4, 2.2])))
        second.append(Lit(np.array([0.9 - 0.08 * k, 1.9, 2.6]), 0.2, chroma=(0.5, 0.3, 0.2)))
    ids = ids_of(rig_of(TRIANGLE), [list(pair) for pair in zip(first, second, strict=True)], seed)
    assert all(each == [0, 1] for each in ids[1:])
