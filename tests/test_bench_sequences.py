"""The moving light on which methods are evaluated: its ground truth and what the methods see."""

from itertools import islice, pairwise

import numpy as np
import pytest

from bench.evaluation import points_of, points_of_lights, probe_irradiance
from bench.sequences import FRAMES, SEQUENCES, SUN, turned, world_from_latlong
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import (
    angle_between,
    cell_directions,
    cell_solid_angles,
    direction_from_angles,
    latlong_directions,
    map_irradiance,
    rotation_xyz,
)


@pytest.fixture(scope="module")
def world():
    image = np.random.default_rng(0).lognormal(0, 1, (128, 256, 3)).astype(np.float32)
    image[30, 100] = 300
    return world_from_latlong(image)


@pytest.mark.parametrize("name", SEQUENCES)
def test_the_truth_and_the_map_hold_the_same_light(name, world):
    times = []
    for frame in islice(SEQUENCES[name](world), 6):
        times.append(frame.time_s)
        points = points_of(frame.source)
        np.testing.assert_allclose(points.irradiance.sum(axis=0), map_irradiance(frame.source.polar, "hemisphere"), rtol=1e-5)
        assert (points.directions[:, 2] > 0).all()
        cells, _, weights = frame.source.bright_cells
        assert (np.diff(cells) >= 0).all()
        np.testing.assert_allclose([weights[cells == cell].sum() for cell in np.unique(cells)], 1, rtol=1e-5)
    assert (np.diff(times) > 0).all()


def test_a_turn_takes_the_strong_light_and_the_rest_the_same_way():
    axis = direction_from_angles(np.radians(50.0), np.radians(70.0))
    lobe = np.exp(4 * (latlong_directions(64, 128) @ axis))[..., None].repeat(3, axis=-1)
    still, turn = world_from_latlong(lobe), 40.0

    def azimuths(source):
        rows, cols, _ = source.rest.shape
        flux = source.rest * cell_solid_angles(rows, cols, "hemisphere")[:, None, None]
        rest = np.einsum("ijc,ijk->k", flux, cell_directions(rows, cols, "hemisphere"))
        strong = source.brightest.irradiance.sum(axis=1) @ source.brightest.directions
        return np.degrees([np.arctan2(place[1], place[0]) for place in (rest, strong)])

    moved = azimuths(turned(still, rotation_xyz((0, 0, turn)))) - azimuths(turned(still, np.eye(3)))
    np.testing.assert_allclose(moved, turn, atol=1.5)


def test_lost_frames_leave_gaps_and_the_sun_goes_on(world):
    frames = list(SEQUENCES["lost frames"](world))
    steps = np.rint(np.diff([frame.time_s for frame in frames]) * 25).astype(int)
    assert len(frames) == FRAMES
    assert steps.max() > 1
    suns = [frame.source.brightest.directions[-61:].mean(axis=0) for frame in frames]
    moved = [np.degrees(angle_between(*(sun / np.linalg.norm(sun) for sun in pair))) for pair in pairwise(suns)]
    np.testing.assert_allclose(moved, steps * 0.5 * np.sin(np.pi / 4), rtol=0.01)
    added = frames[0].source.brightest.irradiance[-61:].sum(axis=0)
    np.testing.assert_allclose(added, SUN * world.power, rtol=1e-9)


def test_black_frames_are_black_only_to_the_methods(world):
    frames = list(SEQUENCES["black frames"](world))
    dark = [k for k, frame in enumerate(frames) if not frame.seen.any()]
    assert dark == [11, 23, 35, 47]
    assert all(frame.source.polar.any() for frame in frames)


def test_lights_that_are_the_points_have_no_error(world):
    frame = next(SEQUENCES["zenith"](world))
    points = points_of(frame.source)
    same = probe_irradiance(points_of_lights(LightSet.of(np.arange(len(points.directions)), points.directions, points.irradiance)), 200)
    truth = probe_irradiance(points, 200)
    np.testing.assert_allclose(same.soft, truth.soft, rtol=1e-4, atol=1e-5 * truth.soft.mean())
