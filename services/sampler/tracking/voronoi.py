"""Voronoi cells of a few sites over many tiles: the assignment of tiles, what each cell holds, and the Lloyd update.

A cell's energy (its distortion) is the square of the sum, over its tiles, of power x root(chord to the cell's flux centroid); `root` says
why. Sites and centroids are unit vectors, distances are chords, mostly squared.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.sampler.tracking.tiles import Tiles

EDGE = 0.0175  # rad, 1 degree, a cell of the map: directions closer than that share nearly all of their shadow edges
RUN = 64  # tiles searched together; changes the time alone
LANES = 16  # independent minima, merged at the end, so that no comparison waits for the one before; changes the time alone
FAR = np.float32(9.0)  # coordinate of the sites that pad the last lanes, and a squared chord above all; any value in 5..17 does
UNREACHED = np.float32(1000)  # above the squared chord to a padding site, (9 sqrt(3) + 1)^2 = 275; any larger value does
MIN_LENGTH = 0.1  # of direction + offset: below it the two nearly cancel, and their sum has no direction worth showing
ROUNDING = np.float32(1.00001)  # a hundred roundings of float32, 1 + 84 x 1.2e-7; up to 1.01 only costs time


class Assignment(NamedTuple):
    """Which cells each tile belongs to.

    nearest, second: (tiles,) int64, the nearest site and the next one (-1: none). overlap: (tiles,), the fraction in [0, 1/2] of the tile
    that lies in the second's cell.
    """

    nearest: np.ndarray
    second: np.ndarray
    overlap: np.ndarray


class Cells(NamedTuple):
    """What each of n cells holds.

    moment: (n, 4), sum of power x direction, and of power. site_moment: (n, 3), sum of Lloyd weight x direction. root_energy: (n,), square
    root of the cell's energy. assignment: of the tiles.
    """

    moment: np.ndarray
    site_moment: np.ndarray
    root_energy: np.ndarray
    assignment: Assignment


@kernel
def assign(tiles: Tiles, sites, moved, assignment: Assignment):
    """Fills the assignment of the tiles to the sites (n, 3).

    moved: (k,) int64, the sites that have moved since the assignment was last filled; tiles near none of them keep theirs. The search is
    in float32: of two sites equally near up to its last digit either can be the nearest.
    """
    nearest, second, overlap = assignment.nearest, assignment.second, assignment.overlap
    n, count = sites.shape[0], nearest.size
    places = np.empty((3, -(-n // LANES) * LANES), np.float32)
    for s in range(places.shape[1]):
        for c in range(3):
            places[c, s] = sites[s, c] if s < n else FAR
    near, names, chords = np.empty((3, n + 1), np.float32), np.empty(n + 1, np.int64), np.empty(places.shape[1], np.float32)
    of, best = np.empty((3, RUN), np.float32), np.empty((4, RUN), np.float32)
    for begin in range(0, count, RUN):
        end = min(begin + RUN, count)
        if moved.size < n and not _touched(tiles, begin, end, sites, moved, assignment):
            continue
        for t in range(RUN):  # the last run is padded with its last tile
            for c in range(3):
                of[c, t] = tiles.direction[c, min(begin + t, end - 1)]
        found = _near(of, places, n, chords, near, names)
        _nearest_two(of, near, found, best)
        for t in range(begin, end):
            nearest[t] = names[int(best[2, t - begin])]
            second[t] = names[int(best[3, t - begin])] if n > 1 else -1
            overlap[t] = _overlap(tiles.radius[t], sites, nearest[t], second[t], best[0, t - begin], best[1, t - begin])


@subroutine
def _touched(tiles: Tiles, begin, end, sites, moved, assignment):
    """Whether one of the sites `moved` was or comes among the nearest two of one of these tiles."""
    for t in range(begin, end):
        reach = _chord(tiles, t, sites[assignment.second[t]])
        for s in moved:
            if s == assignment.nearest[t] or s == assignment.second[t] or _chord(tiles, t, sites[s]) <= ROUNDING * reach:
                return True
    return False


@subroutine
def _near(of, places, n, chords, near, names):
    """Fills near (3, found) and names with the sites that can be the nearest or the next of a run of tiles; returns how many.

    With r the reach of the run round its middle, a tile's next site is at most r farther from it than from the middle, and any site at
    most r nearer.
    """
    xs, ys, zs = of
    x = y = z = reach = np.float32(0)
    for t in range(RUN):
        x, y, z = x + xs[t] / np.float32(RUN), y + ys[t] / np.float32(RUN), z + zs[t] / np.float32(RUN)
    for t in range(RUN):
        reach = max(reach, (xs[t] - x) ** 2 + (ys[t] - y) ** 2 + (zs[t] - z) ** 2)
    xs, ys, zs = places
    for s in range(chords.size):
        chords[s] = (xs[s] - x) ** 2 + (ys[s] - y) ** 2 + (zs[s] - z) ** 2
    lanes = np.empty((2, LANES), np.float32)
    for k in range(LANES):
        lanes[0, k] = lanes[1, k] = UNREACHED
    for start in range(0, chords.size, LANES):
        for k in range(LANES):
            chord, one, two = chords[start + k], lanes[0, k], lanes[1, k]
            worse = one if one > chord else chord
            lanes[1, k] = worse if worse < two else two
            lanes[0, k] = chord if chord < one else one
    best = after = UNREACHED
    for k in range(LANES):
        after = min(after, max(best, lanes[0, k]), lanes[1, k])
        best = min(best, lanes[0, k])
    limit = (np.sqrt(after) + np.float32(2) * np.sqrt(reach)) ** 2 * ROUNDING
    found = 0
    for s in range(n):
        names[found] = s
        found += chords[s] <= limit  # overwritten unless this advances; no branch to mispredict
    for k in range(found):
        near[0, k], near[1, k], near[2, k] = xs[names[k]], ys[names[k]], zs[names[k]]
    return found


@subroutine
def _nearest_two(of, near, found, best):
    """Fills best (4, RUN) for a run of tiles: squared chords to the nearest and the next of `found` sites, and which these are.

    All in float32, which holds whole numbers up to 2^24, so that the loop over the tiles needs no branch and one register each.
    """
    for t in range(RUN):
        best[0, t] = best[1, t] = FAR
        best[2, t] = best[3, t] = 0
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


@subroutine(inline="always")
def _overlap(radius, sites, a, b, da, db):
    """The fraction of a tile, a disc of that radius, on the far side of the border between its nearest site `a` and its next one `b`.

    It is linear in the distance to the border, so that light passes from one cell to the other without a jump. da, db: squared chords.
    """
    if b < 0:
        return 0.0
    square = (sites[a, 0] - sites[b, 0]) ** 2 + (sites[a, 1] - sites[b, 1]) ** 2 + (sites[a, 2] - sites[b, 2]) ** 2
    if (db - da) ** 2 >= 4 * square * radius * radius:
        return 0.0
    # Distance to the bisector of both sites: (db - da) / (2 |a - b|).
    apart = np.sqrt(square)
    return max(0.5 - (db - da) / (4 * apart * min(radius, 0.25 * apart)), 0.0)


@kernel
def cells_from_sites(tiles: Tiles, sites):
    """The cells of sites (n, 3)."""
    assignment = _unassigned(tiles.power.size)
    assign(tiles, sites, _numbers(sites.shape[0]), assignment)
    return cells_from_assignment(tiles, sites, assignment)


@subroutine
def _numbers(count):
    numbers = np.empty(count, np.int64)
    for k in range(count):
        numbers[k] = k
    return numbers


@subroutine
def _unassigned(count):
    return Assignment(np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count))


@kernel
def cells_from_assignment(tiles: Tiles, sites, assignment):
    """The cells of sites (n, 3) whose tiles are known."""
    nearest, second, overlap = assignment.nearest, assignment.second, assignment.overlap
    n = sites.shape[0]
    moment, site_moment, root_energy = np.zeros((n, 4)), np.zeros((n, 3)), np.zeros(n)
    _add_site_moments(tiles, nearest, site_moment)
    for t in range(tiles.power.size):
        _add(tiles, t, (1.0 - overlap[t]) * tiles.power[t], moment[nearest[t]])
        if overlap[t] > 0:
            _add(tiles, t, overlap[t] * tiles.power[t], moment[second[t]])
    _add_root_energies(tiles, assignment, moment, sites, root_energy)
    return Cells(moment, site_moment, root_energy, assignment)


@subroutine(inline="always")
def _add(tiles, t, power, moment):
    for c in range(3):
        moment[c] += power * tiles.direction[c, t]
    moment[3] += power


@subroutine
def _add_site_moments(tiles: Tiles, nearest, site_moment):
    """Adds to site_moment (n, 3) the Lloyd weight x direction of each cell's tiles."""
    for t in range(nearest.size):
        for c in range(3):
            site_moment[nearest[t], c] += tiles.weight[t] * tiles.direction[c, t]


@kernel
def relax(tiles: Tiles, sites, site_moment, steps):
    """(sites, cells) after so many Lloyd updates. site_moment: of the cells before the first one."""
    sites, assignment = sites.copy(), _unassigned(tiles.power.size)
    every = _numbers(sites.shape[0])
    lloyd_update(site_moment, sites)
    for _ in range(steps - 1):
        assign(tiles, sites, every, assignment)
        site_moment = np.zeros((sites.shape[0], 3))
        _add_site_moments(tiles, assignment.nearest, site_moment)
        lloyd_update(site_moment, sites)
    return sites, cells_from_sites(tiles, sites)


@kernel
def root(chord):
    """Square root of d^2 / (d + EDGE), the fraction of all shadow edges that lie between two directions a chord d apart and matter."""
    return chord / np.sqrt(chord + EDGE)


@subroutine
def _add_root_energies(tiles: Tiles, assignment, moment, sites, root_energy):
    """Adds to root_energy (n,) the sum of power x root(chord to the flux centroid) of each cell."""
    nearest, second, overlap = assignment.nearest, assignment.second, assignment.overlap
    centre = centroids(moment, sites)
    for t in range(tiles.power.size):
        root_energy[nearest[t]] += (1.0 - overlap[t]) * tiles.power[t] * root(np.sqrt(_chord(tiles, t, centre[nearest[t]])))
        if overlap[t] > 0:
            root_energy[second[t]] += overlap[t] * tiles.power[t] * root(np.sqrt(_chord(tiles, t, centre[second[t]])))


@kernel
def centroid(moment, site, direction):
    """Fills the unit vector to a cell's flux centroid, or to its site where the light cancels out or there is none."""
    length = np.sqrt(moment[0] ** 2 + moment[1] ** 2 + moment[2] ** 2)
    for c in range(3):
        direction[c] = moment[c] / length if length > 1e-9 * moment[3] else site[c]


@kernel
def centroids(moment, sites):
    """Flux centroids (n, 3) of all cells."""
    directions = np.empty((moment.shape[0], 3))
    for s in range(moment.shape[0]):
        centroid(moment[s], sites[s], directions[s])
    return directions


@kernel
def lights_from_cells(tiles: Tiles, moment, assignment: Assignment, sites, offset):
    """(directions, irradiance), (n, 3) float32, of the cells' lights: at their flux centroids plus `offset` (n, 3)."""
    nearest, second, overlap = assignment.nearest, assignment.second, assignment.overlap
    n = sites.shape[0]
    flux, directions, shown = np.zeros((n, 3)), centroids(moment, sites), np.empty((n, 3), np.float32)
    for t in range(nearest.size):
        for c in range(3):
            flux[nearest[t], c] += (1.0 - overlap[t]) * tiles.flux[c, t]
        if overlap[t] > 0:
            for c in range(3):
                flux[second[t], c] += overlap[t] * tiles.flux[c, t]
    for s in range(n):
        length = np.sqrt(((directions[s] + offset[s]) ** 2).sum())
        for c in range(3):
            shown[s, c] = (directions[s, c] + offset[s, c]) / length if length > MIN_LENGTH else directions[s, c]
    return shown, flux.astype(np.float32)


@kernel
def lloyd_update(site_moment, sites):
    """Moves every site with light to the weighted centroid of its cell."""
    for s in range(sites.shape[0]):
        length = np.sqrt(site_moment[s, 0] ** 2 + site_moment[s, 1] ** 2 + site_moment[s, 2] ** 2)
        if length > 0:
            for c in range(3):
                sites[s, c] = site_moment[s, c] / length


@subroutine(inline="always")
def _chord(tiles, t, site):
    """Squared chord."""
    return (tiles.direction[0, t] - site[0]) ** 2 + (tiles.direction[1, t] - site[1]) ** 2 + (tiles.direction[2, t] - site[2]) ** 2
