"""The light that a level surface receives, and what a flat ground of even albedo sends up of it, as the lower half of a map of the sky."""

import numpy as np

from vemlight.light.bright_cells import BrightCells
from vemlight.light.sphere import Coverage, cell_solid_angles, ring_edges


def horizontal_irradiance(radiance: np.ndarray, bright_cells: BrightCells, coverage: Coverage = "hemisphere") -> np.ndarray:
    """Irradiance (3,) float64 of a level surface that faces up, under a polar map (rows, cols, 3): the integral of radiance x cosine.

    The light of a bright cell counts from where it lies. Cells that are nan, infinite or negative are dark in each such channel.
    """
    rows, cols, _ = radiance.shape
    light = np.where(np.isfinite(radiance) & (radiance > 0), radiance, 0).astype(np.float64)
    # cos(theta) d(omega) = d(sin^2(theta) / 2) d(phi), and sin^2 = a (2 - a) with a = 1 - cos(theta)
    edges = np.minimum(ring_edges(rows, coverage), 1)  # a = 1 is the horizon
    projected = np.diff(edges * (2 - edges)) / 2 * (2 * np.pi / cols)
    total = np.einsum("ijc,i->c", light, projected)
    if len(bright_cells.cells):
        cells, first = np.unique(bright_cells.cells, return_index=True)
        row = cells // cols
        cosine = np.add.reduceat(bright_cells.weights.astype(np.float64) * np.maximum(bright_cells.directions[:, 2], 0), first)
        solid = cell_solid_angles(rows, cols, coverage)[row]
        total += (cosine * solid - projected[row]) @ light.reshape(-1, 3)[cells]
    return np.maximum(total, 0)


def with_ground(radiance: np.ndarray, bright_cells: BrightCells, albedo: float) -> np.ndarray:
    """A hemisphere's polar map (rows, cols, 3) with a ground below: the map (2 rows, cols, 3) float32 of the sphere, whose lower half has
    the radiance of a level Lambertian surface under that sky, albedo / pi x its irradiance. Cells keep their numbers.
    """
    below = np.float32(albedo / np.pi * horizontal_irradiance(radiance, bright_cells))
    return np.concatenate([radiance, np.broadcast_to(below, radiance.shape)])
