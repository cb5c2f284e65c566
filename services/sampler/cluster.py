"""Merges neighbouring lights into one, in the order of the sequence (Havran et al. 2005, section 4.3), steadily and within a limit.

A light joins the first seed within the angle, or becomes a seed: the same clusters as a range search around each seed in turn over
the lights still free, and with at most a few hundred seeds a plain loop over them is faster than a k-d tree. The paper's angle
epsilon = c asin(sqrt(2 / Q)) with c = 1.8 to 1.9 neither bounds the number of clusters by Q (80 were found for Q = 72) nor uses it up
(half of Q is usual); here the angle is searched for, and changed only when the count leaves [FILL Q, Q].
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage

FIRST_ANGLE_FACTOR = 1.85  # the paper's c, where the search begins; elsewhere it takes more steps
STAY = 1.15  # a light stays with its seed, and a seed a seed, up to this factor on the angle: .04 % of lights change a frame, not .41 %
FILL = 0.85  # of the limit, below which the angle is changed
MIN_ANGLE_RAD = float(np.radians(1.0))  # lights closer than this are one to any shadow map, so no search goes below


class Clusters(NamedTuple):
    """labels: (n,) int64, index of each light's seed, in the order of the lights. angle_rad: within which lights join."""

    labels: np.ndarray
    angle_rad: float


NO_CLUSTERS = Clusters(np.zeros(0, np.int64), 0.0)


def clustered(lights: LightSet, max_count: int, coverage: Coverage, before: Clusters) -> tuple[Clusters, LightSet]:
    """At most `max_count` lights that stand for `lights`, and what to pass next time.

    Power is exact in each channel; a cluster lies at the mean of its lights weighted by power and has its seed's id and place in the order.
    """
    if len(lights.ids) <= max_count:
        return Clusters(np.arange(len(lights.ids)), before.angle_rad), lights
    directions = lights.directions.astype(np.float64)
    old = np.concatenate([before.labels[: len(directions)], np.full(max(len(directions) - len(before.labels), 0), -1)])
    now = _searched(directions, old, max_count, before.angle_rad or _first_guess(max_count, coverage))
    return now, _merged(lights, directions, now, int((now.labels == np.arange(len(directions))).sum()))


def _first_guess(max_count: int, coverage: Coverage) -> float:
    return float(FIRST_ANGLE_FACTOR * np.arcsin(np.sqrt(min(2 / max_count, 1.0))) * (1.0 if coverage == "hemisphere" else np.sqrt(2)))


def _searched(directions: np.ndarray, old: np.ndarray, max_count: int, angle: float) -> Clusters:
    labels, seeds = _labels(directions, old, angle, max_count)
    while seeds > max_count:
        angle = min(angle * max(1.02, math.sqrt(seeds / max_count)), 4.0)  # beyond pi / STAY everything joins the first light
        labels, seeds = _labels(directions, old, angle, max_count)
    if seeds >= FILL * max_count or angle <= MIN_ANGLE_RAD:
        return Clusters(labels, angle)
    low, high = MIN_ANGLE_RAD, angle
    for _ in range(8):  # to 1/256 of the interval, finer than the steps of the number of clusters; 6 or more do
        middle = (low + high) / 2
        trial, count = _labels(directions, old, middle, max_count)
        if count > max_count:
            low = middle
        else:
            labels, high = trial, middle
            if count >= FILL * max_count:
                break
    return Clusters(labels, high)


@kernel
def _labels(directions, old, angle, max_count):
    """(labels, number of seeds) for an angle; gives up, with max_count + 1 seeds, once there are too many."""
    count = directions.shape[0]
    labels, seeds, found = np.empty(count, np.int64), np.empty(max_count + 1, np.int64), 0
    join, stay, yields = np.cos(min(angle, np.pi)), np.cos(min(angle * STAY, np.pi)), np.cos(min(angle / STAY, np.pi))
    for i in range(count):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        s = old[i]
        if 0 <= s < i and labels[s] == s and x * directions[s, 0] + y * directions[s, 1] + z * directions[s, 2] >= stay:
            labels[i] = s
            continue
        near = yields if s == i else join
        labels[i] = i
        for k in range(found):
            s = seeds[k]
            if x * directions[s, 0] + y * directions[s, 1] + z * directions[s, 2] >= near:
                labels[i] = s
                break
        if labels[i] == i:
            seeds[found] = i
            found += 1
            if found > max_count:
                break
    return labels, found


def _merged(lights: LightSet, directions: np.ndarray, clusters: Clusters, seeds: int) -> LightSet:
    return LightSet.of(*_merge(lights, directions, clusters.labels, seeds))


@kernel
def _merge(lights, directions, labels, seeds):
    """(ids (seeds,), directions (seeds, 3), irradiance (seeds, 3)) of the clusters. directions: of the lights, float64."""
    ids, mean, irradiance = np.empty(seeds, np.int64), np.empty((seeds, 3)), np.empty((seeds, 3))
    place, found = np.empty(labels.size, np.int64), 0
    weights = np.zeros(ids.size)
    for i in range(labels.size):
        s = labels[i]
        if s == i:
            place[i] = found
            ids[found], mean[found], irradiance[found] = lights.ids[i], 0.0, 0.0
            found += 1
        k, weight = place[s], 0.0
        for c in range(3):
            irradiance[k, c] += lights.irradiance[i, c]
            weight += LUMINANCE_WEIGHTS[c] * lights.irradiance[i, c]
        for c in range(3):
            mean[k, c] += weight * directions[i, c]
        weights[k] += weight
    for i in range(labels.size):
        if labels[i] == i:
            k = place[i]
            length = np.sqrt(mean[k, 0] ** 2 + mean[k, 1] ** 2 + mean[k, 2] ** 2)
            # A cluster without power, or of opposite lights, lies at its seed.
            for c in range(3):
                mean[k, c] = mean[k, c] / length if length > 1e-6 * weights[k] else directions[i, c]
    return ids, mean, irradiance
