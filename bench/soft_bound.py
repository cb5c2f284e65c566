"""How true soft lights can be: sets that know every pixel, fitted to the shadows themselves.

    VEMLIGHT_DATA=... python -m bench.soft_bound [MAP ...]

Writes docs/charts/soft_bound.csv: the error of the best set that was found, for each map and number of lights, and that of the sampler's
own lights beside it. A set begins at the sampler's, with or without sources kept apart, and its powers, means and covariances follow the
gradient of the mean square error at random surfaces behind hard edges (Adam: Kingma and Ba 2015), minutes a map. Better sets may exist.
"""

import csv
import math
import sys
from pathlib import Path

import numpy as np
from numba import njit

from bench.accuracy.maps import maps
from bench.evaluation import Source, judged_hard, points_of, probe_irradiance, read_source, relative_rms
from vemlight.files import written_whole
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import MIN_SPREAD_RAD
from vemlight.sampler.tracking.extents import soft_lights
from vemlight.sampler.tracking.sources import no_source_tiles
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.sampler.tracking.tracked import initial_tracked, tracked_step
from vemlight.sampler.tracking.voronoi import cells_from_sites

OUT = Path(__file__).parents[1] / "docs" / "charts" / "soft_bound.csv"
COUNTS = (8, 16, 64, 256)
PROBES = 16384  # surfaces that a set is fitted to: thirteen numbers a light, 3328 of 256 lights
BATCH = 2048  # of them in a step
STEPS = 300
RATE = 0.03  # of a step: of a power's logarithm, and of a mean and a covariance's root in units of the light's own spread
FIRST_MOMENT, SECOND_MOMENT = 0.9, 0.999  # Adam's


def fitted(source: Source, lights: LightSet, seed: int = 0) -> LightSet:
    """Soft lights that begin at these, which keep their colours."""
    assert lights.covariances is not None
    generator, points = np.random.default_rng(seed), points_of(source)
    normals, edges = (_directions(generator, PROBES, upper) for upper in (True, False))
    truth = np.zeros(PROBES)
    _gather_points(normals, edges, points.directions, luminance_from_rgb(points.irradiance), truth)

    # Power, mean and root of the covariance; all steps are relative to the power and the spread at the start.
    tint = lights.irradiance / np.maximum(luminance_from_rgb(lights.irradiance.astype(float)), 1e-30)[:, None]
    power = luminance_from_rgb(lights.irradiance.astype(float))
    full = lights.covariances.astype(float)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]] + MIN_SPREAD_RAD**2 * np.eye(3)
    roots, spread = np.linalg.cholesky(full), np.sqrt(np.trace(full, axis1=1, axis2=2) / 2)
    means = np.sqrt(np.maximum(1 - np.trace(full, axis1=1, axis2=2), 1e-6))[:, None] * lights.directions
    moments, best, chosen = np.zeros((2, len(power), 13)), math.inf, (power, means, roots)
    for step in range(1, STEPS + 1):
        batch = generator.integers(0, PROBES, BATCH)
        slopes = np.zeros((len(power), 13))
        _gradient(normals[batch], edges[batch], truth[batch], power, means, roots, slopes)
        slopes *= np.concatenate([power[:, None], np.repeat(spread[:, None], 12, axis=1)], axis=1)
        moments[0] += (1 - FIRST_MOMENT) * (slopes - moments[0])
        moments[1] += (1 - SECOND_MOMENT) * (slopes**2 - moments[1])
        mean, square = moments[0] / (1 - FIRST_MOMENT**step), moments[1] / (1 - SECOND_MOMENT**step)
        move = RATE * 0.5 * (1 + math.cos(math.pi * step / STEPS)) * mean / (np.sqrt(square) + 1e-12)
        power = power * np.exp(-move[:, 0])
        means, roots = means - spread[:, None] * move[:, 1:4], roots - spread[:, None, None] * move[:, 4:].reshape(-1, 3, 3)
        means *= (np.sqrt(np.clip(1 - (roots**2).sum(axis=(1, 2)), 1e-6, 1)) / np.linalg.norm(means, axis=1))[:, None]
        if step % 25 == 0:
            error = _gradient(normals, edges, truth, power, means, roots, np.zeros((len(power), 13)))
            if error < best:
                best, chosen = error, (power, means, roots)
    power, means, roots = chosen
    covariances = (roots @ roots.transpose(0, 2, 1))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    directions = means / np.linalg.norm(means, axis=1, keepdims=True)
    return LightSet.of(lights.ids, directions, power[:, None] * tint, covariances)


def _without_sources(source: Source, count: int) -> LightSet:
    """The sampler's soft lights, as they are where nothing is kept apart."""
    frame = SamplerInput(source.polar, "hemisphere", 0.0, source.bright_cells)
    state, _, _ = tracked_step(count, initial_tracked(), frame, False)
    tiles = tiles_from_map(source.polar, "hemisphere", max(count, 128), source.bright_cells)
    sites = state.sites
    cells = cells_from_sites(tiles, sites.directions)
    return soft_lights(tiles, sites.ids, sites.directions, cells.assignment, no_source_tiles(tiles))


def _directions(generator: np.random.Generator, count: int, upper: bool) -> np.ndarray:
    directions = generator.standard_normal((count, 3))
    directions[:, 2] = np.abs(directions[:, 2]) if upper else directions[:, 2]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@njit(cache=True, fastmath=True)
def _gather_points(normals, edges, directions, power, result):
    for k in range(normals.shape[0]):
        total = 0.0
        for n in range(power.size):
            x, y, z = directions[n, 0], directions[n, 1], directions[n, 2]
            facing = normals[k, 0] * x + normals[k, 1] * y + normals[k, 2] * z
            height = edges[k, 0] * x + edges[k, 1] * y + edges[k, 2] * z
            total += power[n] * facing if facing > 0 and height > 0 else 0.0
        result[k] = total


@njit(cache=True)
def _gradient(normals, edges, truth, power, means, roots, slopes):
    """Mean square error at the surfaces; adds its gradient by power, mean (3) and root of covariance (9) to slopes (n, 13)."""
    n, least, total, per = power.size, MIN_SPREAD_RAD**2, 0.0, 1 / truth.size
    values, terms = np.empty(n), np.empty((n, 8))
    for k in range(truth.size):
        nx, ny, nz = normals[k]
        hx, hy, hz = edges[k]
        got = 0.0
        for i in range(n):
            facing = nx * means[i, 0] + ny * means[i, 1] + nz * means[i, 2]
            a = roots[i, 0, 0] * hx + roots[i, 1, 0] * hy + roots[i, 2, 0] * hz
            b = roots[i, 0, 1] * hx + roots[i, 1, 1] * hy + roots[i, 2, 1] * hz
            c = roots[i, 0, 2] * hx + roots[i, 1, 2] * hy + roots[i, 2, 2] * hz
            v = math.sqrt(a * a + b * b + c * c + least)
            x = (hx * means[i, 0] + hy * means[i, 1] + hz * means[i, 2]) / v
            # Facing as of a light with extent, by the covariance along the normal.
            p = roots[i, 0, 0] * nx + roots[i, 1, 0] * ny + roots[i, 2, 0] * nz
            q = roots[i, 0, 1] * nx + roots[i, 1, 1] * ny + roots[i, 2, 1] * nz
            r = roots[i, 0, 2] * nx + roots[i, 1, 2] * ny + roots[i, 2, 2] * nz
            u = math.sqrt(p * p + q * q + r * r + least)
            y = facing / u
            lit = 0.5 * math.erfc(-y / math.sqrt(2)) if y > -6 else 0.0
            seen = 0.5 * math.erfc(-x / math.sqrt(2)) if x > -6 else 0.0
            received = facing * lit + u * 0.3989422804014327 * math.exp(-0.5 * min(y * y, 80.0))
            values[i] = received * seen
            edge = 0.3989422804014327 * math.exp(-0.5 * min(x * x, 80.0)) / v
            terms[i] = lit, seen, received, edge, x / v, a, b, c
            got += power[i] * values[i]
        difference = got - truth[k]
        total += per * difference * difference
        for i in range(n):
            lit, seen, received, edge, steep, a, b, c = terms[i]
            scale = 2 * per * difference
            slopes[i, 0] += scale * values[i]
            scale *= power[i]
            slopes[i, 1] += scale * (lit * seen * nx + received * edge * hx)
            slopes[i, 2] += scale * (lit * seen * ny + received * edge * hy)
            slopes[i, 3] += scale * (lit * seen * nz + received * edge * hz)
            wide = -scale * received * edge * steep
            slopes[i, 4] += wide * hx * a
            slopes[i, 5] += wide * hx * b
            slopes[i, 6] += wide * hx * c
            slopes[i, 7] += wide * hy * a
            slopes[i, 8] += wide * hy * b
            slopes[i, 9] += wide * hy * c
            slopes[i, 10] += wide * hz * a
            slopes[i, 11] += wide * hz * b
            slopes[i, 12] += wide * hz * c
    return total


def main() -> None:
    chosen = [path for path in maps() if not sys.argv[1:] or path.stem in sys.argv[1:]]
    rows = []
    if OUT.exists():
        with open(OUT, newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["map"] not in {path.stem for path in chosen}]
    for path in chosen:
        source = read_source(path)
        truth = probe_irradiance(points_of(source), 1).hard.astype(float)
        for count in COUNTS:
            frame = SamplerInput(source.polar, "hemisphere", 0.0, source.bright_cells)
            _, own, _ = tracked_step(count, initial_tracked(), frame, False, True)
            sets = own, _without_sources(source, count)
            found = *sets, *(fitted(source, lights) for lights in sets)
            own_error, *errors = (relative_rms(judged_hard(lights) - truth, truth) for lights in found)
            rows.append({"map": path.stem, "lights": count, "soft": f"{own_error:.4g}", "bound": f"{min(own_error, *errors):.4g}"})
            print(*rows[-1].values(), flush=True)
        with written_whole(OUT) as part, open(part, "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
