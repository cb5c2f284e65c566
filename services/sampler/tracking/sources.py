"""Compact sources: a sun, a lamp or a small window, each kept as one light under one id.

A source is what stands out, within SOURCE_RAD, of the ring around it, while it holds a few per cent of the power. Its light is taken out of
the tiles, so that no cell cuts it in parts; an id waits WAIT_S for a source that a cloud hides.
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.light_set import LightSet
from vemlight.sampler.tracking.tiles import WEIGHT_EXPONENT, Tiles

SOURCE_RAD = np.radians(3.0)  # a lamp of 5 degrees with its blur; a larger one has a shape that one direction does not stand for
RING_RAD = np.radians(5.0)  # the ring from SOURCE_RAD to here shows what lies behind a source
ENTER_POWER, STAY_POWER = 0.03, 0.01  # of the map: twice the mean of 64 lights, and less than it
ENTER_RING, STAY_RING = 0.5, 0.7  # light of the ring over the source's own, below which it is compact
MATCH_RAD = np.radians(12.0)  # that a source moves from frame to frame: a camera turned by 300 degrees a second at 25 fps
WAIT_S = 1.0  # an id outlives its source for so long
MAX_PEAKS = 64  # looked at: a map with as many places that hold STAY_POWER has no source above twice that
CORE_SPREADS = 2.0  # to a source's edge: all of an even disc, whose half lies within 0.71 of its radius; a halo is left to the sky
# A sun between four pixels of a camera, or cells of a map, of a degree: the farthest is 1.1 degrees from the middle. 1.1 to 1.5 would do
MIN_CORE_RAD = np.radians(1.2)
WIDEN_S = 1.0  # in which a source's variance may double: of a sun that wanders over the pixels the narrowest sight is the truest
MIN_VARIANCE = np.radians(0.06) ** 2  # rad^2; as in extents.py
LEFT = 0.007  # error of the irradiance that a wide source makes as one Gaussian, as much as 64 lights', above which it begins divided
WIDE_RAD = np.radians(1.07)  # standard deviation, of an even disc of 4.3 degrees: a lamp is narrower, a softbox or window wider
LEFT_GRID, LEFT_REACH = 32, 3.5  # places along an axis at which distributions are compared, out to so many standard deviations
SHIFTS = 3  # from a peak to the middle of its source: each step is a mean over SOURCE_RAD


class Sources(NamedTuple):
    """ids: (s,) int64. directions: (s, 3), where each was last. steps: (s, 3), by how much it had moved since the frame before; 0 when it
    was not there. seen_s: (s,), when it was last there. variances: (s,) rad^2, of its directions along an axis across it, no more than so.
    divided: (s,) bool, whether many lights stand for it, which is decided when it enters.
    """

    ids: np.ndarray
    directions: np.ndarray
    steps: np.ndarray
    seen_s: np.ndarray
    variances: np.ndarray
    divided: np.ndarray


class Peaks(NamedTuple):
    """What stands out of a map.

    directions: (k, 3), centroids. power: (k,), fraction of the map's. ring: (k,), light of the ring over its own, the ring taken to be as
    bright as its upper quartile: a wide light fills more than a quarter of it. left: (k,), the error of the irradiance, relative, that one
    Gaussian in its place makes at the edges of shadows, 0 for a narrow peak. owner: (tiles,) int64, the peak whose core a tile belongs
    to, -1: none. part: (tiles,), the fraction of its light that does.
    """

    directions: np.ndarray
    power: np.ndarray
    ring: np.ndarray
    left: np.ndarray
    owner: np.ndarray
    part: np.ndarray


class SourceTiles(NamedTuple):
    """The light of s sources. directions: (s, 3). owner: (tiles,) int64, the source that a tile belongs to. part: (tiles,), the fraction of
    its light that does.
    """

    directions: np.ndarray
    owner: np.ndarray
    part: np.ndarray


def no_source_tiles(tiles: Tiles) -> SourceTiles:
    """Where nothing is kept apart."""
    n = tiles.power.size
    return SourceTiles(np.zeros((0, 3)), np.zeros(n, np.int64), np.zeros(n))


NO_SOURCES = Sources(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, bool))


def sources_after(before: Sources, peaks: Peaks, time_s: float, next_id: int, max_count: int) -> tuple[Sources, np.ndarray]:
    """The sources known after a frame, and the peak (s,) int64 of each of those that are lit, which come first.

    A peak takes the id of the source that is nearest, where it was last or one more step further, of those that were there in the frame
    before or wait; a new one must stand out more clearly.
    """
    if not len(peaks.power) and not len(before.ids):
        return before, np.zeros(0, np.int64)
    waiting = (time_s - before.seen_s <= WAIT_S) | (before.seen_s >= before.seen_s.max(initial=-np.inf))
    known, ahead = before.ids[waiting].tolist(), before.directions + before.steps
    ahead /= np.sqrt(np.einsum("si,si->s", ahead, ahead))[:, None]
    cosines = np.maximum(peaks.directions @ before.directions[waiting].T, peaks.directions @ ahead[waiting].T)
    ids, near = np.full(len(peaks.power), -1), cosines >= np.cos(MATCH_RAD)
    for _, peak, source in sorted(zip((-cosines[near]).tolist(), *(place.tolist() for place in near.nonzero()), strict=True)):
        if ids[peak] < 0 and known[source] not in ids:
            ids[peak] = known[source]
    stands_out = (peaks.power >= ENTER_POWER) & (peaks.ring <= ENTER_RING)
    lit = np.flatnonzero(stands_out | (ids >= 0))
    lit = np.sort(lit[np.argsort(-peaks.power[lit], kind="stable")[:max_count]])
    new = lit[ids[lit] < 0]
    ids[new] = next_id + np.arange(len(new))

    # Where each of them was before, -1 where it was not.
    names, places = ids[lit].tolist(), {name: n for n, name in enumerate(before.ids.tolist())}
    was = np.array([places.get(name, -1) for name in names], np.int64)
    seen = was >= 0
    hidden = (time_s - before.seen_s <= WAIT_S) & ~np.isin(before.ids, ids[lit])
    steps, variances, divided = np.zeros((len(lit), 3)), np.full(len(lit), np.inf), peaks.left[lit] > LEFT
    steps[seen] = peaks.directions[lit[seen]] - before.directions[was[seen]]
    variances[seen] = (before.variances * (1 + (time_s - before.seen_s) / WIDEN_S))[was[seen]]
    divided[seen] = before.divided[was[seen]]
    after = Sources(
        np.concatenate([ids[lit], before.ids[hidden]]),
        np.concatenate([peaks.directions[lit], before.directions[hidden]]),
        np.concatenate([steps, np.zeros((int(hidden.sum()), 3))]),
        np.concatenate([np.full(len(lit), time_s), before.seen_s[hidden]]),
        np.concatenate([variances, before.variances[hidden]]),
        np.concatenate([divided, before.divided[hidden]]),
    )
    return after, lit


def steady_extents(lights: LightSet, sources: Sources, whole: np.ndarray) -> tuple[LightSet, Sources, np.ndarray]:
    """(lights, sources, narrowing): the lights, of which the first are the sources `whole` (k,), none wider than its source may be now; the
    sources with the extents that these have; and by what each variance (k,) was multiplied.
    """
    if lights.covariances is None or not len(whole):
        return lights, sources, np.ones(len(whole))
    covariances, limits = lights.covariances.astype(np.float64), np.maximum(sources.variances[whole], MIN_VARIANCE)
    seen = covariances[: len(whole), [0, 3, 5]].sum(axis=1) / 2
    shown = np.minimum(seen, limits)
    narrowing = np.where(seen > 0, shown / np.maximum(seen, 1e-30), 1.0)
    covariances[: len(whole)] *= narrowing[:, None]
    variances = sources.variances.copy()
    variances[whole] = np.maximum(shown, MIN_VARIANCE)
    return lights._replace(covariances=covariances.astype(np.float32)), sources._replace(variances=variances), narrowing


def narrowed(tiles: Tiles, sources: SourceTiles, narrowing: np.ndarray) -> Tiles:
    """The tiles with each source drawn together as its light was: a sun between four cells is no wider than in one, and no number of
    lights mends what its map shows. narrowing: (s,), of the variances.
    """
    if not (narrowing < 1).any():
        return tiles
    scale = np.where(sources.part > 0.5, np.sqrt(narrowing)[sources.owner], 1.0)
    centres = sources.directions[sources.owner].T
    direction = np.where(scale < 1, centres + scale * (tiles.direction - centres), tiles.direction)
    return tiles._replace(direction=direction, radius=scale * tiles.radius)


@kernel
def source_lights(tiles: Tiles, peaks, lit):
    """(sources, flux (s, 3), the tiles with the rest of the light) of the peaks `lit` (s,)."""
    n, place = tiles.power.size, np.full(peaks.power.size, -1)
    for k in range(lit.size):
        place[lit[k]] = k
    owner, part, flux, moment = np.zeros(n, np.int64), np.zeros(n), np.zeros((lit.size, 3)), np.zeros((lit.size, 3))
    rest = Tiles(tiles.flux.copy(), tiles.power.copy(), tiles.direction, tiles.weight.copy(), tiles.radius, tiles.area)
    for t in range(n):
        if peaks.owner[t] >= 0 and place[peaks.owner[t]] >= 0:
            owner[t], part[t] = place[peaks.owner[t]], peaks.part[t]
            left = 1 - part[t]
            for c in range(3):
                flux[owner[t], c] += part[t] * tiles.flux[c, t]
                moment[owner[t], c] += part[t] * tiles.power[t] * tiles.direction[c, t]
                rest.flux[c, t] *= left
            rest.power[t], rest.weight[t] = left * rest.power[t], left**WEIGHT_EXPONENT * rest.weight[t]
    for k in range(lit.size):
        length = np.sqrt(moment[k, 0] ** 2 + moment[k, 1] ** 2 + moment[k, 2] ** 2)
        for c in range(3):
            moment[k, c] /= length
    return SourceTiles(moment, owner, part), flux, rest


def peaks_of(tiles: Tiles) -> Peaks:
    """The compact peaks of the tiles that hold STAY_POWER, from the brightest tile down."""
    made, count = _peaks_of(tiles)
    return Peaks(made.directions[:count], made.power[:count], made.ring[:count], made.left[:count], made.owner, made.part)


@kernel
def _peaks_of(tiles: Tiles):
    """(Peaks with room for MAX_PEAKS, how many they are)."""
    n, total = tiles.power.size, 0.0
    power, ring, left, owner, part = np.empty(MAX_PEAKS), np.empty(MAX_PEAKS), np.empty(MAX_PEAKS), np.empty(n, np.int64), np.zeros(n)
    made = Peaks(np.empty((MAX_PEAKS, 3)), power, ring, left, owner, part)
    radiance, dimness = np.empty(n), np.empty(n)
    bright, inside, seen = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for t in range(n):
        total += tiles.power[t]
        radiance[t], made.owner[t], seen[t] = tiles.power[t] / tiles.area[t], -1, 0
    faintest = STAY_POWER * total / (np.pi * SOURCE_RAD**2)  # of which even SOURCE_RAD full holds too little
    candidates, count, looked, centre = np.int64(0), np.int64(0), 0, np.empty(3)
    for t in range(n):
        if radiance[t] >= faintest:
            bright[candidates], dimness[candidates] = t, -radiance[t]
            candidates += 1
    order = _order_of(dimness, candidates)
    for candidate in range(candidates):
        peak = bright[order[candidate]]
        if count == MAX_PEAKS or looked == MAX_PEAKS:
            break
        if seen[peak]:
            continue
        looked += 1
        for c in range(3):
            centre[c] = tiles.direction[c, peak]
        found = _within(tiles, made.owner, centre, inside)
        if _power_of(tiles, inside, found) >= STAY_POWER * total:
            behind, _ = _ring(tiles, radiance, centre)
            for _ in range(SHIFTS):
                _shift(tiles, inside, found, behind, centre)
                found = _within(tiles, made.owner, centre, inside)
            behind, quartile = _ring(tiles, radiance, centre)
            own = _shift(tiles, inside, found, behind, centre)
            around = quartile * np.pi * (RING_RAD**2 - SOURCE_RAD**2)
            if own >= STAY_POWER * total and around <= STAY_RING * own and _is_apart(made.directions, count, centre):
                for c in range(3):
                    made.directions[count, c] = centre[c]
                made.power[count], made.ring[count] = own / total, around / own
                core = max(CORE_SPREADS * _spread(tiles, inside, found, behind, centre, own), MIN_CORE_RAD)
                for k in range(found):
                    t = inside[k]
                    above = 1 - behind / radiance[t]
                    if above > 0 and _chord(tiles, t, centre) <= core**2:
                        made.owner[t], made.part[t] = count, above
                made.left[count] = made.power[count] * _left(tiles, inside, found, made, count)
                count += 1
        seen[peak] = 1
        for k in range(found):
            seen[inside[k]] = 1
    return made, count


@subroutine
def _order_of(values, count):
    """The places (count,) of the first values from the least up, by Shell's sort, of which numba compiles less than of np.argsort."""
    order, gap = np.empty(count, np.int64), count
    for k in range(count):
        order[k] = k
    while gap > 1:
        gap = max(gap * 5 // 11, 1)  # Gonnet's gaps
        for k in range(gap, count):
            taken, place = order[k], k
            while place >= gap and values[order[place - gap]] > values[taken]:
                order[place] = order[place - gap]
                place -= gap
            order[place] = taken
    return order


@subroutine
def _power_of(tiles, inside, found):
    power = 0.0
    for k in range(found):
        power += tiles.power[inside[k]]
    return power


@subroutine
def _is_apart(others, count, centre):
    """Whether a centre lies RING_RAD from all others: nearer light is what a source that is wider than SOURCE_RAD leaves."""
    for k in range(count):
        if (others[k, 0] - centre[0]) ** 2 + (others[k, 1] - centre[1]) ** 2 + (others[k, 2] - centre[2]) ** 2 < RING_RAD**2:
            return False
    return True


@subroutine(inline="always")
def _chord(tiles, t, centre):
    """Squared chord."""
    return (tiles.direction[0, t] - centre[0]) ** 2 + (tiles.direction[1, t] - centre[1]) ** 2 + (tiles.direction[2, t] - centre[2]) ** 2


@subroutine
def _within(tiles, owner, centre, inside):
    """Fills inside with the tiles of no owner whose middle lies within SOURCE_RAD of the centre; returns how many."""
    limit, found = SOURCE_RAD**2, 0
    for t in range(owner.size):
        inside[found] = t
        found += _chord(tiles, t, centre) <= limit and owner[t] < 0
    return found


@subroutine
def _ring(tiles, radiance, centre):
    """(median radiance, upper quartile) of the ring around a centre, of the tiles that reach into it by the area that can lie in it."""
    values, areas, count, area = np.empty(radiance.size), np.empty(radiance.size), 0, 0.0
    for t in range(radiance.size):
        chord = _chord(tiles, t, centre)
        if chord > SOURCE_RAD**2 and chord < (RING_RAD + tiles.radius[t]) ** 2:
            values[count], areas[count] = radiance[t], min(tiles.area[t], np.sqrt(2) * tiles.radius[t] * (RING_RAD - SOURCE_RAD))
            area, count = area + areas[count], count + 1
    if count == 0:
        return 0.0, 0.0
    order = _order_of(values, count)
    reached, median, k = areas[order[0]], -1.0, 0
    while reached < 0.75 * area:
        median = values[order[k]] if median < 0 and reached >= 0.5 * area else median
        k += 1
        reached += areas[order[k]]
    quartile = values[order[k]]
    return quartile if median < 0 else median, quartile


@subroutine
def _shift(tiles, inside, found, behind, centre):
    """Moves the centre to the centroid of the light above `behind` in the first `found` tiles of inside; returns its power."""
    x = y = z = own = 0.0
    for k in range(found):
        t = inside[k]
        above = tiles.power[t] - behind * tiles.area[t]
        if above > 0:
            x, y, z = x + above * tiles.direction[0, t], y + above * tiles.direction[1, t], z + above * tiles.direction[2, t]
            own += above
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0:
        centre[0], centre[1], centre[2] = x / length, y / length, z / length
    return own


@subroutine
def _spread(tiles, inside, found, behind, centre, own):
    """The distance from the centre within which half of the light above `behind` lies."""
    chords = np.empty(found)
    for k in range(found):
        chords[k] = _chord(tiles, inside[k], centre)
    order, reached = _order_of(chords, found), 0.0
    for n in range(found):
        k = order[n]
        reached += max(tiles.power[inside[k]] - behind * tiles.area[inside[k]], 0.0)
        if reached >= 0.5 * own:
            return np.sqrt(chords[k])
    return SOURCE_RAD


@subroutine
def _left(tiles, inside, found, peaks, k):
    """What the best Gaussian leaves of the k-th peak, whose tiles are the first `found` of inside: the RMS difference of irradiance at hard
    edges over the mean irradiance of light that has its direction, 0 for a peak narrower than WIDE_RAD.

    Along each of four axes, with F and G the distributions of light and Gaussian, half the integral of (F - G)^2 is the mean over edges,
    and a surface's facing makes of it 5.3 to 10.7 squared mean irradiances, from the zenith to the horizon.
    """
    x, y, z = peaks.directions[k]
    # Two axes across the third (Duff et al. 2017).
    sign = 1.0 if z >= 0 else -1.0
    a, b = -1.0 / (sign + z), -x * y / (sign + z)
    power, u, v, half, whole = np.zeros(found), np.zeros(found), np.zeros(found), np.zeros(found), 0.0
    for n in range(found):
        t = inside[n]
        if peaks.owner[t] == k:
            dx, dy, dz = tiles.direction[0, t], tiles.direction[1, t], tiles.direction[2, t]
            power[n], half[n] = peaks.part[t] * tiles.power[t], tiles.radius[t] / np.sqrt(2)
            u[n], v[n] = (1 + sign * x * x * a) * dx + sign * b * dy - sign * x * dz, b * dx + (sign + y * y * a) * dy - y * dz
            whole += power[n]
    mean_u = mean_v = square = 0.0
    for n in range(found):
        power[n] /= whole
        mean_u, mean_v = mean_u + power[n] * u[n], mean_v + power[n] * v[n]
    for n in range(found):
        square += power[n] * ((u[n] - mean_u) ** 2 + (v[n] - mean_v) ** 2)
    if square < 2 * WIDE_RAD**2:
        return 0.0
    along, total = np.zeros(found), 0.0
    for axis in range(4):
        p, q = np.cos(0.25 * np.pi * axis), np.sin(0.25 * np.pi * axis)
        for n in range(found):
            along[n] = p * (u[n] - mean_u) + q * (v[n] - mean_v)
        total += _difference(along, power, half)
    return np.sqrt(4.5 * total / 4)


@subroutine
def _difference(along, power, half):
    """The integral of (F - G)^2 of light of this power (n,) at `along` (n,), each even over `half` (n,) either way."""
    variance = least = 0.0
    for t in range(power.size):
        variance += power[t] * (along[t] ** 2 + half[t] ** 2 / 3)
    for t in range(power.size):
        least += power[t] * np.exp(-(along[t] ** 2) / (2 * variance))
    deviation = np.sqrt(variance * (1 / least**2 - 1))  # as in extents.py
    total, step = 0.0, 2 * LEFT_REACH * deviation / LEFT_GRID
    for n in range(LEFT_GRID):
        at = -LEFT_REACH * deviation + (n + 0.5) * step
        below = 0.5 * (1 + math.erf(at / (np.sqrt(2) * deviation)))
        for t in range(power.size):
            if power[t] > 0:
                below -= power[t] * min(max(0.5 + 0.5 * (at - along[t]) / half[t], 0.0), 1.0)
        total += step * below * below
    return total
