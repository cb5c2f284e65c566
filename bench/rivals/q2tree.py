"""Spherical Q2-tree (Wan, Wong and Leung 2005): quadrilaterals of the sphere quartered where they matter most.

Built from the paper's abstract, which names the parts: curvilinear quadrilaterals over the sphere, a quadtree on them, an importance that
decides what is quartered. Where it is silent we chose: the twelve quadrilaterals of equal area are those of HEALPix (Górski et al. 2005),
importance is Agarwal's, flux x min(solid angle, 0.01 sr)^(1/4), and a light carries the flux of its leaf at the leaf's flux centroid.
A quadrilateral that is quartered makes three lights more, so there may be two fewer than asked for.
"""

import heapq
from functools import lru_cache

import numpy as np

from bench.rivals.cells import cells, lights_of_groups
from bench.rivals.structured import SMALLEST_SR
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, angle_between, cell_directions

DEPTH = 6  # of the tree: quadrilaterals of 0.9 degrees, about a cell of the map
FACES = 12


def q2tree(radiance: np.ndarray, coverage: Coverage, count: int) -> LightSet:
    """At most `count` lights of a polar map (rows, cols, 3); a quadrilateral's light has the same id in every frame."""
    of = cells(radiance, coverage)
    rows, cols = of.power.shape
    finest = quadrilaterals(rows, cols, coverage)
    label = np.full(rows * cols, -1)
    if not of.power.any():
        return lights_of_groups(of, label.reshape(rows, cols), 1, np.zeros((1, 3)))
    flux = [np.bincount(finest, of.power.ravel(), FACES * 4**DEPTH)]
    while len(flux) <= DEPTH:
        flux.insert(0, flux[0].reshape(-1, 4).sum(axis=1))
    leaves = _leaves(flux, count)
    for depth, index in leaves:
        begin = (FACES * (4**depth - 1)) // 3  # quadrilaterals of all depths above
        label[finest >> (2 * (DEPTH - depth)) == index] = begin + index
    names, group = np.unique(label[of.power.ravel() > 0], return_inverse=True)
    of_lit = np.full(rows * cols, -1)
    of_lit[of.power.ravel() > 0] = group
    lights = _few(lights_of_groups(of, of_lit.reshape(rows, cols), len(names)), count)
    return lights._replace(ids=names[lights.ids])


def _leaves(flux: list[np.ndarray], count: int) -> list[tuple[int, int]]:
    """(depth, index) of the lit leaves: the one of most importance is quartered until there are `count`."""
    importance = [f * min(4 * np.pi / len(f), SMALLEST_SR) ** 0.25 for f in flux]
    heap = [(-importance[0][face], 0, face) for face in np.flatnonzero(flux[0]).tolist()]
    heapq.heapify(heap)
    done: list[tuple[int, int]] = []
    while heap:
        _, depth, index = heap[0]
        parts = [] if depth == DEPTH else [4 * index + k for k in range(4) if flux[depth + 1][4 * index + k] > 0]
        if len(heap) + len(done) + max(len(parts), 1) - 1 > count:
            break
        heapq.heappop(heap)
        if parts:
            for part in parts:
                heapq.heappush(heap, (-importance[depth + 1][part], depth + 1, part))
        else:
            done.append((depth, index))
    return done + [(depth, index) for _, depth, index in heap]


def _few(lights: LightSet, count: int) -> LightSet:
    """At most `count` of the lights: with fewer than there are quadrilaterals to begin with, the weakest go to the nearest other."""
    order = np.argsort(-lights.irradiance.sum(axis=1), kind="stable")
    kept, lost = np.sort(order[:count]), order[count:]
    directions, irradiance = lights.directions.astype(np.float64), lights.irradiance.astype(np.float64)
    for k in lost:
        irradiance[kept[angle_between(directions[kept], directions[k]).argmin()]] += irradiance[k]
    return LightSet.of(lights.ids[kept], directions[kept], irradiance[kept])


@lru_cache(maxsize=2)
def quadrilaterals(rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    """The finest quadrilateral (rows * cols,) round each cell's middle, by number; the four parts of quadrilateral k are 4 k ... 4 k + 3.

    Górski et al. 2005, section 4: in the belt |z| <= 2/3 they are squares in (phi, z), in the caps in (phi, sqrt(1 - |z|)).
    """
    x, y, z = cell_directions(rows, cols, coverage).reshape(-1, 3).T
    side = 2**DEPTH
    quarter = (np.arctan2(y, x) % (2 * np.pi)) / (np.pi / 2)
    # Belt: lines that rise and fall towards +phi.
    rising, falling = side * (0.5 + quarter - 0.75 * z), side * (0.5 + quarter + 0.75 * z)
    rising, falling = rising.astype(np.int64), falling.astype(np.int64)
    up, down = rising // side, falling // side
    belt = np.where(up == down, up % 4 + 4, np.where(up < down, up % 4, down % 4 + 8))
    belt_column, belt_row = falling % side, side - rising % side - 1
    # Caps: lines from the pole's two meridians.
    sector = np.minimum(quarter.astype(np.int64), 3)
    reach = side * np.sqrt(3 * (1 - np.abs(z)))
    one = np.minimum(((quarter - sector) * reach).astype(np.int64), side - 1)
    other = np.minimum(((1 - quarter + sector) * reach).astype(np.int64), side - 1)
    cap = np.where(z >= 0, sector, sector + 8)
    cap_column, cap_row = np.where(z >= 0, side - other - 1, one), np.where(z >= 0, side - one - 1, other)
    in_belt = np.abs(z) <= 2 / 3
    face, column, row = (np.where(in_belt, a, b) for a, b in ((belt, cap), (belt_column, cap_column), (belt_row, cap_row)))
    number = face
    for bit in reversed(range(DEPTH)):
        number = 4 * number + 2 * (row >> bit & 1) + (column >> bit & 1)
    return number
