"""What every method is judged by: the irradiance of surfaces, each with a large occluder before it, under the lights and under
the source.

A probe is a surface's normal n and the normal h of a half-space of free sky: E = sum of irradiance x max(0, n . d) x v(h . d). v
is a step ("hard"), or the step softened over +-2 degrees ("soft": a shadow's edge on a map of 256 x 256 texels is no sharper).
The source keeps its strongest pixels apart from the polar grid that the methods see, so that a sun smeared over a grid cell is
an error of the method.
"""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from services.capture.frames import strong_cells
from services.capture.polar import latlong_to_polar, polar_from_latlong
from services.images import read_radiance
from services.lights import Lights
from services.sampler.probes import SOFTNESS, Probes, probes
from services.sphere import (
    LUMINANCE,
    Coverage,
    cell_directions,
    cell_from_direction,
    cell_solid_angles,
    latlong_directions,
    latlong_solid_angles,
    luminance,
)
from services.strong import strong_light

STRONGEST = 4096  # source pixels that are kept apart
PROBES = 1500
BLOCK = 512  # points at a time: 512 x 7 float64 stay in the first-level cache


class Points(NamedTuple):
    """Light from single directions. directions: (n, 3) unit vectors. irradiance: (n, 3); both float64."""

    directions: np.ndarray
    irradiance: np.ndarray


class Source(NamedTuple):
    """A map as it is and as a camera on a polar grid sees it.

    strong: the strongest pixels. rest: (rows, cols, 3) float32, radiance of the remaining ones on the grid. polar: rest and
    strong together, what the methods get. centroids: (k, 5) float64, of the parts of strong cells, as the capture makes
    them: row * cols + column, the flux centroid's unit vector, the share of the cell's light.
    """

    strong: Points
    rest: np.ndarray
    polar: np.ndarray
    centroids: np.ndarray


class Judged(NamedTuple):
    """Irradiance (k, 3) at the probes, with hard and with softened edges."""

    hard: np.ndarray
    soft: np.ndarray


def source_from_latlong(image: np.ndarray, rows: int = 90, cols: int = 360) -> Source:
    """The upper hemisphere of a lat-long image (height, width, 3); spoilt pixels are black."""
    image = np.where(np.isfinite(image) & (image > 0), image, 0).astype(np.float32)
    height, width, _ = image.shape
    flux = image.astype(np.float64) * latlong_solid_angles(height, width)[:, None, None]
    directions = latlong_directions(height, width)
    strength = np.where(directions[..., 2] > 0, luminance(flux), 0.0).ravel()
    chosen = np.argpartition(strength, -STRONGEST)[-STRONGEST:]
    strong = Points(directions.reshape(-1, 3)[chosen], flux.reshape(-1, 3)[chosen])
    image.reshape(-1, 3)[chosen] = 0
    rest = polar_from_latlong(image, latlong_to_polar(height, width, rows, cols, "hemisphere"))
    return with_strong(strong, rest)


def with_strong(strong: Points, rest: np.ndarray) -> Source:
    """The source of strong points above the horizon and a polar map `rest` (rows, cols, 3)."""
    rows, cols, _ = rest.shape
    solid_angles = cell_solid_angles(rows, cols, "hemisphere")
    i, j = cell_from_direction(strong.directions, rows, cols, "hemisphere")
    cell = np.minimum(i.astype(int), rows - 1) * cols + np.minimum(j.astype(int), cols - 1)
    added = np.stack([np.bincount(cell, strong.irradiance[:, c], rows * cols) for c in range(3)], axis=-1).reshape(rows, cols, 3)
    polar = (rest + added / solid_angles[:, None, None]).astype(np.float32)

    # A strong cell's light: its strong points, and the rest at the cell's centre.
    cells = strong_cells(polar, "hemisphere").astype(np.int64)
    own = np.isin(cell, cells)
    beside = (luminance(rest.astype(np.float64)) * solid_angles[:, None]).ravel()[cells]
    directions = np.concatenate([strong.directions[own], cell_directions(rows, cols, "hemisphere").reshape(-1, 3)[cells]])
    flux = np.concatenate([luminance(strong.irradiance)[own], beside])
    parts = strong_light(np.concatenate([cell[own], cells]), directions, flux, rows, cols, "hemisphere")
    return Source(strong, rest, polar, np.column_stack(parts))


@lru_cache(maxsize=16)
def read_source(path: Path) -> Source:
    """The source of a .hdr or .exr lat-long file."""
    return source_from_latlong(read_radiance(path)[0])


def points_of(source: Source) -> Points:
    """All light of a source as single directions."""
    rows, cols, _ = source.rest.shape
    flux = source.rest.astype(np.float64) * cell_solid_angles(rows, cols, "hemisphere")[:, None, None]
    lit = flux.any(axis=-1)
    return Points(
        np.concatenate([source.strong.directions, cell_directions(rows, cols, "hemisphere")[lit]]),
        np.concatenate([source.strong.irradiance, flux[lit]]),
    )


def points_of_lights(lights: Lights) -> Points:
    return Points(lights.directions.astype(np.float64), lights.irradiance.astype(np.float64))


def judge(points: Points, count: int = PROBES, coverage: Coverage = "hemisphere") -> Judged:
    """The irradiance at a fixed set of `count` probes."""
    at: Probes = probes(count, coverage)
    result = Judged(np.empty((count, 3)), np.empty((count, 3)))
    if not len(points.directions):
        return Judged(np.zeros((count, 3)), np.zeros((count, 3)))
    light = np.ascontiguousarray(np.concatenate([points.directions, points.irradiance], axis=1).T)
    _gather(at.normals, at.occluders, light, SOFTNESS, result.hard, result.soft)
    return result


@njit(cache=True, fastmath=True)
def _gather(normals, occluders, light, softness, hard, soft):
    hard[:] = 0.0
    soft[:] = 0.0
    count, gain = light.shape[1], 0.5 / softness
    for start in range(0, count, BLOCK):
        x, y, z, red, green, blue = light[:, start : min(start + BLOCK, count)]
        for k in range(normals.shape[0]):
            nx, ny, nz = normals[k]
            hx, hy, hz = occluders[k]
            h0 = h1 = h2 = s0 = s1 = s2 = 0.0
            for n in range(x.size):
                cosine = max(nx * x[n] + ny * y[n] + nz * z[n], 0.0)
                height = hx * x[n] + hy * y[n] + hz * z[n]
                smooth = cosine * min(max(0.5 + gain * height, 0.0), 1.0)
                sharp = cosine if height > 0 else 0.0
                h0 += sharp * red[n]
                h1 += sharp * green[n]
                h2 += sharp * blue[n]
                s0 += smooth * red[n]
                s1 += smooth * green[n]
                s2 += smooth * blue[n]
            hard[k, 0] += h0
            hard[k, 1] += h1
            hard[k, 2] += h2
            soft[k, 0] += s0
            soft[k, 1] += s1
            soft[k, 2] += s2


def relative_rms(difference: np.ndarray, truth: np.ndarray) -> float:
    """RMS of the difference (k, 3) of luminance, over the mean luminance of `truth` (k, 3)."""
    return float(np.sqrt(np.mean((difference @ LUMINANCE) ** 2)) / np.mean(truth @ LUMINANCE))


def relative_rms_rgb(difference: np.ndarray, truth: np.ndarray) -> float:
    """RMS of the difference (k, 3) over probes and channels, each channel over its own mean in `truth` (k, 3)."""
    return float(np.sqrt(np.mean((difference / truth.mean(axis=0)) ** 2)))
