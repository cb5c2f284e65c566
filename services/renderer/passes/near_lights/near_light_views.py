"""Where shadow maps of near lights look: through those faces of a cube about a light, and windows in them, in which a receiver lies."""

import numpy as np

from vemlight.renderer.gl.buffers import NEAR_SHADOW_VIEW
from vemlight.renderer.gl.constants import CUBE_TANGENT
from vemlight.renderer.passes.luminaires.depth_range import depth_range

FACES = 6
MAX_RESOLUTION = 1024  # texels a side of a map, as of directional lights
MAX_TEXELS = 2**25  # of all maps: 128 MB of depth; five have maps of 1024 texels a side, 256 have 128
MAX_BOXES = 64  # of receivers apart, beyond which one box counts for all: finding windows stays below a millisecond a light
EDGE_TEXELS = 2  # about what a window is to show, for lookups that are filtered
# The axes of each face: x, y and depth of a view are these components of a vector, depth times a sign; as through_face in cube_faces.glsl.
AXES = np.array([[0, 1, 2], [0, 1, 2], [1, 2, 0], [1, 2, 0], [2, 0, 1], [2, 0, 1]])
SIGNS = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
EDGES = np.array([[a, b] for a in range(8) for b in range(a + 1, 8) if np.abs(CORNERS[a] - CORNERS[b]).sum() == 1])


def map_resolution(slots: int, shadow_map: int | None) -> int:
    """Texels a side of a map where so many lights have maps: as many as MAX_TEXELS allow, a power of two, or the setting's."""
    side = (MAX_TEXELS / (FACES * max(slots, 1))) ** 0.5
    fitting = 1 << int(np.log2(side))
    return min(fitting, shadow_map or MAX_RESOLUTION)


def receiver_boxes(corners: np.ndarray) -> np.ndarray:
    """Boxes (m, 2, 3), low and high, about meshes of corners (m, 8, 3)."""
    return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)


def box_points(boxes: np.ndarray) -> np.ndarray:
    """The corners (m, 8, 3) of boxes (m, 2, 3)."""
    return boxes[:, 0, None] + CORNERS * (boxes[:, 1] - boxes[:, 0])[:, None]


def face_windows(at: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Of each face about a place (3,), the window of tangents (6, 4), low x, low y, high x, high y, that holds what lies in boxes
    (m, 2, 3); high below low where no box reaches the face."""
    points = box_points(boxes) - at
    ends = points[:, EDGES]  # (m, 12, 2, 3)
    windows = np.empty((FACES, 4))
    for face in range(FACES):
        seen = ends[..., AXES[face]]
        depth = seen[..., 2] * SIGNS[face]
        least = 1e-6 * max(float(np.abs(points).max()), 1e-9)
        # Each edge as far as it lies before the light.
        before = np.maximum(depth, least)
        span = depth[..., 1] - depth[..., 0]
        part = np.divide(before - depth[..., :1], span[..., None], out=np.zeros_like(before), where=span[..., None] != 0)
        clipped = seen[..., :1, :2] + part[..., None] * (seen[..., 1:, :2] - seen[..., :1, :2])
        clipped = np.where((depth > least)[..., None], seen[..., :2], clipped)
        tangents = clipped / before[..., None]
        reaches = (depth > least).any(axis=(1, 2))
        low = np.where(reaches[:, None], tangents.min(axis=(1, 2)), np.inf).clip(-CUBE_TANGENT)
        high = np.where(reaches[:, None], tangents.max(axis=(1, 2)), -np.inf).clip(None, CUBE_TANGENT)
        met = np.all(low < high, axis=1)
        windows[face, :2] = np.min(low[met], axis=0, initial=np.inf)
        windows[face, 2:] = np.max(high[met], axis=0, initial=-np.inf)
    return windows


def shadow_views(at: np.ndarray, radius: np.ndarray, slots: np.ndarray, boxes: np.ndarray, resolution: int, columns: int) -> np.ndarray:
    """Six views (n, 6) NEAR_SHADOW_VIEW of each light at (n, 3) of a radius (n,) in its slot's tiles of a grid; `high` below `low` where
    there is nothing to see. boxes: (m, 2, 3), of receivers; of more than MAX_BOXES one about all counts for windows."""
    views = np.zeros((len(at), FACES), NEAR_SHADOW_VIEW.dtype)
    corners = box_points(boxes)
    about = boxes if len(boxes) <= MAX_BOXES else np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])[None]
    for k, place in enumerate(at.astype(np.float64)):
        near_m, far_m = depth_range(place, corners)
        empty_m = float(np.linalg.norm(np.maximum(np.maximum(boxes[:, 0] - place, place - boxes[:, 1]), 0), axis=-1).min())
        # A face's depth is more than half of the distance, also in its corners.
        near_m = min(max(near_m, float(radius[k]) / 2, empty_m / 2), far_m / 2)
        windows = face_windows(place, about)
        edge = EDGE_TEXELS / resolution * np.maximum(windows[:, 2:] - windows[:, :2], 0)
        views["low"][k], views["high"][k] = windows[:, :2] - edge, windows[:, 2:] + edge
        views["inverse_depths"][k] = 1 / near_m, 1 / far_m
    tile = FACES * np.asarray(slots)[:, None] + np.arange(FACES)
    views["corner"] = np.stack([tile % columns, tile // columns], axis=-1) * resolution
    views["origin"], views["radius"], views["face"] = at[:, None], radius[:, None], np.arange(FACES)
    return views
