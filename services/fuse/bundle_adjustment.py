"""Poses of cameras from bearings of one lamp at many places: bundle adjustment on unit vectors (Triggs et al., "Bundle adjustment: a modern
synthesis", 2000). The first camera's pose fixes the world, the measured distance of two cameras its scale.

Bearings are (cameras, places, 3) float64, unit vectors in each camera's axes, nan where it does not see the lamp. Rotations are
world_from_camera, (cameras, 3, 3); places are metres.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

MIN_PLACES = 12  # of a camera, seen by another one too: with 8 and 5 unknowns a pair, nothing checks the rest
MIN_ANGLE_RAD = math.radians(20.0)  # between two places of a camera: bearings within less fix a turn, but hardly a place
MAX_RESIDUAL_RAD = math.radians(0.2)  # four times that of good bearings; more is a wrong lens, a moving camera or another lamp
OUTLIER_RAD = math.radians(0.3)  # at least; a lamp mistaken for another is off by degrees
OUTLIER_RATIO = 5.0  # of the median residual
MAX_OUTLIERS = 0.2  # of the bearings
HUBER_RAD = math.radians(0.1)  # beyond it a residual pulls no harder
SCALE_M = 0.002  # standard deviation of the measured distance
MAX_STEPS, MAX_DAMPING = 200, 1e12
ROUNDS = 4  # of solving and leaving out
LINEAR_PLACES = 8  # of an essential matrix, linearly


class Poses(NamedTuple):
    """Of the cameras. turns: (cameras, 3, 3). at: (cameras, 3), m."""

    turns: np.ndarray
    at: np.ndarray


class Adjusted(NamedTuple):
    """Poses and the lamp's places (n, 3). used: (cameras, n) bool, bearings that fit; residual_rad: their standard deviation.

    turn_rad, at_m: (cameras,) standard deviations of the poses about and along an axis, by the residuals; 0 of the first camera.
    """

    poses: Poses
    places: np.ndarray
    used: np.ndarray
    residual_rad: float
    turn_rad: np.ndarray
    at_m: np.ndarray


class ScaleBar(NamedTuple):
    """The measured distance of two cameras, by their numbers."""

    first: int
    second: int
    metres: float


class CalibrationError(ValueError):
    """Bearings from which no poses follow. Its text says why, and the way out."""


def adjusted(bearings: np.ndarray, start: Poses, scale: ScaleBar, names: Sequence[str]) -> Adjusted:
    """The poses that fit the bearings best, from the better of two starts: `start`, and one that the bearings give by themselves.

    names: of the cameras, for errors. Raises CalibrationError for fewer than MIN_PLACES places, places within MIN_ANGLE_RAD of each other,
    bearings that do not fit together.
    """
    seen = np.isfinite(bearings).all(axis=-1)
    seen &= seen.sum(axis=0) >= 2
    _check_places(bearings, seen, names)
    candidates = [_scaled(start, scale)]
    if (found := relative_poses(bearings, seen, start)) is not None:
        candidates.append(_scaled(found, scale))
    solved = [_rounds(bearings, seen, candidate, scale) for candidate in candidates]
    best = min(solved, key=lambda one: (one.residual_rad * math.sqrt(seen.sum() / max(one.used.sum(), 1)) ** 3))
    _check_fit(best, seen, names)
    return best


def _check_places(bearings: np.ndarray, seen: np.ndarray, names: Sequence[str]) -> None:
    for name, own, visible in zip(names, bearings, seen, strict=True):
        if visible.sum() < MIN_PLACES:
            text = f"camera {name} sees the lamp at {visible.sum()} places that another camera sees, too, and {MIN_PLACES} are needed"
            raise CalibrationError(f"{text}; carry it to about 30 that all see")
        widest = math.acos(np.clip((own[visible] @ own[visible].T).min(), -1, 1))
        if widest < MIN_ANGLE_RAD:
            text = f"camera {name} sees all places within {math.degrees(widest):.0f} degrees"
            needed = f"{math.degrees(MIN_ANGLE_RAD):.0f} are needed"
            raise CalibrationError(f"{text}, and {needed}; carry the lamp all around the cameras, near and far")


def _check_fit(best: Adjusted, seen: np.ndarray, names: Sequence[str]) -> None:
    left_out = 1 - best.used.sum(axis=1) / seen.sum(axis=1)
    worst = int(np.argmax(left_out))
    if best.residual_rad > MAX_RESIDUAL_RAD or left_out[worst] > MAX_OUTLIERS or best.used.sum(axis=1).min() < MIN_PLACES:
        lost = f"{100 * left_out[worst]:.0f} % of camera {names[worst]}'s not at all"
        text = f"bearings fit to {math.degrees(best.residual_rad):.2f} degrees, {lost}, and {math.degrees(MAX_RESIDUAL_RAD):g} are needed"
        way_out = "check its lens file, that no camera was moved, and that nothing else bright moves"
        raise CalibrationError(f"{text}; {way_out}")


def _rounds(bearings: np.ndarray, seen: np.ndarray, start: Poses, scale: ScaleBar) -> Adjusted:
    """Solves, leaves out bearings that do not fit, and solves again."""
    used, poses, places = seen.copy(), start, triangulated(bearings, seen, start)
    residual, turn_rad, at_m = np.inf, np.zeros(len(start.at)), np.zeros(len(start.at))
    for _ in range(ROUNDS):
        poses, places, covariance = _solved(bearings, used, poses, places, scale)
        angles, (turn_rad, at_m) = _angles(bearings, poses, places), _deviations(covariance, len(start.at))
        fitting = angles < max(OUTLIER_RAD, OUTLIER_RATIO * float(np.median(angles[used])))
        kept = used & fitting
        kept &= kept.sum(axis=0) >= 2
        residual = float(np.sqrt((angles[kept] ** 2).sum() / _freedom(kept))) if kept.any() else np.inf
        if (kept == used).all() or kept.sum(axis=1).min() < MIN_PLACES:
            used = kept
            break
        used = kept
    return Adjusted(poses, places, used, residual, turn_rad, at_m)


class _System(NamedTuple):
    """The residuals of used bearings, their derivatives, and which camera and place each belongs to.

    residuals: (n, 2), stereographic about the bearing, rad. by_pose: (n, 2, 6) by a turn in the camera's axes and a step of its place.
    by_place: (n, 2, 3).
    """

    residuals: np.ndarray
    by_pose: np.ndarray
    by_place: np.ndarray
    which: np.ndarray
    where: np.ndarray


def _system(bearings: np.ndarray, used: np.ndarray, poses: Poses, places: np.ndarray) -> _System:
    which, where = np.nonzero(used)
    toward, turns = bearings[which, where], poses.turns[which]
    axes = np.stack(across(toward), axis=1)
    v = np.einsum("nji,nj->ni", turns, places[where] - poses.at[which])
    length = np.linalg.norm(v, axis=1)
    # 2 tan(angle / 2) in the direction of the error: finite for all but a place straight behind
    below = np.maximum(length + np.einsum("ni,ni->n", v, toward), 1e-9 * length)
    off = np.einsum("nci,ni->nc", axes, v)
    residuals = 2 * off / below[:, None]
    by_v = 2 * axes / below[:, None, None]
    by_v -= residuals[:, :, None] * ((v / length[:, None] + toward) / below[:, None])[:, None, :]
    by_place = np.einsum("nci,nji->ncj", by_v, turns)
    by_turn = np.cross(by_v, v[:, None, :])  # turned by w the place moves by v x w in the camera's axes
    return _System(residuals, np.concatenate([by_turn, -by_place], axis=2), by_place, which, where)


def _cost(residuals: np.ndarray, apart_m: float, scale: ScaleBar) -> float:
    """Huber's loss of the bearings, and the distance's."""
    r = np.linalg.norm(residuals, axis=1) / HUBER_RAD
    return float(np.where(r <= 1, r * r, 2 * r - 1).sum() + ((apart_m - scale.metres) / SCALE_M) ** 2)


def _normal_equations(system: _System, poses: Poses, scale: ScaleBar, count: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J^T W J and J^T W r of all poses but the first's and `count` places; weights: of the bearings, 1 / rad^2."""
    moved = 6 * (len(poses.at) - 1)
    jacobian = np.zeros((len(system.which), 2, 6 + moved + 3 * count))  # the first's six columns are left out in the end
    rows = np.arange(len(system.which))
    for k in range(6):
        jacobian[rows, :, 6 * system.which + k] = system.by_pose[:, :, k]
    for k in range(3):
        jacobian[rows, :, 6 + moved + 3 * system.where + k] = system.by_place[:, :, k]
    flat = jacobian[:, :, 6:].reshape(-1, moved + 3 * count)
    weighted = flat * np.repeat(weights, 2)[:, None]
    matrix, vector = flat.T @ weighted, weighted.T @ system.residuals.reshape(-1)

    between = poses.at[scale.second] - poses.at[scale.first]
    apart = max(float(np.linalg.norm(between)), 1e-9)
    bar = np.zeros(6 + len(matrix))
    for camera, sign in ((scale.first, -1), (scale.second, 1)):
        bar[6 * camera + 3 : 6 * camera + 6] = sign * between / apart
    bar = bar[6:]
    return matrix + np.outer(bar, bar) / SCALE_M**2, vector + bar * (apart - scale.metres) / SCALE_M**2


def _moved(poses: Poses, places: np.ndarray, step: np.ndarray) -> tuple[Poses, np.ndarray]:
    count = 6 * (len(poses.at) - 1)
    change = np.concatenate([np.zeros((1, 6)), step[:count].reshape(-1, 6)])
    turns = poses.turns @ Rotation.from_rotvec(change[:, :3]).as_matrix()
    return Poses(turns, poses.at + change[:, 3:]), places + step[count:].reshape(-1, 3)


def _solved(
    bearings: np.ndarray, used: np.ndarray, poses: Poses, places: np.ndarray, scale: ScaleBar
) -> tuple[Poses, np.ndarray, np.ndarray]:
    """Poses, places, and the inverse of the normal equations (Levenberg 1944, Marquardt 1963; Huber's weights). Unused places stay."""
    needed = np.flatnonzero(used.any(axis=0))
    own, seen, rest = places[needed], bearings[:, needed], used[:, needed]
    damping, system = 1e-3, _system(seen, rest, poses, own)
    apart = float(np.linalg.norm(poses.at[scale.first] - poses.at[scale.second]))
    cost = _cost(system.residuals, apart, scale)
    for _ in range(MAX_STEPS):
        weights = 1 / (HUBER_RAD * np.maximum(np.linalg.norm(system.residuals, axis=1), HUBER_RAD))
        matrix, vector = _normal_equations(system, poses, scale, len(needed), weights)
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)) + 1e-12 * np.eye(len(matrix)), -vector)
        next_poses, next_places = _moved(poses, own, step)
        next_system = _system(seen, rest, next_poses, next_places)
        apart = float(np.linalg.norm(next_poses.at[scale.first] - next_poses.at[scale.second]))
        next_cost = _cost(next_system.residuals, apart, scale)
        if not next_cost < cost:
            damping *= 8
            if damping > MAX_DAMPING:
                break
            continue
        done = cost - next_cost < 1e-9 * cost
        poses, own, system, cost, damping = next_poses, next_places, next_system, next_cost, max(damping / 8, 1e-12)
        if done:
            break
    places = places.copy()
    places[needed] = own
    scatter = max(float((system.residuals**2).sum()) / _freedom(rest), 1e-16)
    matrix, _ = _normal_equations(system, poses, scale, len(needed), np.full(len(system.which), 1 / scatter))
    return poses, places, np.linalg.pinv(matrix, hermitian=True)


def _freedom(used: np.ndarray) -> int:
    """How many of the bearings' two numbers each are left over: all but those of the poses, the places and, as the scale is given, one."""
    return max(2 * int(used.sum()) - 6 * (len(used) - 1) - 3 * int(used.any(axis=0).sum()) + 1, 1)


def _deviations(covariance: np.ndarray, cameras: int) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of the poses' turns, rad, and places, m, about and along an axis; 0 of the first."""
    variances = np.diag(covariance)[: 6 * (cameras - 1)].reshape(-1, 2, 3).mean(axis=2)
    both = np.sqrt(np.concatenate([np.zeros((1, 2)), np.maximum(variances, 0)]))
    return both[:, 0], both[:, 1]


def _angles(bearings: np.ndarray, poses: Poses, places: np.ndarray) -> np.ndarray:
    """Between bearings and the directions to the places, (cameras, places); 0 where there is no bearing."""
    v = np.einsum("kji,knj->kni", poses.turns, places[None] - poses.at[:, None])
    dot = np.einsum("kni,kni->kn", v, bearings)
    return np.nan_to_num(np.arctan2(np.linalg.norm(np.cross(v, bearings), axis=-1), dot))


def across(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors each, at right angles to the directions (n, 3) and each other."""
    least = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    east = np.cross(directions, least)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    return east, np.cross(directions, east)


def triangulated(bearings: np.ndarray, seen: np.ndarray, poses: Poses) -> np.ndarray:
    """The places (n, 3) nearest to the rays, by linear least squares of their distances; far ahead where rays are parallel."""
    rays = np.einsum("kij,knj->kni", poses.turns, np.where(seen[..., None], bearings, 0))
    away = np.where(seen[..., None, None], np.eye(3) - rays[..., :, None] * rays[..., None, :], 0)
    matrix = away.sum(axis=0) + 1e-9 * np.eye(3)
    places = np.linalg.solve(matrix, np.einsum("knij,kj->ni", away, poses.at)[..., None])[..., 0]
    ahead = np.einsum("kni,kni->kn", rays, places[None] - poses.at[:, None])
    mean = rays.sum(axis=0)
    behind = (np.where(seen, ahead, 1) <= 0).any(axis=0) & (np.linalg.norm(mean, axis=1) > 0)
    apart = np.linalg.norm(poses.at - poses.at.mean(axis=0), axis=1).max() + 0.1
    centre = poses.at.mean(axis=0)
    places[behind] = centre + 5 * apart * mean[behind] / np.linalg.norm(mean[behind], axis=1, keepdims=True)
    return places


def relative_poses(bearings: np.ndarray, seen: np.ndarray, start: Poses) -> Poses | None:
    """Poses from the bearings alone: each camera's essential matrix with the first one, the eight-point algorithm on unit vectors
    (Longuet-Higgins 1981), all baselines brought to one scale by the places' distances from the first. None without enough in common.
    """
    turns, at, distances = [start.turns[0]], [start.at[0]], None
    for k in range(1, len(bearings)):
        both = seen[0] & seen[k]
        if both.sum() < LINEAR_PLACES:
            return None
        found = _relative_pose(bearings[0, both], bearings[k, both])
        if found is None:
            return None
        first_from_own, baseline, own_distances = found
        if distances is None:
            distances = np.full(seen.shape[1], np.nan)
            distances[both] = own_distances
            scale = 1.0
        else:
            common = np.isfinite(distances[both])
            if common.sum() < 3:
                return None
            scale = float(np.median(distances[both][common] / own_distances[common]))
        turns.append(start.turns[0] @ first_from_own)
        at.append(start.at[0] + scale * start.turns[0] @ baseline)
    return Poses(np.array(turns), np.array(at))


def _relative_pose(first: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """first_from_other, the unit baseline in the first's axes, and the places' distances from the first in baselines (n,)."""
    rows = (first[:, :, None] * other[:, None, :]).reshape(-1, 9)
    essential = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    best, most = None, 0
    for turn in (u @ quarter @ vt, u @ quarter.T @ vt):
        for baseline in (u[:, 2], -u[:, 2]):
            # s first = baseline + t (turn other): least squares for the distances s and t of each place
            ray = other @ turn.T
            cosine = np.einsum("ni,ni->n", first, ray)
            along, back = first @ baseline, ray @ baseline
            sine2 = np.maximum(1 - cosine**2, 1e-9)
            s, t = (along - cosine * back) / sine2, (cosine * along - back) / sine2
            ahead = int(((s > 0) & (t > 0)).sum())
            if ahead > most:
                best, most = (turn, baseline, s), ahead
    return best if most >= LINEAR_PLACES else None


def _scaled(poses: Poses, scale: ScaleBar) -> Poses:
    """The poses with the measured distance, about the first camera."""
    apart = float(np.linalg.norm(poses.at[scale.first] - poses.at[scale.second]))
    return poses._replace(at=poses.at[0] + (poses.at - poses.at[0]) * (scale.metres / max(apart, 1e-9)))
