"""Hierarchical importance sampling with Penrose tiling (Ostromoukhov, Donohue and Jodoin 2004).

The plane is tiled by six types of triangles and sample points whose subdivision numbers them in the Fibonacci system; a tile's sample is
taken where the importance reaches its number. The plane is laid on the sky by an area-preserving map (Shirley and Chiu 1997), so
importance is radiance. The paper's table of corrections, made by Lloyd's relaxation, is left out: distances between samples are then .53 to
.81 of the best possible. Equal-power lights; the scale of the importance is the one at which there are N of them.
"""

from functools import lru_cache

import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, cell_from_direction, cell_solid_angles, ring_edges
from vemlight.sampler.light_map import light_map
from vemlight.sampler.warp_method import irradiance_from_tint
from vemlight.sampler.warps.square import direction_from_area, disc_from_square

GOLDEN = (1 + np.sqrt(5)) / 2
# type -> children: (type, vertex, turn in units of 18 degrees, bits). Vertices: "1", "2", "3" of the parent, "k.v": vertex v of child k.
RULES: dict[str, tuple[tuple[str, str, int, str], ...]] = {
    "A": (("B", "1", 0, "00"),),
    "B": (("A", "1", 10, "00"),),
    "C": (("F", "3", 14, "00"), ("C", "2", 6, "01"), ("A", "0.3", 1, "01")),
    "D": (("E", "2", 6, "00"), ("D", "0.3", 14, "01")),
    "E": (("C", "3", 12, "01"), ("E", "2", 8, "10"), ("F", "1", 0, "00"), ("A", "0.2", 7, "01")),
    "F": (("F", "3", 12, "10"), ("E", "0.3", 0, "00"), ("D", "1.3", 8, "01"), ("A", "0.3", 15, "10")),
}
LEVELS = 15  # of subdivision: 75,000 samples in the square
ROOT = 3.4  # scale of the root triangle, which then covers the unit square


def _vertices(kind: str, place: complex, k: int, scale: float) -> tuple[complex, complex, complex]:
    def along(turn: int) -> complex:
        return 1j * np.exp(1j * np.pi / 10 * turn)

    if kind in "AB":
        return place, place, place
    if kind in "CD":
        return place, place + scale * along(k), place + GOLDEN * scale * along(k + 4)
    return place, place + GOLDEN**2 * scale * along(k), place + GOLDEN * scale * along(k + 2)


@lru_cache(maxsize=1)
def _samples() -> tuple[np.ndarray, np.ndarray]:
    """All sample points of the unit square (n, 2), and their numbers (n,), of which all tones have the same density."""
    tiles: list[tuple[str, complex, int, float, str]] = [("E", complex(1.25, -1.9), 0, ROOT, "")]
    for _ in range(LEVELS):
        after = []
        for kind, place, k, scale, bits in tiles:
            corners = _vertices(kind, place, k, scale)
            box = np.array([[c.real, c.imag] for c in corners])
            if (box.max(axis=0) < 0).any() or (box.min(axis=0) > 1).any():
                continue
            made: list[tuple[complex, complex, complex]] = []
            for child, vertex, turn, digits in RULES[kind]:
                at = corners[int(vertex) - 1] if "." not in vertex else made[int(vertex[0])][int(vertex[2]) - 1]
                after.append((child, at, (k + turn) % 20, scale / GOLDEN, bits + digits))
                made.append(_vertices(child, at, (k + turn) % 20, scale / GOLDEN))
        tiles = after
    fibonacci = [1.0, 2.0]
    while len(fibonacci) < 2 * LEVELS:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    points, numbers = [], []
    for kind, place, _, _, bits in tiles:
        if kind in "AB" and 0 <= place.real < 1 and 0 <= place.imag < 1:
            points.append((place.real, place.imag))
            numbers.append(sum(f for bit, f in zip(bits, fibonacci, strict=False) if bit == "1"))
    return np.array(points), np.array(numbers)


@lru_cache(maxsize=2)
def _on_sky(area: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) of the samples on the part of the sphere whose area coordinate ends at `area`, and their numbers."""
    points, numbers = _samples()
    disc = [disc_from_square(u, v) for u, v in points]
    return np.array([direction_from_area(a * area, w) for a, w in disc]), numbers


def penrose(radiance: np.ndarray, coverage: Coverage, count: int) -> LightSet:
    """`count` lights of a polar map (rows, cols, 3): the samples whose numbers the importance reaches first."""
    light = light_map(radiance, coverage)
    rows, cols = light.importance.shape
    directions, numbers = _on_sky(float(ring_edges(rows, coverage)[-1]))
    i, j = cell_from_direction(directions, rows, cols, coverage)
    cell = np.minimum(i.astype(int), rows - 1), np.minimum(j.astype(int), cols - 1)
    importance = light.importance[cell] / light.importance.mean()
    taken = np.argsort(numbers / importance)[:count]
    if light.power <= 0:
        return LightSet.of(taken, directions[taken], np.zeros((count, 3)))
    # The prepared tiling ends at its last level: where importance goes beyond its largest number, a cell's samples share the cell's light.
    place = (cell[0] * cols + cell[1])[taken]
    found = np.bincount(place, minlength=rows * cols)
    full = importance[taken] * (numbers / importance)[taken[-1]] >= numbers.max()
    flux = light.importance * cell_solid_angles(rows, cols, coverage)[:, None] / light.power
    weights = np.where(full, flux.ravel()[place] / found[place], 0.0)
    rest = np.where(full, 0.0, 1.0)
    weights += rest / max(rest.sum(), 1.0) * max(1 - weights.sum(), 0.0)
    tint = light.radiance[cell][taken] / importance[taken, None]
    return LightSet.of(taken, directions[taken], irradiance_from_tint(weights, tint.astype(float), light.irradiance))
