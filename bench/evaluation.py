"""The measure of every method: the irradiance of surfaces, each with a large occluder before it, under the lights and under
the source.

A probe is a surface's normal n and the normal h of a half-space of free sky: E = sum of irradiance x max(0, n . d) x v(h . d). v
is a step ("hard"), or the step softened over +-2 degrees ("soft": a shadow's edge on a map of 256 x 256 texels is no sharper).
An edge is seldom near a small sun, and the error there is large: of 1500 independent probes five would decide it. So each of CIRCLES
surfaces has its occluder turned once round an axis, in TURNS steps; each light is visible in half of them, so one pass makes all the sums.
The brightest pixels of the source are not resampled to the polar grid that the methods see, so a sun smeared over a grid cell
is an error of the method.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.capture.frames import brightest_cells
from vemlight.capture.polar import latlong_to_polar, polar_from_latlong
from vemlight.light.bright_cells import BrightCells, bright_cells_from_light
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import (
    Coverage,
    cell_directions,
    cell_from_direction,
    cell_solid_angles,
    latlong_directions,
    latlong_solid_angles,
)
from vemlight.sampler.probes import SOFTNESS, probes
from vemlight.sampler.score import MIN_SPREAD_RAD, irradiance_of_soft_lights

BRIGHTEST = 4096  # source pixels that are not resampled to the grid
PROBES = 1500  # with soft edges
CIRCLES = 100  # with hard ones: they know the error of a misplaced sun to 8 %, 6000 independent probes to 45 %
TURNS = 1024  # a third of a degree, a pixel of the source; the steps of different circles do not coincide
BLOCK = 512  # points at a time: 512 x 7 float64 stay in the first-level cache


class Points(NamedTuple):
    """Light from single directions. directions: (n, 3) unit vectors. irradiance: (n, 3); both float64."""

    directions: np.ndarray
    irradiance: np.ndarray


class Source(NamedTuple):
    """A map as it is and as a camera on a polar grid sees it.

    brightest: pixels that are not resampled. rest: (rows, cols, 3) float32, radiance of the others on the grid. polar: both together,
    what the methods get. bright_cells: sub-cell samples, as the capture makes them.
    """

    brightest: Points
    rest: np.ndarray
    polar: np.ndarray
    bright_cells: BrightCells


class ProbeIrradiance(NamedTuple):
    """Irradiance at the probes: hard (CIRCLES * TURNS, 3) float32 with hard edges, soft (k, 3) float64 with softened ones."""

    hard: np.ndarray
    soft: np.ndarray


def source_from_latlong(image: np.ndarray, rows: int = 90, cols: int = 360) -> Source:
    """The upper hemisphere of a lat-long image (height, width, 3); invalid pixels are black."""
    image = np.where(np.isfinite(image) & (image > 0), image, 0).astype(np.float32)
    height, width, _ = image.shape
    flux = image.astype(np.float64) * latlong_solid_angles(height, width)[:, None, None]
    directions = latlong_directions(height, width)
    strength = np.where(directions[..., 2] > 0, luminance_from_rgb(flux), 0.0).ravel()
    chosen = np.argpartition(strength, -BRIGHTEST)[-BRIGHTEST:]
    brightest = Points(directions.reshape(-1, 3)[chosen], flux.reshape(-1, 3)[chosen])
    image.reshape(-1, 3)[chosen] = 0
    rest = polar_from_latlong(image, latlong_to_polar(height, width, rows, cols, "hemisphere"))
    return with_brightest(brightest, rest)


def with_brightest(brightest: Points, rest: np.ndarray) -> Source:
    """The source of its brightest pixels above the horizon and a polar map `rest` (rows, cols, 3)."""
    rows, cols, _ = rest.shape
    solid_angles = cell_solid_angles(rows, cols, "hemisphere")
    i, j = cell_from_direction(brightest.directions, rows, cols, "hemisphere")
    cell = np.minimum(i.astype(int), rows - 1) * cols + np.minimum(j.astype(int), cols - 1)
    added = np.stack([np.bincount(cell, brightest.irradiance[:, c], rows * cols) for c in range(3)], axis=-1).reshape(rows, cols, 3)
    polar = (rest + added / solid_angles[:, None, None]).astype(np.float32)

    # A bright cell's light: its brightest pixels, and the rest at the cell's centre.
    cells = brightest_cells(polar, "hemisphere").astype(np.int64)
    own = np.isin(cell, cells)
    remaining = (luminance_from_rgb(rest.astype(np.float64)) * solid_angles[:, None]).ravel()[cells]
    directions = np.concatenate([brightest.directions[own], cell_directions(rows, cols, "hemisphere").reshape(-1, 3)[cells]])
    flux = np.concatenate([luminance_from_rgb(brightest.irradiance)[own], remaining])
    bright_cells = bright_cells_from_light(np.concatenate([cell[own], cells]), directions, flux, rows, cols, "hemisphere")
    return Source(brightest, rest, polar, bright_cells)


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
        np.concatenate([source.brightest.directions, cell_directions(rows, cols, "hemisphere")[lit]]),
        np.concatenate([source.brightest.irradiance, flux[lit]]),
    )


def points_of_lights(lights: LightSet) -> Points:
    return Points(lights.directions.astype(np.float64), lights.irradiance.astype(np.float64))


def probe_irradiance(points: Points, count: int = PROBES, coverage: Coverage = "hemisphere") -> ProbeIrradiance:
    """The irradiance at a fixed set of probes, `count` of them with soft edges."""
    light = np.ascontiguousarray(np.concatenate([points.directions, points.irradiance], axis=1))
    result = ProbeIrradiance(np.zeros((CIRCLES * TURNS, 3), np.float32), np.zeros((count, 3)))
    _gather_hard(*probes(CIRCLES, coverage), light, result.hard.reshape(CIRCLES, TURNS, 3))
    if len(light):
        _gather_soft(*probes(count, coverage), np.ascontiguousarray(light.T), SOFTNESS, result.soft)
    return result


def judged_softened(lights: LightSet, count: int = PROBES) -> np.ndarray:
    """Luminance (count,) of the irradiance at probes with softened edges, under lights with extent or without."""
    if lights.covariances is None:
        return luminance_from_rgb(probe_irradiance(points_of_lights(lights), count).soft)
    at = probes(count, "hemisphere")
    return irradiance_of_soft_lights(at, lights.directions, luminance_from_rgb(lights.irradiance.astype(float)), lights.covariances)


def judged_hard(lights: LightSet) -> np.ndarray:
    """Irradiance (CIRCLES * TURNS, 3) of all surfaces under lights, with extent or without."""
    if lights.covariances is None:
        return probe_irradiance(points_of_lights(lights), 1).hard.astype(float)
    covariances = lights.covariances.astype(float)
    means = np.sqrt(np.maximum(1 - covariances[:, [0, 3, 5]].sum(axis=1, keepdims=True), 0)) * lights.directions
    hard = np.zeros((CIRCLES, TURNS, 3))
    _gather_soft_lights(*probes(CIRCLES, "hemisphere"), means, covariances, lights.irradiance.astype(float), hard)
    return hard.reshape(-1, 3)


@njit(cache=True)
def _gather_soft_lights(normals, axes, means, covariances, flux, hard):
    """Adds every light's irradiance to hard (circles, turns, 3), by the formula of `score.irradiance_of_soft_lights`."""
    circles, turns, _ = hard.shape
    for k in range(circles):
        nx, ny, nz = normals[k]
        # Two axes across the third (Duff et al. 2017).
        x, y, z = axes[k]
        sign = 1.0 if z >= 0 else -1.0
        a, b = -1.0 / (sign + z), -x * y / (sign + z)
        across = np.array([[1 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]])
        for light in range(means.shape[0]):
            xx, xy, xz, yy, yz, zz = covariances[light]
            c = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            height = nx * means[light, 0] + ny * means[light, 1] + nz * means[light, 2]
            u = math.sqrt(max(normals[k] @ c @ normals[k], 1e-12))
            facing = 0.5 * height * math.erfc(-height / u / math.sqrt(2)) + u / math.sqrt(2 * math.pi) * math.exp(-0.5 * (height / u) ** 2)
            middle, spread = across @ means[light], across @ c @ across.T
            for t in range(turns):
                p, q = math.cos(2 * math.pi * t / turns), math.sin(2 * math.pi * t / turns)
                v = math.sqrt(max(p * p * spread[0, 0] + 2 * p * q * spread[0, 1] + q * q * spread[1, 1], MIN_SPREAD_RAD**2))
                open_ = 0.5 * math.erfc(-(p * middle[0] + q * middle[1]) / v / math.sqrt(2))
                for channel in range(3):
                    hard[k, t, channel] += flux[light, channel] * facing * open_


@njit(cache=True)
def _gather_hard(normals, axes, light, hard):
    """Fills the irradiance (circles, turns, 3) of surfaces whose occluder turns round an axis."""
    circles, turns, _ = hard.shape
    quarter = turns // 4
    steps = np.empty((turns, 3))  # light that enters a quarter turn after its own place and leaves a quarter turn before
    for k in range(circles):
        nx, ny, nz = normals[k]
        # Two axes across the third (Duff et al. 2017).
        x, y, z = axes[k]
        sign = 1.0 if z >= 0 else -1.0
        a, b = -1.0 / (sign + z), -x * y / (sign + z)
        ux, uy, uz, vx, vy, vz = 1 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y
        steps[:] = 0.0
        for n in range(light.shape[0]):
            cosine = nx * light[n, 0] + ny * light[n, 1] + nz * light[n, 2]
            if cosine > 0:
                along = ux * light[n, 0] + uy * light[n, 1] + uz * light[n, 2]
                across = vx * light[n, 0] + vy * light[n, 1] + vz * light[n, 2]
                at = int((math.atan2(across, along) / (2 * math.pi) + 1) * turns) % turns
                for c in range(3):
                    steps[at, c] += cosine * light[n, 3 + c]
        for c in range(3):
            total = steps[:quarter, c].sum() + steps[turns - quarter :, c].sum()
            for at in range(turns):
                hard[k, at, c] = total
                total += steps[(at + quarter) % turns, c] - steps[at - quarter, c]


@njit(cache=True, fastmath=True)
def _gather_soft(normals, occluders, light, softness, soft):
    count, gain = light.shape[1], 0.5 / softness
    for start in range(0, count, BLOCK):
        x, y, z, red, green, blue = light[:, start : min(start + BLOCK, count)]
        for k in range(normals.shape[0]):
            nx, ny, nz = normals[k]
            hx, hy, hz = occluders[k]
            s0 = s1 = s2 = 0.0
            for n in range(x.size):
                cosine = max(nx * x[n] + ny * y[n] + nz * z[n], 0.0)
                height = hx * x[n] + hy * y[n] + hz * z[n]
                smooth = cosine * min(max(0.5 + gain * height, 0.0), 1.0)
                s0 += smooth * red[n]
                s1 += smooth * green[n]
                s2 += smooth * blue[n]
            soft[k, 0] += s0
            soft[k, 1] += s1
            soft[k, 2] += s2


def relative_rms(difference: np.ndarray, truth: np.ndarray) -> float:
    """RMS of the difference (k, 3) of luminance, over the mean luminance of `truth` (k, 3)."""
    return float(np.sqrt(np.mean(luminance_from_rgb(difference) ** 2)) / np.mean(luminance_from_rgb(truth)))


def relative_rms_rgb(difference: np.ndarray, truth: np.ndarray) -> float:
    """RMS of the difference (k, 3) over probes and channels, each channel over its own mean in `truth` (k, 3)."""
    return float(np.sqrt(np.mean((difference / truth.mean(axis=0)) ** 2)))
