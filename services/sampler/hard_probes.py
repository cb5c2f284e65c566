"""The error of lights at small surfaces, each behind an occluder with a hard edge: what `error_percent` limits.

A probe is a surface's normal n and the normal h of a half-space of free sky. Its error is relative to what it receives itself and to
DARK_PROBE of the mean, so that the few lights left for the sky must do in the shadow of a strong sun. Softened edges would not do: lights
for an error of 5 % at edges of 2 degrees have 8 % at hard ones where lamps are few.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.probes import probes
from vemlight.sampler.score import MIN_SPREAD_RAD
from vemlight.sampler.tracking.tiles import Tiles

HARD_PROBES = 1024  # with 256 the error is exceeded at a tenth of it where lamps are few
SLICES = 16  # of the probes, each as even as the whole: one a frame while nothing happens
DARK_PROBE = 0.05  # of the mean irradiance, below which an error is no longer relative to the probe's own
BLOCK = 256  # probes at a time, whose nine arrays stay in the first-level cache; changes the time alone
HARD_EDGE = np.float32(1e8)  # slope of a light without extent


class HardProbes(NamedTuple):
    """normals, occluders: (3, k) float32 unit vectors. upward: 1 for normals of the upper half, 0 for those of the whole sphere."""

    normals: np.ndarray
    occluders: np.ndarray
    upward: float


@lru_cache(maxsize=64)
def hard_probes(coverage: Coverage, first: int = 0, end: int = HARD_PROBES, step: int = 1) -> HardProbes:
    """Those of the fixed sequence from `first` to before `end`, one in so many: the whole, a slice, or others to judge a choice by."""
    normals, occluders = (np.ascontiguousarray(axes[first:end:step].T, np.float32) for axes in probes(end, coverage))
    return HardProbes(normals, occluders, 1.0 if coverage == "hemisphere" else 0.0)


def slice_of_probes(coverage: Coverage, part: int) -> HardProbes:
    """One of SLICES parts of the probes."""
    return hard_probes(coverage, part, HARD_PROBES, SLICES)


def map_irradiance_at(at: HardProbes, tiles: Tiles) -> np.ndarray:
    """Luminance (k,) float32 of the irradiance from tiles, each an even square."""
    result = np.zeros(at.normals.shape[1], np.float32)
    _add_even(at.normals, at.occluders, tiles.direction, tiles.power, 1 / (np.sqrt(2) * tiles.radius), result)
    return result


def dark_irradiance(at: HardProbes, tiles: Tiles) -> float:
    """DARK_PROBE of the mean irradiance over all normals and occluders.

    Light from d gives on average (1 + d.z) / 8 over the normals of the upper half, 1 / 8 over those of the sphere.
    """
    return float(DARK_PROBE * (tiles.power.sum() + at.upward * (tiles.power @ tiles.direction[2])) / 8)


def lights_irradiance_at(at: HardProbes, lights: LightSet) -> np.ndarray:
    """The same (k,) from lights, by the formula of proto/README.md where they have extents."""
    result = np.zeros(at.normals.shape[1], np.float32)
    power, directions = lights.irradiance @ LUMINANCE_WEIGHTS, np.ascontiguousarray(lights.directions.T)
    if lights.covariances is None:
        _add_even(at.normals, at.occluders, directions, power, np.full(len(power), HARD_EDGE), result)
    else:
        _add_gaussians(at.normals, at.occluders, directions, power, lights.covariances, result)
    return result


def relative_squares(at: HardProbes, tiles: Tiles, lights: LightSet) -> np.ndarray:
    """Squared relative errors (k,) of lights, at the probes."""
    truth, dark = map_irradiance_at(at, tiles), dark_irradiance(at, tiles)
    return ((lights_irradiance_at(at, lights) - truth) / (truth + dark)) ** 2 if dark > 0 else np.zeros_like(truth)


def prefix_errors(at: HardProbes, tiles: Tiles, directions: np.ndarray, power: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Relative errors, RMS over the probes and a standard error more, of the first `sizes` (s,) of points (n, 3) of `power` (n,), scaled to
    the tiles' power."""
    truth, dark, whole = map_irradiance_at(at, tiles), dark_irradiance(at, tiles), tiles.power.sum()
    result, last, errors = np.zeros_like(truth), 0, np.empty(len(sizes))
    across, edges, used = np.ascontiguousarray(directions.T), np.full(len(power), HARD_EDGE), np.cumsum(power)
    for s, size in enumerate(sizes):
        _add_even(at.normals, at.occluders, across[:, last:size], power[last:size], edges[last:size], result)
        scale = whole / used[size - 1] if used[size - 1] > 0 else 0.0
        squares = ((scale * result - truth) / (truth + dark)) ** 2
        last, errors[s] = size, np.sqrt(squares.mean() + squares.std() / np.sqrt(squares.size))
    return errors


@kernel
def _add_even(normals, occluders, directions, power, slopes, result):
    """Adds to result (k,) the irradiance from directions (3, n); slopes: (n,), by which an edge opens per unit of distance."""
    for begin in range(0, result.size, BLOCK):
        end = min(begin + BLOCK, result.size)
        nx, ny, nz = normals[0, begin:end], normals[1, begin:end], normals[2, begin:end]
        hx, hy, hz = occluders[0, begin:end], occluders[1, begin:end], occluders[2, begin:end]
        sums, zero, half, one = result[begin:end], np.float32(0), np.float32(0.5), np.float32(1)
        for t in range(power.size):
            x, y, z = np.float32(directions[0, t]), np.float32(directions[1, t]), np.float32(directions[2, t])
            strength, slope = np.float32(power[t]), np.float32(slopes[t])
            for k in range(sums.size):
                facing, part = nx[k] * x + ny[k] * y + nz[k] * z, half + slope * (hx[k] * x + hy[k] * y + hz[k] * z)
                facing, part = facing if facing > zero else zero, part if part > zero else zero
                sums[k] += strength * facing * (part if part < one else one)


@kernel
def _add_gaussians(normals, occluders, directions, power, covariances, result):
    """Adds to result (k,) the irradiance from lights with extent."""
    for n in range(power.size):
        xx, xy, xz, yy, yz, zz = covariances[n]
        length = np.float32(np.sqrt(max(1 - xx - yy - zz, 0.0)))
        x, y, z = length * directions[0, n], length * directions[1, n], length * directions[2, n]
        _add_gaussian(normals, occluders, (x, y, z), (xx, np.float32(2) * xy, np.float32(2) * xz, yy, np.float32(2) * yz, zz),
                      np.float32(power[n]), result)  # fmt: skip


# Products and sums in any order, so that they are vectorised.
@subroutine(fastmath={"reassoc", "contract", "nsz", "arcp"})
def _add_gaussian(normals, occluders, mean, form, strength, result):
    x, y, z = mean
    a, b, c, d, e, f = form
    least = np.float32(MIN_SPREAD_RAD**2)
    for k in range(result.size):
        nx, ny, nz, hx, hy, hz = normals[0, k], normals[1, k], normals[2, k], occluders[0, k], occluders[1, k], occluders[2, k]
        facing, height = nx * x + ny * y + nz * z, hx * x + hy * y + hz * z
        u2 = a * nx * nx + b * nx * ny + c * nx * nz + d * ny * ny + e * ny * nz + f * nz * nz
        v2 = a * hx * hx + b * hx * hy + c * hx * hz + d * hy * hy + e * hy * hz + f * hz * hz
        u, v = np.sqrt(u2 if u2 > least else least), np.sqrt(v2 if v2 > least else least)
        turned = facing / u
        below, density = _normal_tail(turned)
        part, _ = _normal_tail(height / v)
        result[k] += strength * (facing * below + u * density) * part


@subroutine(inline="always")
def _normal_tail(x):
    """(distribution, density) of the normal distribution to 1e-4 (Abramowitz and Stegun 1964, 26.2.16), without a call of exp."""
    one, half = np.float32(1), np.float32(0.5)
    size = x if x >= 0 else -x
    size = size if size < np.float32(6) else np.float32(6)
    power = one - half * size * size * np.float32(1 / 256)  # exp(-x^2 / 2) = (1 - x^2 / 512)^256
    for _ in range(8):
        power *= power
    density, t = np.float32(0.3989423) * power, one / (one + np.float32(0.33267) * size)
    tail = density * t * (np.float32(0.4361836) + t * (np.float32(-0.1201676) + t * np.float32(0.9372980)))
    return (one - tail if x >= 0 else tail), density
