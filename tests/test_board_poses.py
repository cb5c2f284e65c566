"""Poses of a rig by a board: from exact and noisy corners, upside down or hidden, and from photographs to the rig file."""

import re
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from tests.support.board_photographs import LENS, board_photograph
from vemlight.capture.calibration.board_pose import pose_from_rays
from vemlight.capture.calibration.boards import SEARCH_PX, CalibrationBoard, find_board
from vemlight.capture.lens import write_lens
from vemlight.commands.camera_rig_boards import poses_from_photographs
from vemlight.commands.cli import main
from vemlight.fuse.board_poses import MIN_MOMENTS, BoardFit, Pose, Sight, poses_from_boards
from vemlight.fuse.bundle_adjustment import CalibrationError, Poses
from vemlight.fuse.rig_file import CameraRig, RigCamera, read_camera_rig

COLS, ROWS, SQUARE_M = 8, 5, 0.1
CORNERS = np.stack(np.meshgrid(np.arange(COLS), np.arange(ROWS)), -1).reshape(-1, 2) * SQUARE_M
NAMES = "abc"
TURNS = Rotation.from_euler("xyz", [[0, 0, 0], [8, -10, 70], [-12, 5, -100]], degrees=True).as_matrix()
AT = np.array([[0.0, 0.0, 1.0], [1.0, 0.1, 1.1], [0.2, 0.9, 0.9]])
START = Poses(np.tile(TURNS[0], (3, 1, 1)), AT + 0.1 * (np.arange(3) > 0)[:, None])
BOARDS = [  # world_from_board, and the middle of the board
    (Rotation.from_euler("xyz", turn, degrees=True).as_matrix(), np.array(middle))
    for turn, middle in [
        ((170, 10, 20), (0.4, 0.3, 2.2)), ((150, -20, 80), (0.9, 0.7, 2.0)), ((200, 15, -50), (-0.3, 0.2, 2.1)),
        ((185, -25, 140), (0.5, -0.4, 2.3)), ((160, 30, 10), (0.3, 0.9, 2.4)),
    ]
]  # fmt: skip


def corners_in_world(board) -> np.ndarray:
    turn, middle = board
    return middle + np.column_stack([CORNERS - CORNERS.mean(axis=0), np.zeros(len(CORNERS))]) @ turn.T


def sight(camera: int, board, noise_rad: float = 0.0, rng=None, flipped: bool = False, whole: bool = True) -> Sight:
    rays = (corners_in_world(board) - AT[camera]) @ TURNS[camera]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    if rng is not None:
        rays = rays + rng.normal(0, noise_rad, rays.shape)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = rays[::-1] if flipped else rays
    pose, _ = pose_from_rays(rays, CORNERS)
    return Sight(rays, CORNERS, Pose(Rotation.from_rotvec(pose[:3]).as_matrix(), pose[3:]), whole)


def errors(fit: BoardFit) -> tuple[np.ndarray, np.ndarray]:
    """Of turns, degrees, and places, m."""
    apart = Rotation.from_matrix(fit.poses.turns @ TURNS.transpose(0, 2, 1)).magnitude()
    return np.degrees(apart), np.linalg.norm(fit.poses.at - AT, axis=1)


def exact_moments(fit: BoardFit) -> list[int]:
    """The moments of each camera, of poses that are exact."""
    turn_deg, metres = errors(fit)
    assert turn_deg.max() < 1e-4
    assert metres.max() < 1e-6
    return fit.moments.tolist()


def test_exact_corners_give_the_poses_also_where_boards_are_seen_upside_down():
    seen = [[sight(k, board, flipped=(k + n) % 3 == 0) for n, board in enumerate(BOARDS)] for k in range(3)]
    assert exact_moments(poses_from_boards(seen, START, NAMES)) == [5, 5, 5]


def test_a_rig_ten_times_as_large_is_placed_as_well():
    """Which single boards' poses agree is told by angles, not by metres."""
    seen = []
    for k in range(3):
        small = [sight(k, board, np.radians(0.02), np.random.default_rng(n), flipped=(k + n) % 2 == 0) for n, board in enumerate(BOARDS)]
        seen.append([s._replace(points=10 * s.points, camera_from_board=s.camera_from_board._replace(at=10 * s.camera_from_board.at))
                     for s in small])  # fmt: skip
    fit = poses_from_boards(seen, START, NAMES)
    fit = fit._replace(poses=Poses(fit.poses.turns, AT[0] + (fit.poses.at - AT[0]) / 10))
    turn_deg, metres = errors(fit)
    assert turn_deg.max() < 0.06
    assert metres.max() < 0.003


def test_a_board_is_found_from_the_camera_it_is_shared_with():
    """Camera c never sees the board together with the first one."""
    seen: list[list[Sight | None]] = [[sight(k, board) for board in BOARDS + BOARDS[:1]] for k in range(3)]
    seen[0][3:] = [None] * 3
    seen[2][:3] = [None] * 3
    assert exact_moments(poses_from_boards(seen, START, NAMES)) == [3, 6, 3]


def test_noise_leaves_what_a_board_allows_and_the_deviations_say_it():
    """Corners to a fiftieth of a degree: a board alone leaves 0.06 degrees, five leave less than half of it."""
    rng, over = np.random.default_rng(4), []
    for _ in range(8):
        seen = [[sight(k, board, np.radians(0.02), rng) for board in BOARDS] for k in range(3)]
        fit = poses_from_boards(seen, START, NAMES)
        turn_deg, metres = errors(fit)
        assert turn_deg.max() < 0.06
        assert metres.max() < 0.003
        over += [*(np.radians(turn_deg[1:]) / fit.turn_rad[1:]), *(metres[1:] / fit.at_m[1:])]
        assert (fit.turn_rad[0], fit.at_m[0]) == (0, 0)
    assert 0.65 < np.sqrt(np.mean(np.square(over)) / 3) < 1.4  # three axes together; 0.84 to 1.17 with six seeds


@pytest.mark.parametrize(("spoil", "said"), [
    (lambda seen: [*seen[:2], [*seen[2][: MIN_MOMENTS - 1], None, None, None]], "camera c sees the board at 2 moments together"),
    (lambda seen: [*seen[:2], [*seen[2][1:], seen[2][0]]], r"the boards fit to .* check the lens files, --board"),
])  # fmt: skip
def test_boards_from_which_no_poses_follow_are_refused(spoil, said):
    seen = [[sight(k, board, whole=False) for board in BOARDS] for k in range(3)]
    with pytest.raises(CalibrationError, match=said):
        poses_from_boards(spoil(seen), START, NAMES)


@pytest.fixture(scope="module")
def rig(tmp_path_factory) -> Path:
    """A rig file with rough poses, and photographs of each camera."""
    folder = tmp_path_factory.mktemp("rig")
    write_lens(folder / "lens.toml", LENS)
    for k, name in enumerate(NAMES):
        (folder / "views" / name).mkdir(parents=True)
        for n, board in enumerate(BOARDS):
            seen = board_photograph(TURNS[k], AT[k], *board, (COLS, ROWS), SQUARE_M)
            cv2.imwrite(str(folder / "views" / name / f"shot_{n}.png"), seen)
    cameras = [RigCamera(name=name, source=name, lens="lens.toml", at=tuple(at.tolist())) for name, at in zip(NAMES, START.at, strict=True)]
    (folder / "rig.toml").write_bytes(msgspec.toml.encode(CameraRig(camera=tuple(cameras))))
    return folder


def test_from_photographs_to_the_rig_file(rig):
    command = ["calibrate", "rig", str(rig / "rig.toml"), "--board", f"{COLS}x{ROWS}", "--square", str(SQUARE_M)]
    done = CliRunner().invoke(main, [*command, "--views", str(rig / "views")])
    assert done.exit_code == 0, done.output
    assert "5 boards" in done.output
    found = read_camera_rig(rig / "rig.toml")
    turns = np.array([camera.world_from_camera for camera in found.camera])
    turn_deg, metres = errors(BoardFit(Poses(turns, found.places), 0.0, np.zeros(3), np.zeros(3), np.zeros(3)))
    assert turn_deg.max() < 0.1
    assert metres.max() < 0.005
    assert (rig / "rig.old.toml").exists()
    assert 0 < found.pose_deg < 0.1


@pytest.mark.parametrize(("options", "said"), [
    (["--board", "8x5"], "--square: is missing; poses by a board take"),
    (["--wand", "a,b:1", "--board", "8x5"], "--wand: is one way, and a board another"),
    (["--board", "8x5", "--square", "0.1", "--views", "{}/views", "--dictionary", "DICT_4X4_50"], "^vemlight: --marker: is missing"),
    (["--board", "8x5", "--square", "0.1", "--views", "{}/views", "--dictionary", "DICT_4X4_50", "--marker", "0.05"],
     "check --board, --dictionary, and"),
    ([], "--wand: is missing; add"),
    (["--board", "8x5", "--square", "0.1", "--views", "{}/nowhere"], "nowhere/a: there is no such folder; --views names one"),
    (["--board", "8x5", "--square", "0.1", "--views", "{}/fewer"], r"different numbers of photographs \(a 2, b 2, c 1\); keep one"),
    (["--board", "7x9", "--square", "0.1", "--views", "{}/views"], "camera a: .*no board of 7x9 inner corners was found"),
])  # fmt: skip
def test_what_gives_no_poses_is_one_line_and_the_file_stays(rig, options, said):
    for name, count in zip(NAMES, (2, 2, 1), strict=True):
        (rig / "fewer" / name).mkdir(parents=True, exist_ok=True)
        for n in range(count):
            (rig / "fewer" / name / f"{n}.png").write_bytes((rig / "views" / name / f"shot_{n}.png").read_bytes())
    before = (rig / "rig.toml").read_bytes()
    done = CliRunner().invoke(main, ["calibrate", "rig", str(rig / "rig.toml"), *(option.format(rig) for option in options)])
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert re.search(said, line), line
    assert (rig / "rig.toml").read_bytes() == before


def test_photographs_are_paired_by_numbers_and_one_without_the_board_is_named(rig, tmp_path, capfd):
    """One camera counts across 9 to 10, another across 99 to 100; by letters IMG_10 would come before IMG_8."""
    for name, first in zip(NAMES, (8, 98, 1), strict=True):
        (tmp_path / name).mkdir()
        for n in range(len(BOARDS)):
            (tmp_path / name / f"IMG_{first + n}.png").write_bytes((rig / "views" / name / f"shot_{n}.png").read_bytes())
    cv2.imwrite(str(tmp_path / "b" / "IMG_100.png"), np.full((560, 560), 110, np.uint8))
    taken = read_camera_rig(rig / "rig.toml")
    fit = poses_from_photographs(rig / "rig.toml", taken, START, tmp_path, CalibrationBoard((COLS, ROWS), SQUARE_M))
    turn_deg, metres = errors(fit)
    assert turn_deg.max() < 0.1
    assert metres.max() < 0.005
    assert fit.moments.tolist() == [4, 4, 5]  # of a's IMG_9 the board is not found, either
    assert "b: no board was found in IMG_100.png; the other 4 are used" in capfd.readouterr().err


def test_photographs_of_another_size_than_the_lens_are_refused(rig, tmp_path):
    write_lens(tmp_path / "lens.toml", msgspec.structs.replace(LENS, size=(640, 640)))
    (tmp_path / "rig.toml").write_bytes((rig / "rig.toml").read_bytes())
    command = ["calibrate", "rig", str(tmp_path / "rig.toml"), "--board", "8x5", "--square", "0.1", "--views", str(rig / "views")]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 2
    assert "its photographs are 560x560, and lens.toml is of 640x640; take them" in done.stderr


def test_large_photographs_are_searched_in_a_small_copy_and_give_the_same_corners(monkeypatch):
    photograph, board = board_photograph(TURNS[0], AT[0], *BOARDS[0], (COLS, ROWS), SQUARE_M), CalibrationBoard((COLS, ROWS), SQUARE_M)
    small, searched = find_board("small", photograph, board), []
    found = cv2.findChessboardCorners

    def watched(image, *rest, **flags):
        searched.append(image.shape)
        return found(image, *rest, **flags)

    monkeypatch.setattr(cv2, "findChessboardCorners", watched)
    large = find_board("large", cv2.resize(photograph, None, fx=5, fy=5, interpolation=cv2.INTER_CUBIC), board)
    assert small
    assert large
    assert searched == [(SEARCH_PX, SEARCH_PX)]
    np.testing.assert_allclose((large.pixels + 0.5) / 5 - 0.5, small.pixels, atol=0.3)  # of squares of 12
