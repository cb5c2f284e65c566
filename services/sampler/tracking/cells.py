"""Cells of a few sites over many tiles: whose each tile is, what the cells hold, and Lloyd's step."""

import numpy as np
from numba import njit

from vemlight.sampler.tracking.tiles import Tiles

EDGE = 0.0175  # rad, 1 degree, a cell of the map: between directions closer than that an edge hardly tells
RUN = 64  # tiles that are searched together, a register's worth of them at a time, among the sites near them all
LANES = 16  # sites of which the nearest two are kept apart until the end, so that no comparison waits for the last one
FAR = np.float32(9.0)  # each coordinate of what fills up the last lanes: beyond any chord of the unit sphere
LEAST_LENGTH = 0.1  # of a direction with its offset: below it the two are opposite, and their sum says little
ROUNDING = np.float32(1.00001)  # a hundred roundings of float32


@njit(cache=True, error_model="numpy")
def assign(tiles: Tiles, sites, moved, first, second, share):
    """Fills for each tile the nearest site, the next one (-1: none) and the next one's share in [0, 1/2].

    moved: (k,) int64, the sites that have moved since the last time; tiles near none of them may keep what they have. Searched in
    float32: of sites as near as its last digit either can be the nearest.
    """
    n, count = sites.shape[0], first.size
    places = np.full((3, -(-n // LANES) * LANES), FAR)
    for s in range(n):
        for c in range(3):
            places[c, s] = sites[s, c]
    near, names, chords = np.empty((3, n + 1), np.float32), np.empty(n + 1, np.int64), np.empty(places.shape[1], np.float32)
    of, best = np.empty((3, RUN), np.float32), np.empty((4, RUN), np.float32)
    for begin in range(0, count, RUN):
        end = min(begin + RUN, count)
        if moved.size < n and not _touched(tiles, begin, end, sites, moved, first, second):
            continue
        for t in range(RUN):  # the last run is filled up with its last tile
            for c in range(3):
                of[c, t] = tiles.direction[c, min(begin + t, end - 1)]
        found = _near(of, places, n, chords, near, names)
        _nearest_two(of, near, found, best)
        for t in range(begin, end):
            first[t] = names[int(best[2, t - begin])]
            second[t] = names[int(best[3, t - begin])] if n > 1 else -1
            share[t] = _next_share(tiles.radius[t], sites, first[t], second[t], best[0, t - begin], best[1, t - begin])


@njit(cache=True, error_model="numpy")
def _touched(tiles: Tiles, begin, end, sites, moved, first, second):
    """Whether one of the sites `moved` was or comes among the nearest two of one of these tiles."""
    for t in range(begin, end):
        reach = _chord(tiles, t, sites[second[t]])
        for s in moved:
            if s == first[t] or s == second[t] or _chord(tiles, t, sites[s]) <= ROUNDING * reach:
                return True
    return False


@njit(cache=True, error_model="numpy")
def _near(of, places, n, chords, near, names):
    """Fills near (3, found) and names with the sites that can be the nearest or the next of a run of tiles; returns how many.

    With r the reach of the run round its middle, a tile's next site is at most r farther from it than from the middle, and any site at
    most r nearer.
    """
    xs, ys, zs = of
    x, y, z = xs.mean(), ys.mean(), zs.mean()
    reach = np.float32(0)
    for t in range(RUN):
        reach = max(reach, (xs[t] - x) ** 2 + (ys[t] - y) ** 2 + (zs[t] - z) ** 2)
    xs, ys, zs = places
    for s in range(chords.size):
        chords[s] = (xs[s] - x) ** 2 + (ys[s] - y) ** 2 + (zs[s] - z) ** 2
    lanes = np.full((2, LANES), np.float32(1000))  # beyond the chord to FAR
    for start in range(0, chords.size, LANES):
        for k in range(LANES):
            chord, one, two = chords[start + k], lanes[0, k], lanes[1, k]
            worse = one if one > chord else chord
            lanes[1, k] = worse if worse < two else two
            lanes[0, k] = chord if chord < one else one
    best = after = np.float32(1000)
    for k in range(LANES):
        after = min(after, max(best, lanes[0, k]), lanes[1, k])
        best = min(best, lanes[0, k])
    limit = (np.sqrt(after) + np.float32(2) * np.sqrt(reach)) ** 2 * ROUNDING
    found = 0
    for s in range(n):
        names[found] = s
        found += chords[s] <= limit  # kept when the end goes on; without a branch that no processor foresees
    for k in range(found):
        near[0, k], near[1, k], near[2, k] = xs[names[k]], ys[names[k]], zs[names[k]]
    return found


@njit(cache=True, error_model="numpy")
def _nearest_two(of, near, found, best):
    """Fills best (4, RUN) for a run of tiles: squared chords to the nearest and the next of `found` sites, and which these are.

    All in float32, which holds whole numbers up to 2^24, so that the loop over the tiles needs no branch and one register each.
    """
    best[:2], best[2:] = FAR, 0
    for k in range(found):
        x, y, z, name = near[0, k], near[1, k], near[2, k], np.float32(k)
        for t in range(RUN):
            chord = (of[0, t] - x) ** 2 + (of[1, t] - y) ** 2 + (of[2, t] - z) ** 2
            one, two, a, b = best[0, t], best[1, t], best[2, t], best[3, t]
            closest, closer = chord < one, chord < two
            best[3, t] = a if closest else name if closer else b
            best[1, t] = one if closest else chord if closer else two
            best[2, t] = name if closest else a
            best[0, t] = chord if closest else one


@njit(cache=True, error_model="numpy", inline="always")
def _next_share(radius, sites, a, b, da, db):
    """What of a tile goes to its next site `b`: the border of two cells cuts a disc of the tile's radius (linearly), so that light
    goes over from one cell to the other without a jump. da, db: squared chords to both.
    """
    if b < 0:
        return 0.0
    square = (sites[a, 0] - sites[b, 0]) ** 2 + (sites[a, 1] - sites[b, 1]) ** 2 + (sites[a, 2] - sites[b, 2]) ** 2
    if (db - da) ** 2 >= 4 * square * radius * radius:
        return 0.0
    # Way to the bisector of both sites: (db - da) / (2 |a - b|).
    apart = np.sqrt(square)
    return max(0.5 - (db - da) / (4 * apart * min(radius, 0.25 * apart)), 0.0)


@njit(cache=True, error_model="numpy")
def shares_of_sites(tiles: Tiles, sites):
    """What the sites' cells hold (moment, pull, unease) and whose the tiles are (first, second, share); see `Shares`."""
    count = tiles.power.size
    first, second, share = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    assign(tiles, sites, np.arange(sites.shape[0]), first, second, share)
    return shares_of_tiles(tiles, sites, first, second, share)


@njit(cache=True, error_model="numpy")
def shares_of_tiles(tiles: Tiles, sites, first, second, share):
    """The same when it is known whose the tiles are."""
    n = sites.shape[0]
    moment, pull, unease = np.zeros((n, 4)), np.zeros((n, 3)), np.zeros(n)
    gather(tiles, first, pull)
    for t in range(tiles.power.size):
        _add(tiles, t, (1.0 - share[t]) * tiles.power[t], moment[first[t]])
        if share[t] > 0:
            _add(tiles, t, share[t] * tiles.power[t], moment[second[t]])
    unrest(tiles, first, second, share, moment, sites, unease)
    return moment, pull, unease, first, second, share


@njit(cache=True, error_model="numpy", inline="always")
def _add(tiles, t, power, moment):
    for c in range(3):
        moment[c] += power * tiles.direction[c, t]
    moment[3] += power


@njit(cache=True, error_model="numpy")
def gather(tiles: Tiles, first, pull):
    """Adds to pull (n, 3) the weight x direction of each cell's tiles."""
    for t in range(first.size):
        for c in range(3):
            pull[first[t], c] += tiles.weight[t] * tiles.direction[c, t]


@njit(cache=True, error_model="numpy")
def relaxed(tiles: Tiles, sites, pull, steps):
    """The sites after so many of Lloyd's steps, and what their cells hold. pull: of the sites' cells now."""
    sites, count = sites.copy(), tiles.power.size
    first, second, share = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    every = np.arange(sites.shape[0])
    move(pull, sites)
    for _ in range(steps - 1):
        assign(tiles, sites, every, first, second, share)
        pull = np.zeros((sites.shape[0], 3))
        gather(tiles, first, pull)
        move(pull, sites)
    return sites, shares_of_sites(tiles, sites)


@njit(cache=True, error_model="numpy")
def root(chord):
    """Square root of d^2 / (d + EDGE): the share of shadow edges that matter between two directions a chord d apart."""
    return chord / np.sqrt(chord + EDGE)


@njit(cache=True, error_model="numpy")
def unrest(tiles: Tiles, first, second, share, moment, sites, unease):
    """Adds to unease (n,) each cell's root of its unrest: the sum of power x root(chord to the flux centroid)."""
    centre = centroids(moment, sites)
    for t in range(tiles.power.size):
        unease[first[t]] += (1.0 - share[t]) * tiles.power[t] * root(np.sqrt(_chord(tiles, t, centre[first[t]])))
        if share[t] > 0:
            unease[second[t]] += share[t] * tiles.power[t] * root(np.sqrt(_chord(tiles, t, centre[second[t]])))


@njit(cache=True, error_model="numpy")
def centroid(moment, site, direction):
    """Fills the unit vector of a cell's flux centroid; of its site where the light cancels out or there is none."""
    length = np.sqrt(moment[0] ** 2 + moment[1] ** 2 + moment[2] ** 2)
    for c in range(3):
        direction[c] = moment[c] / length if length > 1e-9 * moment[3] else site[c]


@njit(cache=True, error_model="numpy")
def centroids(moment, sites):
    """Flux centroids (n, 3) of all cells."""
    directions = np.empty((moment.shape[0], 3))
    for s in range(moment.shape[0]):
        centroid(moment[s], sites[s], directions[s])
    return directions


@njit(cache=True, error_model="numpy")
def lights_of_cells(tiles: Tiles, sites, offset, moment, first, second, share):
    """(directions, irradiance), (n, 3) float32, of the cells' lights: flux centroids, beside their places by `offset`."""
    n = sites.shape[0]
    flux, directions, shown = np.zeros((n, 3)), centroids(moment, sites), np.empty((n, 3), np.float32)
    for t in range(first.size):
        for c in range(3):
            flux[first[t], c] += (1.0 - share[t]) * tiles.flux[c, t]
        if share[t] > 0:
            for c in range(3):
                flux[second[t], c] += share[t] * tiles.flux[c, t]
    for s in range(n):
        length = np.sqrt(((directions[s] + offset[s]) ** 2).sum())
        for c in range(3):
            shown[s, c] = (directions[s, c] + offset[s, c]) / length if length > LEAST_LENGTH else directions[s, c]
    return shown, flux.astype(np.float32)


@njit(cache=True, error_model="numpy")
def move(pull, sites):
    """Lloyd's step: every site with light goes to the weighted centroid of its cell."""
    for s in range(sites.shape[0]):
        length = np.sqrt(pull[s, 0] ** 2 + pull[s, 1] ** 2 + pull[s, 2] ** 2)
        if length > 0:
            for c in range(3):
                sites[s, c] = pull[s, c] / length


@njit(cache=True, error_model="numpy", inline="always")
def _chord(tiles, t, site):
    """Squared chord."""
    return (tiles.direction[0, t] - site[0]) ** 2 + (tiles.direction[1, t] - site[1]) ** 2 + (tiles.direction[2, t] - site[2]) ** 2
