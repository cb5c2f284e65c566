"""Cells of a few sites over many tiles: nearest sites, Lloyd's step, the split of the worst cell, the merge of the
cheapest pair.
"""

import numpy as np
from numba import njit

from services.sampler.tracked_tiles import Grid, Tiles

EDGE = 0.0175
SPLIT_ROUNDS = 4  # of two-means inside a cell that is split: enough for two lamps, and Lloyd's later steps do the rest


@njit(cache=True)
def candidates(of: Grid, tiles: Tiles, sites, slack):
    """(near, start): for each base tile, near[start[base] : start[base + 1]] are the sites that can be nearest or next in it.

    They stay so while no site moves by more than the chord `slack`. Searched among those of the base tile's group.
    """
    n, bases, groups = sites.shape[0], of.centres.shape[0], of.group_centres.shape[0]
    every, chords, few, count = np.arange(n), np.empty(n), np.empty((groups, n + 1), np.int32), np.empty(groups, np.int64)
    places = sites.T.copy()
    for g in range(groups):
        count[g] = _near(of.group_centres[g], of.group_reach[g] + slack, places, every, n, chords, few[g], 0)
    own = np.empty((groups, 3, count.max()))
    for g in range(groups):
        for k in range(count[g]):
            for c in range(3):
                own[g, c, k] = sites[few[g, k], c]
    near, start = np.empty(16 * bases + n, np.int64), np.zeros(bases + 1, np.int64)
    for base in range(bases):
        start[base + 1] = start[base]
        if tiles.start[base] == tiles.start[base + 1]:
            continue
        g = of.group[base]
        if start[base] + n >= near.size:
            near = np.concatenate((near, np.empty(near.size + n, np.int64)))
        start[base + 1] = _near(of.centres[base], of.reach[base] + slack, own[g], few[g], count[g], chords, near, start[base])
    return near, start


@njit(cache=True, inline="always")
def _near(centre, reach, places, names, count, chords, near, end):
    """Appends to `near`, from `end` on, the names of those of `count` places (3, n) that can be nearest or next within `reach`."""
    xs, ys, zs = places
    x, y, z = centre
    for k in range(count):
        chords[k] = (xs[k] - x) ** 2 + (ys[k] - y) ** 2 + (zs[k] - z) ** 2
    best = after = 4.0
    for k in range(count):
        after = min(after, max(best, chords[k]))
        best = min(best, chords[k])
    limit = (np.sqrt(after) + 2 * reach) ** 2
    for k in range(count):
        near[end] = names[k]  # kept when the end goes on; without a branch that no processor foresees
        end += chords[k] <= limit
    return end


@njit(cache=True)
def assign(tiles: Tiles, sites, near, start, first, second, share):
    """Fills for each tile the nearest site, the next one (-1: none) and the next one's share in [0, 1/2]. near, start: see `candidates`."""
    most = np.diff(start).max()
    xs, ys, zs, chords = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    for base in range(start.size - 1):
        count = start[base + 1] - start[base]
        names = near[start[base] : start[base + 1]]
        for k in range(count):
            xs[k], ys[k], zs[k] = sites[names[k]]
        for t in range(tiles.start[base], tiles.start[base + 1]):
            x, y, z = tiles.direction[t, 0], tiles.direction[t, 1], tiles.direction[t, 2]
            for k in range(count):
                chords[k] = (xs[k] - x) ** 2 + (ys[k] - y) ** 2 + (zs[k] - z) ** 2
            _nearest_two(t, chords, count, names, tiles.radius[t], sites, first, second, share)


@njit(cache=True, inline="always")
def _nearest_two(t, chords, count, names, radius, sites, first, second, share):
    """Fills what `assign` does for one tile, from its squared chords to so many sites, by their names."""
    a = b = -1
    da = db = 9.0
    for k in range(count):
        d = chords[k]
        closest, closer = d < da, d < db
        b, db = a if closest else k if closer else b, da if closest else d if closer else db
        a, da = k if closest else a, d if closest else da
    first[t] = names[a]
    second[t] = names[b] if b >= 0 else -1
    share[t] = _next_share(radius, sites, first[t], second[t], da, db)


@njit(cache=True, inline="always")
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


@njit(cache=True)
def reassign(tiles: Tiles, sites, changed, first, second, share):
    """What `assign` would fill, once the few sites `changed` (k,) int64 of two or more have moved anywhere."""
    n = sites.shape[0]
    every, chords = np.arange(n), np.empty(n)
    for t in range(first.size):
        again, reach = False, _chord(tiles, t, sites[second[t]])
        for s in changed:
            again |= s == first[t] or s == second[t] or _chord(tiles, t, sites[s]) < reach
        if again:
            for s in range(n):
                chords[s] = _chord(tiles, t, sites[s])
            _nearest_two(t, chords, n, every, tiles.radius[t], sites, first, second, share)


@njit(cache=True)
def shares_of_sites(tiles: Tiles, sites, near, start):
    """What the sites' cells hold (flux, moment, pull, unease) and whose the tiles are (first, second, share); see `Shares`."""
    count = tiles.power.size
    first, second, share = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    assign(tiles, sites, near, start, first, second, share)
    return shares_of_tiles(tiles, sites, first, second, share)


@njit(cache=True)
def shares_of_tiles(tiles: Tiles, sites, first, second, share):
    """The same when it is known whose the tiles are."""
    n = sites.shape[0]
    flux, moment, pull, unease = np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty(n)
    gather(tiles, first, second, share, flux, moment, pull)
    unrest(tiles, first, second, share, moment, sites, unease)
    return flux, moment, pull, unease, first, second, share


@njit(cache=True)
def relaxed(of: Grid, tiles: Tiles, sites, pull, near, start, slack, steps):
    """The sites after so many of Lloyd's steps, and what their cells hold.

    pull: of the sites' cells. near, start: `candidates` of the sites with `slack`, searched anew only when a site has moved farther.
    """
    since = sites
    for _ in range(steps):
        sites = sites.copy()
        move(pull, sites)
        if ((sites - since) ** 2).sum(axis=1).max() > slack**2:
            near, start = candidates(of, tiles, sites, slack)
            since = sites
        flux, moment, pull, unease, first, second, share = shares_of_sites(tiles, sites, near, start)
    return sites, (flux, moment, pull, unease, first, second, share)


@njit(cache=True)
def gather(tiles: Tiles, first, second, share, flux, moment, pull):
    """Fills per cell the flux (n, 3), the moment of power (n, 4): power x direction, power; and of weight (n, 3)."""
    flux[:] = 0.0
    moment[:] = 0.0
    pull[:] = 0.0
    for t in range(tiles.power.size):
        _add(tiles, t, first[t], 1.0 - share[t], flux, moment)
        if share[t] > 0:
            _add(tiles, t, second[t], share[t], flux, moment)
        for c in range(3):
            pull[first[t], c] += tiles.weight[t] * tiles.direction[t, c]


@njit(cache=True)
def _add(tiles, t, s, part, flux, moment):
    power = part * tiles.power[t]
    for c in range(3):
        flux[s, c] += part * tiles.flux[t, c]
        moment[s, c] += power * tiles.direction[t, c]
    moment[s, 3] += power


@njit(cache=True)
def root(chord):
    """Square root of d^2 / (d + EDGE): the share of shadow edges that matter between two directions a chord d apart."""
    return chord / np.sqrt(chord + EDGE)


@njit(cache=True)
def unrest(tiles: Tiles, first, second, share, moment, sites, unease):
    """Fills unease (n,), the root of each cell's unrest: the sum of power x root(chord to the flux centroid)."""
    unease[:] = 0.0
    centre = centroids(moment, sites)
    for t in range(tiles.power.size):
        unease[first[t]] += (1.0 - share[t]) * tiles.power[t] * root(np.sqrt(_chord(tiles, t, centre[first[t]])))
        if share[t] > 0:
            unease[second[t]] += share[t] * tiles.power[t] * root(np.sqrt(_chord(tiles, t, centre[second[t]])))


@njit(cache=True)
def centroid(moment, site, direction):
    """Fills the unit vector of a cell's flux centroid; of its site where the light cancels out or there is none."""
    length = np.sqrt(moment[0] ** 2 + moment[1] ** 2 + moment[2] ** 2)
    for c in range(3):
        direction[c] = moment[c] / length if length > 1e-9 * moment[3] else site[c]


@njit(cache=True)
def centroids(moment, sites):
    """Flux centroids (n, 3) of all cells."""
    directions = np.empty((moment.shape[0], 3))
    for s in range(moment.shape[0]):
        centroid(moment[s], sites[s], directions[s])
    return directions


@njit(cache=True)
def move(pull, sites):
    """Lloyd's step: every site with light goes to the weighted centroid of its cell."""
    for s in range(sites.shape[0]):
        length = np.sqrt(pull[s, 0] ** 2 + pull[s, 1] ** 2 + pull[s, 2] ** 2)
        if length > 0:
            for c in range(3):
                sites[s, c] = pull[s, c] / length


@njit(cache=True)
def cheapest_pair(first, second, moment, sites, unease):
    """(cost, kept, lost): the two neighbours whose union adds the least unrest; the one with more power is kept. A dark cell costs nothing.

    Neighbours are the nearest and next site of some tile.
    """
    n = moment.shape[0]
    cost, kept, lost = np.inf, 0, 1
    centre = centroids(moment, sites)
    for s in range(n):
        if moment[s, 3] <= 0:
            return 0.0, 1 if s == 0 else 0, s
    for t in range(first.size):
        a, b = first[t], second[t]
        if b < 0:
            continue
        # Each part keeps its own spread and goes to the joint centroid.
        pa, pb = moment[a, 3], moment[b, 3]
        chord = np.sqrt((centre[a, 0] - centre[b, 0]) ** 2 + (centre[a, 1] - centre[b, 1]) ** 2 + (centre[a, 2] - centre[b, 2]) ** 2)
        ka, kb = root(chord * pb / (pa + pb)), root(chord * pa / (pa + pb))
        ua, ub = np.sqrt(unease[a] ** 2 + (pa * ka) ** 2), np.sqrt(unease[b] ** 2 + (pb * kb) ** 2)
        joint = (ua + ub) ** 2 - unease[a] ** 2 - unease[b] ** 2
        if joint < cost:
            cost = joint
            kept, lost = (a, b) if pa >= pb else (b, a)
    return cost, kept, lost


@njit(cache=True)
def split(tiles: Tiles, first, cell, centre, sudden, halves, parts):
    """The gain in unrest of cutting `cell` in two, or 0 when it is one tile.

    Fills the two sites halves (2, 3) and their moments of power parts (2, 4). The first is the one with more power; under `sudden`
    light the one nearer to the old `centre` (3,), since the power may be what is new.
    """
    power = x = y = z = 0.0
    count = 0
    for t in range(first.size):
        if first[t] == cell:
            p = tiles.power[t]
            x, y, z, power = x + p * tiles.direction[t, 0], y + p * tiles.direction[t, 1], z + p * tiles.direction[t, 2], power + p
            count += 1
    length = np.sqrt(x * x + y * y + z * z)
    if count < 2 or length <= 1e-9 * power:
        return 0.0
    # Two-means from the centroid and from the tile with the largest flux x chord.
    halves[0] = x / length, y / length, z / length
    far = -1.0
    members, k = np.empty(count, np.int64), 0
    for t in range(first.size):
        if first[t] == cell:
            members[k] = t
            k += 1
            d = root(np.sqrt(_chord(tiles, t, halves[0]))) * tiles.power[t]
            if d > far:
                far = d
                halves[1] = tiles.direction[t]
    pull = np.empty((2, 3))
    for _ in range(SPLIT_ROUNDS):
        parts[:] = 0.0
        pull[:] = 0.0
        for t in members:
            s = 0 if _chord(tiles, t, halves[0]) <= _chord(tiles, t, halves[1]) else 1
            for c in range(3):
                parts[s, c] += tiles.power[t] * tiles.direction[t, c]
                pull[s, c] += tiles.weight[t] * tiles.direction[t, c]
            parts[s, 3] += tiles.power[t]
        move(pull, halves)
    nearer = ((halves[0] - centre) ** 2).sum() <= ((halves[1] - centre) ** 2).sum()
    if not nearer if sudden else parts[0, 3] < parts[1, 3]:
        for c in range(4):
            parts[0, c], parts[1, c] = parts[1, c], parts[0, c]
        for c in range(3):
            halves[0, c], halves[1, c] = halves[1, c], halves[0, c]
    # Unrest before and after.
    whole = one = other = 0.0
    centres = np.empty((3, 3))
    centres[2] = x / length, y / length, z / length
    centroid(parts[0], halves[0], centres[0])
    centroid(parts[1], halves[1], centres[1])
    for t in members:
        whole += tiles.power[t] * root(np.sqrt(_chord(tiles, t, centres[2])))
        if _chord(tiles, t, halves[0]) <= _chord(tiles, t, halves[1]):
            one += tiles.power[t] * root(np.sqrt(_chord(tiles, t, centres[0])))
        else:
            other += tiles.power[t] * root(np.sqrt(_chord(tiles, t, centres[1])))
    return whole**2 - one**2 - other**2


@njit(cache=True, inline="always")
def _chord(tiles, t, site):
    """Squared chord."""
    return (tiles.direction[t, 0] - site[0]) ** 2 + (tiles.direction[t, 1] - site[1]) ** 2 + (tiles.direction[t, 2] - site[2]) ** 2
