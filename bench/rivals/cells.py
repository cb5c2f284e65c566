"""What these methods read of a polar map: each cell's flux, its place, and lights made of groups of cells."""

from typing import NamedTuple

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles


class Cells(NamedTuple):
    """flux: (rows, cols, 3), RGB. power: (rows, cols), its luminance. directions: (rows, cols, 3). solid_angles: (rows,), sr of a cell."""

    flux: np.ndarray
    power: np.ndarray
    directions: np.ndarray
    solid_angles: np.ndarray


def cells(radiance: np.ndarray, coverage: Coverage) -> Cells:
    """The cells of a map (rows, cols, 3); invalid values are 0."""
    rows, cols, _ = radiance.shape
    solid_angles = cell_solid_angles(rows, cols, coverage)
    flux = np.where(np.isfinite(radiance) & (radiance > 0), radiance, 0).astype(np.float64) * solid_angles[:, None, None]
    return Cells(flux, luminance_from_rgb(flux), cell_directions(rows, cols, coverage), solid_angles)


def lights_of_groups(of: Cells, label: np.ndarray, count: int, directions: np.ndarray | None = None) -> LightSet:
    """One light for each of `count` groups with light: its flux, at `directions` (count, 3) or at the group's flux centroid.

    label: (rows, cols) int, group of each cell; -1: none.
    """
    inside = label.ravel() >= 0
    group = label.ravel()[inside]
    flux = np.stack([np.bincount(group, of.flux.reshape(-1, 3)[inside, c], count) for c in range(3)], axis=-1)
    if directions is None:
        weights = of.power.ravel()[inside]
        places = of.directions.reshape(-1, 3)[inside]
        directions = np.stack([np.bincount(group, weights * places[:, c], count) for c in range(3)], axis=-1)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    lit = (flux.sum(axis=1) > 0) & (length[:, 0] > 0)
    return LightSet.of(np.flatnonzero(lit), directions[lit] / length[lit], flux[lit])
