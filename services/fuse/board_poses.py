"""Poses of cameras from a flat board that several photograph at once: the board in each camera, then all cameras and boards together.

The first camera's pose fixes the world, the side of the board's squares its scale. Rays are unit vectors in each camera's map axes.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vemlight.fuse.bundle_adjustment import HUBER_RAD, MAX_RESIDUAL_RAD, CalibrationError, Poses, across

MIN_MOMENTS = 3  # in which a camera sees the board together with another: a turned chessboard looks the same, and two agree by chance
SAME_RAD = math.radians(5.0)  # between poses by single boards: corners to 0.02 degrees leave 0.2 to 1, upside down is 180; 2 to 20 would do


class Pose(NamedTuple):
    """turn: (3, 3) float64, target from source; at: (3,), the source's origin in the target's axes, m."""

    turn: np.ndarray
    at: np.ndarray

    def after(self, other: "Pose") -> "Pose":
        return Pose(self.turn @ other.turn, self.turn @ other.at + self.at)

    def inverse(self) -> "Pose":
        return Pose(self.turn.T, -self.turn.T @ self.at)


class Sight(NamedTuple):
    """A board in a photograph. rays: (n, 3) float64. points: (n, 2) float64, m, on the board. camera_from_board: by this sight alone.

    whole: whether all of a chessboard is seen, which looks the same from the other end.
    """

    rays: np.ndarray
    points: np.ndarray
    camera_from_board: Pose
    whole: bool


class BoardFit(NamedTuple):
    """poses: of the cameras. residual_rad: standard deviation of a ray about an axis. moments: (cameras,) int64, in which it was seen.

    turn_rad, at_m: (cameras,) standard deviations of the poses about and along an axis; 0 of the first camera.
    """

    poses: Poses
    residual_rad: float
    moments: np.ndarray
    turn_rad: np.ndarray
    at_m: np.ndarray


def poses_from_boards(seen: Sequence[Sequence[Sight | None]], start: Poses, names: Sequence[str]) -> BoardFit:
    """The poses that fit the boards best. seen: of each camera (rows) at each moment. start: the first camera's stays, the others' decide
    where the moments leave two ways.

    names: of the cameras, for errors. Raises CalibrationError for a camera that shares too few moments with others, and for boards that do
    not fit together.
    """
    sights = [list(row) for row in seen]
    cameras = _placed(sights, [Pose(turn, at) for turn, at in zip(start.turns, start.at, strict=True)], names)
    boards = {moment: _board(sights, cameras, moment) for moment in _shared(sights)}
    fit = _adjusted(sights, cameras, boards)
    if fit.residual_rad > MAX_RESIDUAL_RAD:
        text = f"the boards fit to {math.degrees(fit.residual_rad):.2f} degrees, and {math.degrees(MAX_RESIDUAL_RAD):g} are needed"
        raise CalibrationError(f"{text}; check the lens files, --board, and that the n-th photographs of all cameras are of one moment")
    return fit


def _shared(sights: Sequence[Sequence[Sight | None]]) -> list[int]:
    """The moments at which two cameras or more see the board."""
    return [moment for moment, views in enumerate(zip(*sights, strict=True)) if sum(view is not None for view in views) >= 2]


def _placed(sights: list[list[Sight | None]], start: Sequence[Pose], names: Sequence[str]) -> list[Pose]:
    """world_from_camera of each, one after the other, each by the placed camera with which it shares most moments. Boards that were taken
    upside down are turned in `sights`.
    """
    placed: dict[int, Pose] = {0: start[0]}
    while len(placed) < len(sights):
        links = [(len(_common(sights, known, own)), -known, -own) for known in placed for own in range(len(sights)) if own not in placed]
        count, known, own = max(links)
        if count < MIN_MOMENTS:
            text = f"camera {names[-own]} sees the board at {count} moments together with another camera, and {MIN_MOMENTS} are needed"
            raise CalibrationError(f"{text}; hold it where both see all of it, at six or more")
        placed[-own] = _linked(sights, -known, placed[-known], -own, start[-own])
    return [placed[k] for k in range(len(sights))]


def _common(sights: Sequence[Sequence[Sight | None]], a: int, b: int) -> list[int]:
    return [moment for moment, (one, other) in enumerate(zip(sights[a], sights[b], strict=True)) if one and other]


def _linked(sights: list[list[Sight | None]], known: int, world_from_known: Pose, own: int, start: Pose) -> Pose:
    """world_from_camera of `own`, on which most moments agree, the nearest to `start` of several; its boards become those of `known`."""
    moments, candidates = _common(sights, known, own), []
    for moment in moments:
        one, other = sights[known][moment], sights[own][moment]
        assert one
        assert other
        world_from_board = world_from_known.after(one.camera_from_board)
        ways = (other, _upside_down(other)) if other.whole and one.whole else (other,)
        candidates.append([(world_from_board.after(way.camera_from_board.inverse()), way) for way in ways])
    reach_m = float(np.median([np.linalg.norm(way.camera_from_board.at) for ways in candidates for _, way in ways]))
    every = [pose for ways in candidates for pose, _ in ways]
    agree = [sum(min(_difference(pose, other, reach_m) for other, _ in ways) < SAME_RAD for ways in candidates) for pose in every]
    likely = (pose for pose, count in zip(every, agree, strict=True) if count == max(agree))
    best = min(likely, key=lambda pose: _difference(pose, start, reach_m))
    for moment, ways in zip(moments, candidates, strict=True):
        sights[own][moment] = min(ways, key=lambda way: _difference(best, way[0], reach_m))[1]
    agreeing = [pose for pose in every if _difference(best, pose, reach_m) < SAME_RAD]
    turn = Rotation.from_matrix([pose.turn for pose in agreeing]).mean().as_matrix()
    return Pose(turn, np.median([pose.at for pose in agreeing], axis=0))


def _difference(a: Pose, b: Pose, reach_m: float) -> float:
    """Of two poses of one camera, rad: a board that far away, turned by it, moves the camera as far as they are apart."""
    turn_rad = float(Rotation.from_matrix(a.turn.T @ b.turn).magnitude())
    return max(turn_rad, float(np.linalg.norm(a.at - b.at)) / reach_m)


def _upside_down(sight: Sight) -> Sight:
    """The same rays with the board turned by 180 degrees about the middle of its points."""
    both_ends = sight.points.max(axis=0) + sight.points.min(axis=0)
    turned = Pose(np.diag([-1.0, -1.0, 1.0]), np.append(both_ends, 0.0))
    return sight._replace(points=both_ends - sight.points, camera_from_board=sight.camera_from_board.after(turned))


def _board(sights: Sequence[Sequence[Sight | None]], cameras: Sequence[Pose], moment: int) -> np.ndarray:
    """The board's pose (6,) in the world, as the camera sees it that has it largest."""
    views = [(camera, row[moment]) for camera, row in zip(cameras, sights, strict=True)]
    camera, view = max(((c, v) for c, v in views if v), key=lambda pair: float(np.ptp(pair[1].rays, axis=0).max()))
    pose = camera.after(view.camera_from_board)
    return np.concatenate([Rotation.from_matrix(pose.turn).as_rotvec(), pose.at])


def _adjusted(sights: Sequence[Sequence[Sight | None]], cameras: Sequence[Pose], boards: dict[int, np.ndarray]) -> BoardFit:
    """All poses but the first camera's, and all boards', by Huber's loss of the angles between rays and corners."""
    moved, order = len(cameras) - 1, {moment: n for n, moment in enumerate(boards)}
    seen = [(k, moment, view) for k, row in enumerate(sights) for moment, view in enumerate(row) if view and moment in boards]
    axes = [np.stack(across(view.rays), axis=1) for _, _, view in seen]

    def poses(numbers: np.ndarray) -> list[Pose]:
        steps = numbers[: 6 * moved].reshape(-1, 6)
        own = [Pose(c.turn @ Rotation.from_rotvec(s[:3]).as_matrix(), c.at + s[3:]) for c, s in zip(cameras[1:], steps, strict=True)]
        return [cameras[0], *own]

    def residuals(numbers: np.ndarray) -> np.ndarray:
        placed, where, found = poses(numbers), numbers[6 * moved :].reshape(-1, 6), []
        for (k, moment, view), both in zip(seen, axes, strict=True):
            board = where[order[moment]]
            in_world = view.points @ Rotation.from_rotvec(board[:3]).as_matrix()[:, :2].T + board[3:]
            toward = (in_world - placed[k].at) @ placed[k].turn
            toward /= np.linalg.norm(toward, axis=1, keepdims=True)
            found.append(np.einsum("nci,ni->nc", both, toward).ravel())
        return np.concatenate(found)

    start = np.concatenate([np.zeros(6 * moved), *boards.values()])
    solved = least_squares(residuals, start, loss="huber", f_scale=HUBER_RAD, x_scale="jac")
    apart = residuals(solved.x)
    freedom = max(len(apart) - len(start), 1)
    residual_rad = math.sqrt(float(apart @ apart) / freedom)
    belongs = np.concatenate([np.full(2 * len(view.points), order[moment]) for _, moment, view in seen])
    variances = _variances(solved.jac, apart, residual_rad, belongs)[: 6 * moved].reshape(-1, 2, 3).mean(axis=2)
    both = np.sqrt(np.concatenate([np.zeros((1, 2)), variances]))
    found = poses(solved.x)
    counts = np.array([sum(view is not None and moment in boards for moment, view in enumerate(row)) for row in sights])
    return BoardFit(Poses(np.array([p.turn for p in found]), np.array([p.at for p in found])), residual_rad, counts, both[:, 0], both[:, 1])


def _variances(jacobian: np.ndarray, residuals: np.ndarray, residual_rad: float, belongs: np.ndarray) -> np.ndarray:
    """Of the solution's numbers: by the residuals' size as if each were on its own, or, where that is more, by how much the moments pull
    against each other (White 1980, in clusters): a board's corners share the lens's error.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    alone = residual_rad**2 * np.diag(inverse)
    count = int(belongs.max()) + 1
    pulls = np.stack([jacobian[belongs == n].T @ residuals[belongs == n] for n in range(count)])
    together = count / max(count - 1, 1) * ((inverse @ pulls.T) ** 2).sum(axis=1)
    return np.maximum(alone, together)
