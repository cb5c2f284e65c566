"""Directions, maps of the sphere and their solid angles.

The world is right-handed, metres, +Z up. Azimuth phi goes from +X towards +Y, the polar angle theta from +Z down; directions
point from the scene to the light.

Polar map, shape (rows, cols, 3): row i is centred at theta = (i + 1/2) span / rows and column j at phi = 2 pi (j + 1/2) / cols, where
span is pi/2 (coverage "hemisphere") or pi (coverage "sphere").

Lat-long image, shape (height, width, 3), as seen from inside: the top row is +Z, the centre of the image is +X and a quarter from
the left is +Y, so phi = pi - 2 pi u with u = (column + 1/2) / width.
"""

from typing import Literal

import numpy as np

Coverage = Literal["hemisphere", "sphere"]
SPAN: dict[Coverage, float] = {"hemisphere": np.pi / 2, "sphere": np.pi}


def direction_from_angles(theta: np.ndarray | float, phi: np.ndarray | float) -> np.ndarray:
    """Unit vectors (..., 3) for polar angle `theta` and azimuth `phi` in rad."""
    theta, phi = np.broadcast_arrays(theta, phi)
    s = np.sin(theta)
    return np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)], axis=-1)


def angles_from_direction(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(theta, phi) in rad of directions (..., 3) of any length; phi in [0, 2 pi)."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    phi = np.arctan2(y, x) % (2 * np.pi)
    return np.arctan2(np.hypot(x, y), z), np.where(phi >= 2 * np.pi, 0.0, phi)  # -1e-17 % 2 pi rounds to 2 pi


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle in rad between unit vectors (..., 3), exact for small angles (Kahan: 2 atan2(|a - b|, |a + b|))."""
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def ring_edges(rows: int, coverage: Coverage) -> np.ndarray:
    """Area coordinates a = 1 - cos(theta) of the rows + 1 edges between the map's rings, shape (rows + 1,).

    Written as 2 sin^2(theta / 2), which keeps every digit at the pole; d omega = d a d phi.
    """
    return 2 * np.sin(np.arange(rows + 1) * (SPAN[coverage] / rows) / 2) ** 2


def cell_solid_angles(rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    """Solid angle in sr of one cell in each row of a polar map, shape (rows,)."""
    return np.diff(ring_edges(rows, coverage)) * (2 * np.pi / cols)


def cell_directions(rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    """Unit vectors through the centres of a polar map's cells, shape (rows, cols, 3)."""
    theta = (np.arange(rows) + 0.5) * (SPAN[coverage] / rows)
    phi = (np.arange(cols) + 0.5) * (2 * np.pi / cols)
    return direction_from_angles(theta[:, None], phi[None, :])


def cell_from_direction(direction: np.ndarray, rows: int, cols: int, coverage: Coverage) -> tuple[np.ndarray, np.ndarray]:
    """Continuous (row, column) in a polar map of directions (..., 3): cell i spans [i, i + 1); row > rows lies outside."""
    theta, phi = angles_from_direction(direction)
    return theta * (rows / SPAN[coverage]), phi * (cols / (2 * np.pi))


def map_irradiance(radiance: np.ndarray, coverage: Coverage) -> np.ndarray:
    """Integral of a polar map (rows, cols, 3) over solid angle, (3,) float64: radiance x sr, the sum the lights must have."""
    rows, cols, _ = radiance.shape
    return np.einsum("ijc,i->c", radiance, cell_solid_angles(rows, cols, coverage), dtype=np.float64)


def latlong_directions(height: int, width: int) -> np.ndarray:
    """Unit vectors through the pixel centres of a lat-long image, shape (height, width, 3)."""
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    phi = np.pi - (np.arange(width) + 0.5) * (2 * np.pi / width)
    return direction_from_angles(theta[:, None], phi[None, :])


def latlong_from_direction(direction: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Continuous (row, column) in a lat-long image of directions (..., 3): pixel i spans [i, i + 1), column in [0, width)."""
    theta, phi = angles_from_direction(direction)
    column = ((np.pi - phi) % (2 * np.pi)) * (width / (2 * np.pi))
    return theta * (height / np.pi), np.where(column >= width, 0.0, column)


def latlong_solid_angles(height: int, width: int) -> np.ndarray:
    """Solid angle in sr of one pixel in each row of a lat-long image, shape (height,)."""
    return cell_solid_angles(height, width, "sphere")


def rotation_xyz(degrees: tuple[float, float, float]) -> np.ndarray:
    """Rotation (3, 3) about x, then y, then z (fixed axes), by angles in degrees."""
    x, y, z = np.radians(degrees)
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def quaternion_xyz(degrees: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The unit quaternion x, y, z, w of `rotation_xyz`."""
    (a, b, c), (d, e, f) = np.sin(np.radians(degrees) / 2).tolist(), np.cos(np.radians(degrees) / 2).tolist()
    return (a * e * f - d * b * c, d * b * f + a * e * c, d * e * c - a * b * f, d * e * f + a * b * c)
