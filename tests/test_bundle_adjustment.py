"""Poses of cameras by a lamp that is carried: laws of the adjustment, what is refused, and the whole way from frames to the rig file."""

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.wand_recordings import rough_rig, write_wand
from vemlight.commands.camera_rig_calibration import (
    Wand,
    calibrate_camera_rig,
    is_camera_rig,
    wand_from_text,
)
from vemlight.errors import UserError
from vemlight.fuse.bundle_adjustment import CalibrationError, Poses, ScaleBar, adjusted, triangulated
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.fuse.wand import FrameSources, lamp_bearings, places


def rotations(vectors: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) by rotation vectors (n, 3), rad."""
    return Rotation.from_rotvec(vectors).as_matrix()


AT = np.array([[0.0, 0, 1], [1, 0, 1], [0.4, 0.8, 1.2]])
TURNS = np.concatenate([np.eye(3)[None], rotations(np.radians([[20.0, -10, 30], [-15, 25, 90]]))])
NAMES = ("left", "right", "back")
BAR = ScaleBar(0, 1, 1.0)


def around(count: int, seed: int = 0) -> np.ndarray:
    """Places around and above the cameras, 1 to 4 m from them."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    return AT.mean(axis=0) + directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(1, 4, (count, 1))


def bearings_of(lamp: np.ndarray, noise_deg: float = 0.0, seed: int = 0) -> np.ndarray:
    seen = np.einsum("kji,knj->kni", TURNS, lamp[None] - AT[:, None])
    seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
    seen += np.random.default_rng(seed).normal(0, math.radians(noise_deg), seen.shape)
    return seen / np.linalg.norm(seen, axis=-1, keepdims=True)


def rough(seed: int, turn_deg: float = 5.0, metres: float = 0.1) -> Poses:
    rng = np.random.default_rng(seed)
    turns = TURNS @ rotations(np.radians(rng.normal(0, turn_deg, (3, 3)) * [[0], [1], [1]]))
    return Poses(turns, AT + rng.normal(0, metres, (3, 3)) * [[0], [1], [1]])


def errors(found: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Of the cameras but the first: along an axis, degrees, and m."""
    cosine = (np.einsum("kij,kij->k", found.turns, TURNS) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))[1:] / math.sqrt(3), np.linalg.norm(found.at - AT, axis=1)[1:] / math.sqrt(3)


def rms(values: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_exact_bearings_give_the_poses_from_any_start():
    for start in (rough(1), Poses(rotations(np.array([[0.0, 0, 0], [2, 1, 0], [0, -2, 1]])), AT[[0, 2, 1]])):
        found = adjusted(bearings_of(around(20)), start, BAR, NAMES)
        turn_deg, metres = errors(found.poses)
        assert turn_deg.max() < 1e-4
        assert metres.max() < 1e-5
        np.testing.assert_array_equal(found.poses.at[0], AT[0])
        np.testing.assert_array_equal(found.poses.turns[0], TURNS[0])
        np.testing.assert_allclose(found.places, around(20), atol=1e-4)


def test_thirty_places_give_what_bearings_of_a_twentieth_of_a_degree_allow():
    turn_deg, metres, turn_sigma, sigma_m = [], [], [], []
    for seed in range(12):
        found = adjusted(bearings_of(around(30, seed), 0.05, 100 + seed), rough(seed), BAR, NAMES)
        for kept, own in zip((turn_deg, metres), errors(found.poses), strict=True):
            kept.append(own)
        turn_sigma.append(np.degrees(found.turn_rad[1:]))
        sigma_m.append(found.at_m[1:])
        assert 0.035 < math.degrees(found.residual_rad) < 0.065
    assert rms(turn_deg) < 0.04
    assert rms(metres) < 0.003
    assert 0.7 < rms(turn_deg) / rms(turn_sigma) < 1.4  # what is written to the file as its error is its error
    assert 0.6 < rms(metres) / rms(sigma_m) < 1.4


def test_the_measured_distance_gives_the_scale():
    found = adjusted(bearings_of(around(20)), rough(0), ScaleBar(0, 2, 3 * float(np.linalg.norm(AT[2] - AT[0]))), NAMES)
    np.testing.assert_allclose(found.poses.at - AT[0], 3 * (AT - AT[0]), atol=1e-3)


def test_lamps_that_were_mistaken_are_left_out():
    seen, rng = bearings_of(around(30), 0.05), np.random.default_rng(3)
    wrong = [(0, 3), (1, 8), (2, 8), (1, 20)]
    for camera, place in wrong:
        direction = rng.normal(size=3)
        seen[camera, place] = direction / np.linalg.norm(direction)
    found = adjusted(seen, rough(2), BAR, NAMES)
    assert not any(found.used[one] for one in wrong)
    assert found.used.sum() >= found.used.size - 12  # with a place that two see goes the other's bearing, too
    assert errors(found.poses)[0].max() < 0.1


def test_places_that_a_camera_does_not_see_are_missing_there_alone():
    seen = bearings_of(around(30))
    seen[2, :10] = np.nan
    assert errors(adjusted(seen, rough(2), BAR, NAMES).poses)[0].max() < 1e-4


def narrow() -> np.ndarray:
    return np.array([0.5, 0.3, 9.0]) + np.random.default_rng(0).uniform(-0.5, 0.5, (30, 3))


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (bearings_of(around(11)), "left sees the lamp at 11 places that another camera sees, too, and 12 are needed"),
        (bearings_of(narrow()), r"camera left sees all places within \d+ degrees, and 20 are needed"),
        (bearings_of(around(40), 0.5), "bearings fit to 0.* degrees, .* and 0.2 are needed; check its lens file"),
        (np.concatenate([bearings_of(around(30))[:2], bearings_of(around(30, 5))[2:]]), "of camera .* not at all"),
    ],
)
def test_bearings_from_which_no_poses_follow_are_refused(seen, said):
    with pytest.raises(CalibrationError, match=said):
        adjusted(seen, rough(0), BAR, NAMES)


def test_triangulation_undoes_bearings_and_puts_parallel_rays_ahead():
    lamp = around(10)
    np.testing.assert_allclose(triangulated(bearings_of(lamp), np.ones((3, 10), bool), Poses(TURNS, AT)), lamp, atol=1e-6)
    parallel = np.einsum("kji,j->ki", TURNS, np.array([0.0, 0, 1]))[:, None]
    place = triangulated(parallel, np.ones((3, 1), bool), Poses(TURNS, AT))
    assert np.isfinite(place).all()
    assert place[0, 2] > AT[:, 2].max()


def unit(*numbers: float) -> np.ndarray:
    return np.array(numbers) / np.linalg.norm(numbers)


def test_the_lamp_is_the_strongest_source_that_moves():
    lamp = [unit(math.sin(0.1 * k), 0.3, math.cos(0.1 * k)) for k in range(30)]
    weak = [unit(0.2, math.sin(0.1 * k), -1) for k in range(30)]
    frames = [FrameSources(np.stack([unit(0, 1, 0.1), lamp[k], weak[k]]), np.array([90.0, 40, 5])) for k in range(30)]
    np.testing.assert_allclose(lamp_bearings(frames), lamp)
    frames[4] = FrameSources(np.zeros((0, 3)), np.zeros(0))
    assert np.isnan(lamp_bearings(frames)[4]).all()
    still = [FrameSources(unit(0, 1, 0.1)[None], np.ones(1))] * 30
    assert np.isnan(lamp_bearings(still)).all()


def test_places_are_where_the_lamp_was_held_and_else_single_frames():
    held = np.repeat(bearings_of(around(25)), 4, axis=1)
    held += np.random.default_rng(0).normal(0, 1e-4, held.shape)
    held /= np.linalg.norm(held, axis=-1, keepdims=True)
    assert places(held).shape == (3, 25, 3)
    np.testing.assert_allclose(places(held)[0, 0], held[0, :4].mean(axis=0) / np.linalg.norm(held[0, :4].mean(axis=0)), atol=1e-12)
    carried = bearings_of(around(30))
    carried[0, 4], carried[:2, 9] = np.nan, np.nan  # the second is seen by one camera alone
    assert places(carried).shape == (3, 29, 3)
    assert places(np.repeat(carried, 200, axis=1)[:, :2]).shape[1] == 1  # which says nothing new


def test_from_frames_to_the_rig_file(tmp_path):
    roughly = AT + np.array([[0, 0, 0], [0.1, -0.1, 0], [0, 0.1, 0.1]])
    path = write_wand(tmp_path, TURNS, AT, around(26, 4) + np.array([0, 0, 0.3]), rough_rig("abc", roughly))
    before = path.read_bytes()
    said = calibrate_camera_rig(path, Wand("a", "b", 1.0), "hemisphere")
    rig = read_camera_rig(path)
    found = Poses(np.array([camera.world_from_camera for camera in rig.camera]), rig.places)
    turn_deg, metres = errors(found)
    assert turn_deg.max() < 0.08, said
    assert metres.max() < 0.005, said
    (fit_deg,) = map(float, re.findall(r"bearings fit to ([\d.]+) degrees", said))
    assert math.sqrt(fit_deg**2 - 0.02**2) < rig.pose_deg < 1.5 * fit_deg  # what single bearings are wrong by is in it
    assert all(camera.turn[3] >= 0 for camera in rig.camera), "of the two quaternions of a turn always the same"
    assert (tmp_path / "rig.old.toml").read_bytes() == before
    assert "the old file is" in said


def test_a_recording_without_a_lamp_is_refused_and_the_file_stays(tmp_path):
    path = write_wand(tmp_path, TURNS, AT, np.repeat([[0.5, 0.5, 3.0]], 3, axis=0), rough_rig("abc", AT))
    before = path.read_bytes()
    with pytest.raises(UserError, match="see the lamp at 0 places, and 12 are needed; carry a small bright lamp"):
        calibrate_camera_rig(path, Wand("a", "b", 1.0), "hemisphere")
    with pytest.raises(UserError, match=r"--wand a,d: .* has no camera d; it has a, b, c"):
        calibrate_camera_rig(path, Wand("a", "d", 1.0), "hemisphere")
    assert path.read_bytes() == before


@pytest.mark.parametrize("text", ["a,b", "a:1", "a,a:1", "a,b:0", "a,b:nan", "a,b:-1", "a,b:101", "a,b:x", ",b:1", "a,b,c"])
def test_a_wand_that_is_none_is_refused(text):
    with pytest.raises(UserError, match=r"is not two cameras and their distance in metres; write it as left,right:1\.25"):
        wand_from_text(text)
    assert wand_from_text("a,b:1.25") == Wand("a", "b", 1.25)


def test_the_tables_of_a_rig_file_say_what_it_holds(tmp_path):
    for text, holds in (("[[camera]]\nname='a'\n", True), ("# [[camera]]\n[[fixture]]\n", False), ("pose_deg=1\n [[ camera ]]\n", True)):
        (tmp_path / "rig.toml").write_text(text)
        assert is_camera_rig(tmp_path / "rig.toml") is holds
