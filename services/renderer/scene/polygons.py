"""Faces of any number of corners, also concave ones, cut into triangles."""

import numpy as np

FLAT = -1e-9  # of a face's area, by which a fan's triangle may turn back by rounding; any value in -1e-6 .. -1e-12 does
MAX_EAR_STEPS = 2**30  # of a file, 2 to 4 s: a concave face of 20,000 corners, or 100,000 of 50. Beyond, faces are cut as fans

RESTART = -1  # in a strip of triangles


def triangulated(positions: np.ndarray, vertex: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, int]:
    """The triangles of faces whose corners lie one after the other, as numbers of corners (m, 3) int64, in the faces' order.

    positions: (n, 3). vertex: (k,) of each corner. counts: (p,) corners of each face; faces of fewer than three have no triangle. Also
    returns how many faces cannot be cut without crossing their own edges, which come as fans.
    """
    starts = np.cumsum(counts) - counts
    faces, triangles = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)]
    crossed, steps_left = 0, MAX_EAR_STEPS
    for n in np.unique(counts[counts >= 3]).tolist():
        numbers = np.flatnonzero(counts == n)
        corners = starts[numbers, None] + np.arange(n)
        cut = _fan(corners)
        if n > 3:
            points = positions[vertex[corners]]
            for k in np.flatnonzero(~_fans_fill(points)).tolist():
                cut[k], crosses, steps_left = _ears(points[k], corners[k], steps_left)
                crossed += crosses
        faces.append(np.repeat(numbers, n - 2))
        triangles.append(cut.reshape(-1, 3))
    order = np.argsort(np.concatenate(faces), kind="stable")
    return np.concatenate(triangles)[order], crossed


def strip_triangles(numbers: np.ndarray) -> np.ndarray:
    """Triangles (m, 3) of strips (k,) of vertices: each but the first two makes one, every other turned round. RESTART ends a strip."""
    windows = np.lib.stride_tricks.sliding_window_view(numbers, 3) if len(numbers) >= 3 else np.zeros((0, 3), np.int64)
    breaks = numbers < 0
    begin = np.maximum.accumulate(np.where(np.concatenate([[True], breaks[:-1]]), np.arange(len(numbers)), 0))[: len(windows)]
    odd = (np.arange(len(windows)) - begin) % 2 == 1
    turned = np.where(odd[:, None], windows[:, [0, 2, 1]], windows)
    return turned[(windows >= 0).all(axis=1)]


def _fan(corners: np.ndarray) -> np.ndarray:
    """Triangles (faces, n - 2, 3) around the first of each face's corners (faces, n)."""
    return np.stack([np.broadcast_to(corners[:, :1], corners[:, 2:].shape), corners[:, 1:-1], corners[:, 2:]], axis=-1)


def _fans_fill(points: np.ndarray) -> np.ndarray:
    """Whether the fans of faces (faces, n, 3) cover them and nothing else: all triangles face one way and go round once at most.

    True for faces without area and for those that are nan or inf, which nothing helps.
    """
    away = points[:, 1:] - points[:, :1]
    facing = np.cross(away[:, :-1], away[:, 1:])
    whole = facing.sum(axis=1)
    along = np.einsum("fni,fi->fn", facing, whole)
    areas = np.linalg.norm(facing, axis=-1)
    turned = np.arctan2(areas, np.einsum("fni,fni->fn", away[:, :-1], away[:, 1:])).sum(axis=1)
    fills = (along >= FLAT * areas.sum(axis=1, keepdims=True) ** 2).all(axis=1) & (turned < 2 * np.pi) & (along.max(axis=1) > 0)
    has_area = areas.sum(axis=1) > -FLAT * np.square(away).sum(axis=-1).max(axis=1)
    return fills | ~has_area | ~np.isfinite(along).all(axis=1)


def _ears(points: np.ndarray, corners: np.ndarray, steps: int) -> tuple[np.ndarray, bool, int]:
    """The triangles (n - 2, 3) of one face (n, 3), whether they cross its edges, and the steps that are left."""
    from vemlight.renderer.scene.polygon_ears import clip_ears  # here, since it loads numba

    fan = _fan(corners[None])[0]
    away = points[1:] - points[0]
    whole = np.cross(away[:-1], away[1:]).sum(axis=0)
    axis = int(np.abs(whole).argmax())
    x, y = points[:, (axis + 1) % 3], points[:, (axis + 2) % 3]
    if whole[axis] == 0 or steps <= 0:
        return fan, True, steps
    triangles = np.zeros((len(points) - 2, 3), np.int64)
    sign = 1.0 if whole[axis] > 0 else -1.0  # so that it goes round counter-clockwise
    crosses, steps = clip_ears(np.ascontiguousarray(x * sign, np.float64), np.ascontiguousarray(y, np.float64), triangles, steps)
    return (fan if crosses else corners[triangles]), bool(crosses) or not _goes_round_once(x * sign, y), int(steps)


def _goes_round_once(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether the directions of a polygon's edges turn once around, counter-clockwise, as they do unless edges cross."""
    along = np.stack([np.roll(x, -1) - x, np.roll(y, -1) - y], axis=-1)
    along = along[np.any(along != 0, axis=1)]
    after = np.roll(along, -1, axis=0)
    turns = np.arctan2(along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0], np.einsum("ni,ni->n", along, after))
    return bool(round(float(turns.sum()) / (2 * np.pi)) == 1)
