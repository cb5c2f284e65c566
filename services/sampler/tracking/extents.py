"""Soft lights: the light around each site as a Gaussian distribution of directions, by expectation-maximisation on the tiles.

A few steps from the covariances of the cells and of the sources. Gaussians may overlap, a narrow one on a wide one, so a sun and the sky
around it part by themselves. A tile's weights sum to 1, so the lights hold its light exactly in every channel.
"""

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.light_set import LightSet
from vemlight.sampler.tracking.sources import SourceTiles
from vemlight.sampler.tracking.tiles import Tiles
from vemlight.sampler.tracking.voronoi import Assignment

STEPS = 2  # of expectation-maximisation; 3 take a third longer for 1 % less error, many more fit likelihood instead of shadows
SHARPNESS = np.float32(2.0)  # a tile's weights are likelihoods to this power; any value in 2..3 does, 1 leaves a fifth more error
# Of a small cell's variance: Gaussians that overlap, lit by facing times visibility, blur the shadow of what they stand for. Of skies,
# rooms and lamps, and 8, 16 or 64 lights, all of 0.75..0.9 have a tenth less error than 1
CELL_EXTENT = 0.83
SOURCE_EXTENTS = 0.5, 1.5  # of a source's variance, within which the truest Gaussian is sought: an even disc takes 1.18, a square 1.22
EXTENT_STEPS = 3  # of that search: the first is exact for a Gaussian, the third is within a hundredth for a ring
NEIGHBOURS = 16  # sites near a tile's own that may hold some of it; 8 leave twice the error where lamps are few
RADIUS_STEPS = 16  # of the bisection for them: to a thousandth; 12 or more do
MIN_VARIANCE = np.radians(0.06) ** 2  # across, rad^2: a shadow's edge is never sharper than a tenth of a cell of the map
LEAST_WEIGHT = np.float32(1e-4)  # of a tile's largest weight; smaller ones change nothing that is seen
MIN_HEIGHT = np.float32(1e-6)  # 1 + cosine: of light behind a Gaussian's back
LOG_LEAST = np.float32(np.log(LEAST_WEIGHT))
POWER, FLUX, FIRST, SECOND, SUMS = 0, 1, 4, 7, 13  # columns of the sums: power, flux (3), power x direction (3), x its square (6)

TERMS = 14  # of a Gaussian


def soft_lights(tiles: Tiles, ids: np.ndarray, sites: np.ndarray, assignment: Assignment, sources: SourceTiles) -> LightSet:
    """The sources' and the cells' lights with extent. ids: (s + n,), of the s sources and n sites (n, 3). assignment: of the tiles to the
    sites. A light without power stays at its place, a point.
    """
    places = np.concatenate([sources.directions, sites])
    sums, extents = _sums(tiles, places, assignment, sources)
    power = np.where(sums[:, POWER] > 0, sums[:, POWER], 1.0)[:, None]
    means, x, y = sums[:, FIRST:SECOND] / power, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
    length = np.linalg.norm(means, axis=1, keepdims=True)
    lit = length[:, 0] > 0
    # A cell of half the sky keeps its own variance: its mean, by which it lights what nothing hides, is 1 less the trace.
    extents[len(sources.directions) :] -= (1 - CELL_EXTENT) * length[len(sources.directions) :, 0] ** 8
    covariances = np.where(lit[:, None], extents[:, None] * (sums[:, SECOND:] / power - means[:, x] * means[:, y]), 0.0)
    directions = np.where(lit[:, None], means / np.where(length > 0, length, 1.0), places)
    return LightSet.of(ids, directions, sums[:, FLUX:FIRST], covariances)


@kernel
def _sums(tiles: Tiles, places, assignment: Assignment, sources: SourceTiles):
    """The sums (s + n, SUMS) of the lights at the places of the s sources and n sites, and by what each one's covariance is multiplied."""
    s, held = sources.directions.shape[0], np.zeros(tiles.power.size)
    moments, sums, extents = _moments(tiles), np.zeros((places.shape[0], SUMS)), np.ones(places.shape[0])
    for t in range(tiles.power.size):
        part, overlap = sources.part[t], assignment.overlap[t]
        if part > 0:
            _add(moments, t, part, sums, sources.owner[t])
        _add(moments, t, (1 - part) * (1 - overlap), sums, s + assignment.nearest[t])
        if overlap > 0:
            _add(moments, t, (1 - part) * overlap, sums, s + assignment.second[t])
    around = _nearest_sites(places, s)
    count = around.shape[1]
    weights, near = np.empty(count + 1, np.float32), np.empty((around.shape[0], TERMS, count), np.float32)
    log, of_sources = np.empty(1, np.float32), np.empty((s, TERMS, 1), np.float32)
    for _ in range(STEPS):
        gaussians = _gaussians(sums, places)
        _gather(gaussians, s, around, near)
        for source in range(s):
            for c in range(TERMS):
                of_sources[source, c, 0] = gaussians[source, c]
        for k in range(places.shape[0]):
            for c in range(SUMS):
                sums[k, c] = 0.0
        for t in range(tiles.power.size):
            nearest, source = assignment.nearest[t], sources.owner[t] if sources.part[t] > 0 else -1
            _log_likelihoods(tiles, t, near, nearest, weights)
            weights[count] = -np.inf
            if source >= 0:
                _log_likelihoods(tiles, t, of_sources, source, log)
                weights[count] = log[0]
            total = _exponentials(weights)
            for k in range(count):
                if weights[k] > 0:
                    _add(moments, t, weights[k] / total, sums, s + around[nearest, k])
            held[t] = weights[count] / total
            if held[t] > 0:
                _add(moments, t, held[t], sums, source)
    for _ in range(EXTENT_STEPS if s else 0):
        _fit_extents(tiles, sources.owner, held, _gaussians(sums, places), extents[:s])
    return sums, extents


@subroutine
def _fit_extents(tiles, owner, held, gaussians, extents):
    """Improves the factors (s,) of the sources' covariances with which they cast the truest shadows. held: (tiles,), a source's part.

    Along an axis the squared difference between the light's distribution and a Gaussian's of the standard deviation r is least where the
    mean of exp(-x^2 / 2 r^2) is sqrt(1/2), as of the Gaussian itself: the derivative of its energy distance (Szekely and Rizzo 2013). The
    mean is over light and over four axes, the first through the light: of Mahalanobis distance q they have q, q / 2, 0 and q / 2.
    """
    means, power = np.zeros(extents.size), np.zeros(extents.size)
    for t in range(held.size):
        if held[t] > 0:
            k, weight = owner[t], held[t] * tiles.power[t]
            q = _squared_distance(tiles, t, gaussians[k])
            means[k] += weight * (0.5 + 0.5 * np.exp(-0.25 * q / extents[k])) ** 2
            power[k] += weight
    for k in range(extents.size):
        if means[k] > 0:
            fitted = extents[k] * (power[k] ** 2 / means[k] ** 2 - 1)
            extents[k] = min(max(fitted, SOURCE_EXTENTS[0]), SOURCE_EXTENTS[1])


@subroutine
def _squared_distance(tiles, t, gaussian):
    """Squared Mahalanobis distance of a tile's direction, without what MIN_VARIANCE adds to an even light's extent."""
    x, y, z = tiles.direction[0, t], tiles.direction[1, t], tiles.direction[2, t]
    u, v = x * gaussian[3] + y * gaussian[4] + z * gaussian[5], x * gaussian[6] + y * gaussian[7] + z * gaussian[8]
    trace = (gaussian[9] + gaussian[11]) / (gaussian[9] * gaussian[11] - gaussian[10] ** 2)
    own = max(trace - 2 * MIN_VARIANCE, 2 * MIN_VARIANCE)
    return (u * u * gaussian[9] + 2 * u * v * gaussian[10] + v * v * gaussian[11]) * trace / own


@subroutine
def _moments(tiles):
    """(tiles, SUMS): what each tile adds to the sums of a light that has all of it."""
    made = np.zeros((tiles.power.size, SUMS))
    for t in range(tiles.power.size):
        m, x, y, z = made[t], tiles.direction[0, t], tiles.direction[1, t], tiles.direction[2, t]
        power, spread = tiles.power[t], _tile_spread(tiles, t)
        across, flat = power * (1 - spread / (x * x + y * y + z * z)), power * spread
        m[0], m[1], m[2], m[3], m[4], m[5], m[6] = (
            power, tiles.flux[0, t], tiles.flux[1, t], tiles.flux[2, t], power * x, power * y, power * z,
        )  # fmt: skip
        m[7], m[8], m[9] = across * x * x + flat, across * x * y, across * x * z
        m[10], m[11], m[12] = across * y * y + flat, across * y * z, across * z * z + flat
    return made


@subroutine(inline="always")
def _add(moments, t, weight, sums, k):
    for c in range(SUMS):
        sums[k, c] += weight * moments[t, c]


@subroutine
def _gather(gaussians, first, around, near):
    """Fills near (n, TERMS, k) with the Gaussians, from the `first` on, of the sites around each site.

    Term by term, so that they are computed side by side.
    """
    for s in range(around.shape[0]):
        for k in range(around.shape[1]):
            for c in range(TERMS):
                near[s, c, k] = gaussians[first + around[s, k], c]


# Comparisons in place of max() and sums in any order, so that the loops compute several at a time.
@subroutine(fastmath={"reassoc", "contract", "nsz"})
def _exponentials(logs):
    """Puts exp(log - largest) in the place of each log, 0 below LEAST_WEIGHT; returns their sum.

    (1 + x / 1024)^1024 is 0.2 % below exp(x) at a seventh of the largest weight, and smooth; the sum of a tile's weights stays 1.
    """
    best, total, one = logs[0], np.float32(0), np.float32(1)
    for k in range(logs.size):
        best = logs[k] if logs[k] > best else best
    for k in range(logs.size):
        x = logs[k] - best
        power = one + (x if x > LOG_LEAST else LOG_LEAST) * np.float32(1 / 1024)
        for _ in range(10):
            power *= power
        logs[k] = power if x > LOG_LEAST else np.float32(0)
        total += logs[k]
    return total


@subroutine
def _nearest_sites(places, first):
    """(n, k) int64: the sites, places from the `first` on, nearest to each site, itself first, in no other order."""
    n = places.shape[0] - first
    k = min(NEIGHBOURS, n)
    around, chords = np.zeros((n, k), np.int64), np.empty(n, np.float32)
    xs, ys, zs = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    for s in range(n):
        xs[s], ys[s], zs[s] = places[first + s, 0], places[first + s, 1], places[first + s, 2]
    for s in range(n):
        x, y, z = xs[s], ys[s], zs[s]
        for other in range(n):
            chords[other] = (xs[other] - x) ** 2 + (ys[other] - y) ** 2 + (zs[other] - z) ** 2
        limit = _radius_of(chords, k)
        around[s, 0], found = s, 1
        for other in range(n):
            if found < k and chords[other] <= limit and other != s:
                around[s, found] = other
                found += 1
    return around


@subroutine
def _radius_of(chords, count):
    """A squared chord within which `count` of these lie and few more: bisected by its logarithm."""
    low, high = np.float32(-50), np.float32(3)  # of 2: no two directions of float32 are nearer, nor farther
    limit = np.float32(2) ** high
    for _ in range(RADIUS_STEPS):
        middle = np.float32(0.5) * (low + high)
        tried, within = np.float32(2) ** middle, np.int32(0)
        for k in range(chords.size):
            within += np.int32(1) if chords[k] <= tried else np.int32(0)
        if within >= count:
            high, limit = middle, tried
        else:
            low = middle
        if within == count:
            break
    return limit


@subroutine
def _gaussians(sums, places):
    """(n, TERMS): centre (3), two axes across (3 each), inverse covariance there (3), log of power / area, half the inverse's trace."""
    made = np.zeros((sums.shape[0], TERMS))
    for s in range(sums.shape[0]):
        g, p = made[s], sums[s, 0]
        length = np.sqrt(sums[s, 4] ** 2 + sums[s, 5] ** 2 + sums[s, 6] ** 2) / p if p > 0 else 0.0
        if length <= 0:
            g[0], g[1], g[2], g[12] = places[s, 0], places[s, 1], places[s, 2], -np.inf
            continue
        mx, my, mz = sums[s, 4] / p, sums[s, 5] / p, sums[s, 6] / p
        # Two axes across the third (Duff et al. 2017).
        x, y, z = mx / length, my / length, mz / length
        sign = 1.0 if z >= 0 else -1.0
        a, b = -1.0 / (sign + z), -x * y / (sign + z)
        ux, uy, uz, vx, vy, vz = 1 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y
        xx, xy, xz = sums[s, 7] / p - mx * mx, sums[s, 8] / p - mx * my, sums[s, 9] / p - mx * mz
        yy, yz, zz = sums[s, 10] / p - my * my, sums[s, 11] / p - my * mz, sums[s, 12] / p - mz * mz
        cx, cy, cz = xx * ux + xy * uy + xz * uz, xy * ux + yy * uy + yz * uz, xz * ux + yz * uy + zz * uz
        uu, uv = ux * cx + uy * cy + uz * cz, vx * cx + vy * cy + vz * cz
        vv = vx * (xx * vx + xy * vy + xz * vz) + vy * (xy * vx + yy * vy + yz * vz) + vz * (xz * vx + yz * vy + zz * vz)
        # Lambert's coordinates, in which a wide light is measured, have the mean square 2 (1 - |m|).
        scale = max(2 * (1 - length) / max(uu + vv, MIN_VARIANCE), 1.0)
        uu, uv, vv = scale * uu + MIN_VARIANCE, scale * uv, scale * vv + MIN_VARIANCE
        area = uu * vv - uv * uv
        g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8] = x, y, z, ux, uy, uz, vx, vy, vz
        g[9], g[10], g[11], g[12], g[13] = vv / area, -uv / area, uu / area, np.log(p) - 0.5 * np.log(area), 0.5 * (uu + vv) / area
    return made


@subroutine
def _log_likelihoods(tiles, t, near, s, logs):
    """Fills logs (k or more,) with SHARPNESS x the log likelihood of a tile under the Gaussians near[s] (TERMS, k)."""
    x, y, z = np.float32(tiles.direction[0, t]), np.float32(tiles.direction[1, t]), np.float32(tiles.direction[2, t])
    spread = np.float32(_tile_spread(tiles, t))
    for k in range(near.shape[2]):
        height = np.float32(1) + x * near[s, 0, k] + y * near[s, 1, k] + z * near[s, 2, k]
        height = height if height > MIN_HEIGHT else MIN_HEIGHT
        u, v = x * near[s, 3, k] + y * near[s, 4, k] + z * near[s, 5, k], x * near[s, 6, k] + y * near[s, 7, k] + z * near[s, 8, k]
        form = u * u * near[s, 9, k] + np.float32(2) * u * v * near[s, 10, k] + v * v * near[s, 11, k]
        logs[k] = SHARPNESS * (near[s, 12, k] - form / height - near[s, 13, k] * spread)  # Lambert's square: 2 form / height


@subroutine(inline="always")
def _tile_spread(tiles, t):
    """Mean square of a tile's own extent along an axis of its tangent plane: its mean direction is shorter than 1 by that."""
    return 0.5 * max(1 - tiles.direction[0, t] ** 2 - tiles.direction[1, t] ** 2 - tiles.direction[2, t] ** 2, 0.0)
