"""The pose of a flat board: where its points lie in camera axes, and its first estimate from rays.

A pose is (6,) float64: rotation vector and position of the board's origin in m, in camera axes.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation


def points_from_poses(poses: np.ndarray, which: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Board points (n, 2) in camera axes (n, 3); the board of point i has the pose poses[which[i]]."""
    axes = Rotation.from_rotvec(poses[:, :3]).as_matrix()[which]
    return axes[..., 0] * points[:, :1] + axes[..., 1] * points[:, 1:] + poses[which, 3:]


def points_from_pose(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) of one board in camera axes (n, 3)."""
    return points_from_poses(pose[None], np.zeros(len(points), int), points)


def angle_off_axis(seen: np.ndarray) -> np.ndarray:
    """Angle in rad between the optical axis and points (n, 3) in camera axes, (n,)."""
    return np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2])


def pose_from_rays(rays: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pose of a board whose `points` (n, 2) lie on unit `rays` (n, 3), and the angle in rad by which each is missed, (n,).

    ray x (H (X, Y, 1)) = 0 is linear in H = (r1 r2 t) and admits rays in any direction, also behind the camera (direct linear
    transformation; Hartley and Zisserman 2003, "Multiple View Geometry in Computer Vision", section 4.1).
    """
    scale = np.abs(points).max()
    plane = np.column_stack([points / scale, np.ones(len(points))])
    cross = np.cross(rays[:, None], np.eye(3)).transpose(0, 2, 1)  # (n, 3, 3): cross[i] @ v = rays[i] x v
    rows = np.einsum("nac,nd->nacd", cross, plane).reshape(-1, 9)
    h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    if np.sum(rays * (plane @ h.T)) < 0:  # H has no sign of its own: the board lies along the rays, not against them
        h = -h
    unit = math.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1])) or 1.0
    # the nearest rotation to (r1 r2 r1 x r2)
    u, _, vt = np.linalg.svd(np.column_stack([h[:, :2] / unit, np.cross(h[:, 0], h[:, 1]) / unit**2]))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    position = h[:, 2] / unit * scale
    seen = np.column_stack([points, np.zeros(len(points))]) @ rotation.T + position
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    missed = 2 * np.arcsin(np.clip(np.linalg.norm(seen - rays, axis=1) / 2, 0, 1))
    return np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), position]), missed
