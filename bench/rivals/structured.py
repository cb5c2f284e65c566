"""Structured importance sampling (Agarwal, Ramamoorthi, Belongie and Jensen 2003).

The map is cut into layers at multiples of the standard deviation of its luminance, each layer into connected parts. A part gets lights
in proportion to its importance, radiance x min(solid angle of the part, 0.01 sr)^(1/4) over its cells, by largest remainders;
inside it they are placed farthest first (Hochbaum and Shmoys), from the brightest cell, and each carries the flux of the cells nearest
to it at their centroid. The flux of parts without a light goes to the nearest light (the paper is silent about it).
"""

from typing import cast

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from bench.rivals.cells import cells, lights_of_groups
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage

LAYERS = 6
SMALLEST_SR = 0.01


def structured(radiance: np.ndarray, coverage: Coverage, count: int) -> LightSet:
    """At most `count` lights of a polar map (rows, cols, 3)."""
    of = cells(radiance, coverage)
    light = of.power / of.solid_angles[:, None]
    if not light.any():
        return lights_of_groups(of, np.full(light.shape, -1), 1, np.zeros((1, 3)))
    part, parts = _parts(np.minimum((light / max(light.std(), 1e-300)).astype(np.int64), LAYERS - 1))
    area = np.bincount(part.ravel(), np.broadcast_to(of.solid_angles[:, None], light.shape).ravel(), parts)
    importance = np.bincount(part.ravel(), light.ravel(), parts) * np.minimum(area, SMALLEST_SR) ** 0.25
    # A part has no more lights than cells with light; what it cannot take goes to the others.
    most = np.bincount(part.ravel(), (light > 0).ravel(), parts).astype(np.int64)
    count, wanted = min(count, int(most.sum())), np.zeros(parts, np.int64)
    while (left := count - int(wanted.sum())) > 0:
        open_ = np.where(wanted < most, importance, 0.0)
        wanted = np.minimum(wanted + _rounded(left * open_ / open_.sum(), left), most)
    label, made = np.full(part.size, -1), 0
    places = of.directions.reshape(-1, 3)
    centres = []
    for k in np.flatnonzero(wanted):
        members = np.flatnonzero((part.ravel() == k) & (light.ravel() > 0))
        chosen, nearest = _farthest_first(places[members], int(light.ravel()[members].argmax()), int(wanted[k]))
        label[members] = made + nearest
        centres.append(places[members[chosen]])
        made += int(wanted[k])
    rest = (label < 0) & (light.ravel() > 0)
    label[rest] = KDTree(np.concatenate(centres)).query(places[rest])[1] if rest.any() else label[rest]
    return lights_of_groups(of, label.reshape(light.shape), made)


def _parts(layer: np.ndarray) -> tuple[np.ndarray, int]:
    """Connected parts (8 neighbours, round phi = 0 too) of each layer: labels (rows, cols) from 0, and their number."""
    part, parts = np.zeros(layer.shape, np.int64), 0
    for value in np.unique(layer):
        labels = np.empty(layer.shape, np.int32)
        found = cast(int, ndimage.label(layer == value, np.ones((3, 3)), labels))
        part += np.where(labels > 0, labels - 1 + parts, 0)
        parts += found
    root = np.arange(parts)
    for i in range(layer.shape[0]):
        for k in (i - 1, i, i + 1):
            if 0 <= k < layer.shape[0] and layer[i, 0] == layer[k, -1]:
                a, b = root[part[i, 0]], root[part[k, -1]]
                root[root == max(a, b)] = min(a, b)
    names, inverse = np.unique(root, return_inverse=True)
    return inverse[part], len(names)


def _rounded(shares: np.ndarray, count: int) -> np.ndarray:
    """Whole numbers that sum to `count`, by largest remainders."""
    whole = np.floor(shares).astype(np.int64)
    whole[np.argsort(whole - shares)[: count - whole.sum()]] += 1
    return whole


def _farthest_first(places: np.ndarray, start: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(indices of `count` of the places, nearest of them for each place)."""
    chosen, nearest = [start], np.zeros(len(places), np.int64)
    distance = 1 - places @ places[start]
    for k in range(1, count):
        chosen.append(int(distance.argmax()))
        new = 1 - places @ places[chosen[-1]]
        nearest[new < distance] = k
        distance = np.minimum(distance, new)
    return np.array(chosen), nearest
