"""Splits and merges of cells, for what Lloyd updates are too slow for: the split that gains most, the cheapest merge, both at once."""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.sampler.tracking.tiles import Tiles
from vemlight.sampler.tracking.voronoi import Cells, assign, cells_from_assignment, centroid, centroids, lloyd_update, root

MAX_EXCHANGES = 6  # in a frame: each costs as much time as two Lloyd updates
URGENT = 0.02  # of the energy: five exchanges that save so much are 5 % of the error
TWO_MEANS_STEPS = 4  # inside a cell that is split: enough to part two lamps, and the Lloyd updates of later frames do the rest
GAIN_OVER_COST = 2.0  # a split must gain this many times what the merge costs that makes room for it,
GAIN_OVER_MEAN = 0.5  # and this many times the mean energy of a cell


class Sites(NamedTuple):
    """The tracked lights' sites, one a cell.

    ids: (n,) int64. directions: (n, 3) unit vectors. offsets: (n, 3), what is still added to a new light's direction, so that it begins
    at its parent's. next_id: of the next light.
    """

    ids: np.ndarray
    directions: np.ndarray
    offsets: np.ndarray
    next_id: int


def split_and_merge(tiles: Tiles, sites: Sites, cells: Cells, spare: int, urgent: float, scene_change: bool) -> tuple[int, Sites, Cells]:
    """(count, sites, cells) after at most MAX_EXCHANGES exchanges, each the split of one cell paid by the merge of two others.

    Of those that save less than the fraction `urgent` of the energy at most `spare`. The new light takes the merged one's place in the
    list. It begins at its parent's direction, except after a scene change. The assignment in `cells` is overwritten.
    """
    ids, directions, offsets, parent, count = sites.ids.copy(), sites.directions.copy(), sites.offsets.copy(), np.empty(3), 0
    for _ in range(MAX_EXCHANGES):
        gains, chosen, halves = best_splits(tiles, directions, cells, 1, scene_change)
        energy = (cells.root_energy**2).sum()
        if not gains.size or gains[0] <= GAIN_OVER_MEAN * energy / ids.size or (gains[0] < urgent * energy and count >= spare):
            break
        cell, (cost, larger, smaller) = chosen[0], cheapest_pair(directions, cells)
        saved = gains[0] - GAIN_OVER_MEAN * energy / ids.size - GAIN_OVER_COST * cost
        if cell in (larger, smaller) or saved < 0 or (saved < urgent * energy and count >= spare):
            break
        centroid(cells.moment[cell], directions[cell], parent)
        lloyd_update((cells.site_moment[larger] + cells.site_moment[smaller])[None], directions[larger : larger + 1])
        directions[cell], directions[smaller] = halves[0, 0], halves[0, 1]
        ids[smaller] = sites.next_id + count
        offsets[smaller] = 0.0 if scene_change else parent - halves[0, 1]
        assign(tiles, directions, np.array([cell, larger, smaller]), cells.assignment)
        cells, count = cells_from_assignment(tiles, directions, cells.assignment), count + 1
    return count, Sites(ids, directions, offsets, sites.next_id + count), cells


@kernel
def best_splits(tiles: Tiles, directions, cells, max_count, scene_change):
    """(gains (k,), chosen cells (k,), halves (k, 2, 3)) of the splits, at most `max_count`, that lower the energy most, best first.

    directions: (n, 3), of the sites. A cell of one tile cannot be split.
    """
    # Cells by falling energy, which bounds the gain of a split: done once no other cell can gain more.
    energy, count = np.empty(cells.root_energy.size), 0
    for cell in range(energy.size):
        energy[cell] = cells.root_energy[cell] ** 2
    gains, chosen, halves = np.empty(max_count), np.empty(max_count, np.int64), np.empty((max_count, 2, 3))
    two = np.empty((2, 3))
    for _ in range(energy.size):
        cell = np.int64(0)
        for other in range(1, energy.size):
            cell = other if energy[other] > energy[cell] else cell
        if count == max_count and energy[cell] <= gains[max_count - 1]:
            break
        gain, energy[cell] = split(tiles, cells.assignment.nearest, cell, directions[cell], scene_change, two), -1.0
        if gain == 0 or (count == max_count and gain <= gains[max_count - 1]):
            continue
        k = count if count < max_count else max_count - 1
        while k > 0 and gains[k - 1] < gain:
            gains[k], chosen[k] = gains[k - 1], chosen[k - 1]
            _copy_halves(halves[k - 1], halves[k])
            k -= 1
        gains[k], chosen[k] = gain, cell
        _copy_halves(two, halves[k])
        count = min(count + 1, max_count)
    return gains[:count], chosen[:count], halves[:count]


@subroutine
def _copy_halves(halves, goal):
    for s in range(2):
        for c in range(3):
            goal[s, c] = halves[s, c]


@kernel
def cheapest_pair(directions, cells):
    """(cost, larger, smaller): the two neighbours whose union adds the least energy; larger has more power. A dark cell costs nothing.

    Neighbours are the nearest and next site of some tile. directions: (n, 3), of the sites.
    """
    nearest, second, moment, root_energy = cells.assignment.nearest, cells.assignment.second, cells.moment, cells.root_energy
    n = moment.shape[0]
    cost, larger, smaller = np.inf, 0, 1
    centre = centroids(moment, directions)
    for s in range(n):
        if moment[s, 3] <= 0:
            return 0.0, 1 if s == 0 else 0, s
    for t in range(nearest.size):
        a, b = nearest[t], second[t]
        if b < 0 or 2 * root_energy[a] * root_energy[b] >= cost:  # a lower bound of the pair's cost
            continue
        # Each cell keeps its own spread and moves to the joint centroid.
        pa, pb = moment[a, 3], moment[b, 3]
        chord = np.sqrt((centre[a, 0] - centre[b, 0]) ** 2 + (centre[a, 1] - centre[b, 1]) ** 2 + (centre[a, 2] - centre[b, 2]) ** 2)
        ka, kb = root(chord * pb / (pa + pb)), root(chord * pa / (pa + pb))
        ea, eb = np.sqrt(root_energy[a] ** 2 + (pa * ka) ** 2), np.sqrt(root_energy[b] ** 2 + (pb * kb) ** 2)
        joint = (ea + eb) ** 2 - root_energy[a] ** 2 - root_energy[b] ** 2
        if joint < cost:
            cost = joint
            larger, smaller = (a, b) if pa >= pb else (b, a)
    return cost, larger, smaller


@kernel
def split(tiles: Tiles, nearest, cell, centre, scene_change, halves):
    """The energy saved by cutting `cell` in two, or 0 when it is one tile. nearest: (tiles,), the cell of each tile.

    Fills halves (2, 3) with the two sites. The first is the one with more power; after a scene change the one nearer to the old
    `centre` (3,), since the power may be what is new.
    """
    own, count = np.empty((5, nearest.size)), np.int64(0)  # direction, power and weight of the cell's tiles
    members = np.empty(nearest.size + 1, np.int64)
    for t in range(nearest.size):
        members[count] = t
        count += nearest[t] == cell
    for k in range(count):
        t = members[k]
        own[0, k], own[1, k], own[2, k] = tiles.direction[0, t], tiles.direction[1, t], tiles.direction[2, t]
        own[3, k], own[4, k] = tiles.power[t], tiles.weight[t]
    moment, whole = np.zeros((3, 4)), np.empty(3)
    for k in range(count):
        _add(own, k, moment[2])
    length = np.sqrt(moment[2, 0] ** 2 + moment[2, 1] ** 2 + moment[2, 2] ** 2)
    if count < 2 or length <= 1e-9 * moment[2, 3]:
        return 0.0
    centroid(moment[2], centre, whole)
    _two_means(own, count, whole, halves, moment)
    nearer = _squared(halves[0], centre) <= _squared(halves[1], centre)
    if not nearer if scene_change else moment[0, 3] < moment[1, 3]:
        for c in range(3):
            halves[0, c], halves[1, c] = halves[1, c], halves[0, c]
        for c in range(4):
            moment[0, c], moment[1, c] = moment[1, c], moment[0, c]
    # The root of the energy of each half and of the whole.
    root_energy, centres = np.zeros(3), np.empty((2, 3))
    centroid(moment[0], halves[0], centres[0])
    centroid(moment[1], halves[1], centres[1])
    for k in range(count):
        s = 0 if _chord(own, k, halves[0]) <= _chord(own, k, halves[1]) else 1
        root_energy[s] += own[3, k] * root(np.sqrt(_chord(own, k, centres[s])))
        root_energy[2] += own[3, k] * root(np.sqrt(_chord(own, k, whole)))
    return root_energy[2] ** 2 - root_energy[0] ** 2 - root_energy[1] ** 2


@subroutine
def _two_means(own, count, whole, halves, moment):
    """Two-means of a cell's `count` tiles: fills the sites halves (2, 3) and their power moments, moment[:2].

    It begins with the centroid and the tile with the largest power x root(chord) from it.
    """
    far, farthest, site_moment = -1.0, 0, np.empty((2, 3))
    for k in range(count):
        d = root(np.sqrt(_chord(own, k, whole))) * own[3, k]
        if d > far:
            far, farthest = d, k
    for c in range(3):
        halves[0, c], halves[1, c] = whole[c], own[c, farthest]
    for _ in range(TWO_MEANS_STEPS):
        for s in range(2):
            for c in range(4):
                moment[s, c] = 0.0
            for c in range(3):
                site_moment[s, c] = 0.0
        for k in range(count):
            s = 0 if _chord(own, k, halves[0]) <= _chord(own, k, halves[1]) else 1
            _add(own, k, moment[s])
            for c in range(3):
                site_moment[s, c] += own[4, k] * own[c, k]
        lloyd_update(site_moment, halves)


@subroutine
def _squared(a, b):
    """Squared distance."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@subroutine(inline="always")
def _add(own, k, moment):
    for c in range(3):
        moment[c] += own[3, k] * own[c, k]
    moment[3] += own[3, k]


@subroutine(inline="always")
def _chord(own, k, site):
    """Squared chord."""
    return (own[0, k] - site[0]) ** 2 + (own[1, k] - site[1]) ** 2 + (own[2, k] - site[2]) ** 2
