"""What Lloyd's steps are too slow for: the split of the worst cell, the merge of the cheapest pair, and both at once."""

import numpy as np
from numba import njit

from vemlight.sampler.tracking.cells import assign, centroid, centroids, move, root, shares_of_tiles
from vemlight.sampler.tracking.tiles import Tiles

SPLIT_ROUNDS = 4  # of two-means inside a cell that is split: enough for two lamps, and Lloyd's later steps do the rest
CHURN = 2.0  # a split must gain this many times what the merge costs that makes room for it,
WORTH = 0.5  # and this many times the mean unrest of a cell


@njit(cache=True, error_model="numpy")
def exchanged(tiles: Tiles, ids, sites, offset, next_id, moment, pull, unease, first, second, share, most, sudden):
    """(made, ids, sites, offset, shares) after at most so many exchanges: one cell cut in two and two others made one.

    The new light takes the place of the lost one in the list; it begins at its parent's place unless light is `sudden`. The rest of the
    arguments, and shares: what `shares_of_tiles` returns; first, second and share change in place.
    """
    ids, sites, offset, parent = ids.copy(), sites.copy(), offset.copy(), np.empty(3)
    for made in range(most):
        gains, cells, halves = best_splits(tiles, first, sites, unease, 1, sudden)
        spare = gains[0] - WORTH * (unease**2).mean() if gains.size else 0.0
        if spare <= 0:
            break
        cell, (cost, kept, lost) = cells[0], cheapest_pair(first, second, moment, sites, unease)
        if cell in (kept, lost) or spare < CHURN * cost:
            break
        centroid(moment[cell], sites[cell], parent)
        move((pull[kept] + pull[lost]).reshape(1, 3), sites[kept : kept + 1])
        sites[cell], sites[lost] = halves[0, 0], halves[0, 1]
        ids[lost] = next_id + made
        offset[lost] = np.zeros(3) if sudden else parent - halves[0, 1]
        assign(tiles, sites, np.array([cell, kept, lost]), first, second, share)
        moment, pull, unease, first, second, share = shares_of_tiles(tiles, sites, first, second, share)
    else:
        made = most
    return made, ids, sites, offset, (moment, pull, unease, first, second, share)


@njit(cache=True, error_model="numpy")
def best_splits(tiles: Tiles, first, sites, unease, most, sudden):
    """(gains (k,), cells (k,), halves (k, 2, 3)) of the splits, at most `most`, that lower the unrest most, best first.

    A cell of one tile has none.
    """
    own, count = unease**2, 0
    gains, cells, halves, two = np.empty(most), np.empty(most, np.int64), np.empty((most, 2, 3)), np.empty((2, 3))
    for _ in range(own.size):
        cell = own.argmax()
        if count == most and own[cell] <= gains[most - 1]:
            break
        gain, own[cell] = split(tiles, first, cell, sites[cell], sudden, two), -1.0
        if gain == 0 or (count == most and gain <= gains[most - 1]):
            continue
        k = count if count < most else most - 1
        while k > 0 and gains[k - 1] < gain:
            gains[k], cells[k], halves[k] = gains[k - 1], cells[k - 1], halves[k - 1]
            k -= 1
        gains[k], cells[k], halves[k] = gain, cell, two
        count = min(count + 1, most)
    return gains[:count], cells[:count], halves[:count]


@njit(cache=True, error_model="numpy")
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
        if b < 0 or 2 * unease[a] * unease[b] >= cost:  # less than the cost of the pair
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


@njit(cache=True, error_model="numpy")
def split(tiles: Tiles, first, cell, centre, sudden, halves):
    """The gain in unrest of cutting `cell` in two, or 0 when it is one tile.

    Fills the two sites halves (2, 3). The first is the one with more power; under `sudden` light the one nearer to the old
    `centre` (3,), since the power may be what is new.
    """
    own, count = np.empty((5, first.size)), 0  # direction, power and weight of the cell's tiles
    members = np.empty(first.size + 1, np.int64)
    for t in range(first.size):
        members[count] = t
        count += first[t] == cell
    for k in range(count):
        t = members[k]
        own[0, k], own[1, k], own[2, k] = tiles.direction[0, t], tiles.direction[1, t], tiles.direction[2, t]
        own[3, k], own[4, k] = tiles.power[t], tiles.weight[t]
    own, moment, whole = own[:, :count], np.zeros((3, 4)), np.empty(3)
    for k in range(count):
        _add(own, k, moment[2])
    length = np.sqrt(moment[2, 0] ** 2 + moment[2, 1] ** 2 + moment[2, 2] ** 2)
    if count < 2 or length <= 1e-9 * moment[2, 3]:
        return 0.0
    centroid(moment[2], centre, whole)
    _two_means(own, whole, halves, moment)
    nearer = ((halves[0] - centre) ** 2).sum() <= ((halves[1] - centre) ** 2).sum()
    if not nearer if sudden else moment[0, 3] < moment[1, 3]:
        for c in range(3):
            halves[0, c], halves[1, c] = halves[1, c], halves[0, c]
        for c in range(4):
            moment[0, c], moment[1, c] = moment[1, c], moment[0, c]
    # Unrest before and after.
    unease, centres = np.zeros(3), np.empty((2, 3))
    centroid(moment[0], halves[0], centres[0])
    centroid(moment[1], halves[1], centres[1])
    for k in range(count):
        s = 0 if _chord(own, k, halves[0]) <= _chord(own, k, halves[1]) else 1
        unease[s] += own[3, k] * root(np.sqrt(_chord(own, k, centres[s])))
        unease[2] += own[3, k] * root(np.sqrt(_chord(own, k, whole)))
    return unease[2] ** 2 - unease[0] ** 2 - unease[1] ** 2


@njit(cache=True, error_model="numpy")
def _two_means(own, whole, halves, moment):
    """Fills halves (2, 3) and their moments of power, moment[:2], from the centroid and the tile with the largest flux x chord."""
    far, pull = -1.0, np.empty((2, 3))
    for k in range(own.shape[1]):
        d = root(np.sqrt(_chord(own, k, whole))) * own[3, k]
        if d > far:
            far = d
            halves[1] = own[:3, k]
    halves[0] = whole
    for _ in range(SPLIT_ROUNDS):
        moment[:2], pull[:] = 0.0, 0.0
        for k in range(own.shape[1]):
            s = 0 if _chord(own, k, halves[0]) <= _chord(own, k, halves[1]) else 1
            _add(own, k, moment[s])
            for c in range(3):
                pull[s, c] += own[4, k] * own[c, k]
        move(pull, halves)


@njit(cache=True, error_model="numpy", inline="always")
def _add(own, k, moment):
    for c in range(3):
        moment[c] += own[3, k] * own[c, k]
    moment[3] += own[3, k]


@njit(cache=True, error_model="numpy", inline="always")
def _chord(own, k, site):
    """Squared chord."""
    return (own[0, k] - site[0]) ** 2 + (own[1, k] - site[1]) ** 2 + (own[2, k] - site[2]) ** 2
