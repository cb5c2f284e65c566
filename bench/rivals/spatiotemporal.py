"""Spatiotemporal sampling of environment sequences (Wan, Mak, Wong and Leung 2011): strata of a volume of sphere and time.

Built from the paper's published description: a sequence is a volume that is stratified adaptively, by an importance of each stratum and
so that sampling patterns do not change abruptly in space or time; the number of samples of a frame adapts. The whole sequence is known
before its first frame is lit, which no live method can have. Where the description is silent we chose: space is quartered as in the
authors' spherical Q2-tree (q2tree.py), time is halved where a stratum's flux changes most; importance is the greatest in the stratum's
time of flux x min(solid angle, 0.01 sr)^(1/4); a stratum whose least importance is below STEADY of its greatest is cut in time first,
another in space. A light has its stratum's flux in each frame, at that frame's flux centroid, and the id of the stratum.
"""

import heapq
from collections.abc import Sequence
from itertools import count as counter
from typing import NamedTuple

import numpy as np

from bench.rivals.cells import cells, lights_of_groups
from bench.rivals.q2tree import DEPTH, FACES, quadrilaterals
from bench.rivals.structured import SMALLEST_SR
from vemlight.light.light_set import LightSet
from vemlight.sampler.sampler_input import SamplerInput

STEADY = 0.5
SHORTEST = 2  # frames: a stratum of a single frame would be a light that is born and dies at once


class Stratum(NamedTuple):
    """A quadrilateral by depth and number, in frames begin to end."""

    depth: int
    index: int
    begin: int
    end: int


def spatiotemporal(count: int, frames: Sequence[SamplerInput]) -> list[LightSet]:
    """The lights of each frame of a sequence, `count` a frame in the mean at most."""
    seen = [cells(frame.radiance, frame.coverage) for frame in frames]
    rows, cols = seen[0].power.shape
    finest = quadrilaterals(rows, cols, frames[0].coverage)
    flux = [np.stack([np.bincount(finest, of.power.ravel(), FACES * 4**DEPTH) for of in seen])]
    while len(flux) <= DEPTH:
        flux.insert(0, flux[0].reshape(len(seen), -1, 4).sum(axis=2))
    strata = _strata(flux, count * len(seen))
    made = []
    for k, of in enumerate(seen):
        label = np.full(rows * cols, -1)
        for number, stratum in enumerate(strata):
            if stratum.begin <= k < stratum.end:
                label[finest >> (2 * (DEPTH - stratum.depth)) == stratum.index] = number
        made.append(lights_of_groups(of, label.reshape(rows, cols), len(strata)))
    return made


def _strata(flux: list[np.ndarray], budget: int) -> list[Stratum]:
    """Strata whose lengths, in frames, sum to `budget` at most: the one of most importance is cut until that is spent."""
    frames = len(flux[0])
    whole = [Stratum(0, face, 0, frames) for face in range(FACES) if flux[0][:, face].any()]
    order, spent, done = counter(), len(whole) * frames, []
    heap = [(-_importance(flux, stratum).max(), next(order), stratum) for stratum in whole]
    heapq.heapify(heap)
    while heap:
        _, _, stratum = heapq.heappop(heap)
        parts = _parts(flux, stratum)
        added = sum(part.end - part.begin for part in parts) - (stratum.end - stratum.begin)
        if not parts or spent + added > budget:
            done.append(stratum)
            continue
        spent += added
        for part in parts:
            heapq.heappush(heap, (-_importance(flux, part).max(), next(order), part))
    return done


def _importance(flux: list[np.ndarray], stratum: Stratum) -> np.ndarray:
    """Of each frame of the stratum."""
    sr = 4 * np.pi / (FACES * 4**stratum.depth)
    return flux[stratum.depth][stratum.begin : stratum.end, stratum.index] * min(sr, SMALLEST_SR) ** 0.25


def _parts(flux: list[np.ndarray], stratum: Stratum) -> list[Stratum]:
    """Two in time where the stratum's light changes, else four in space, those with light; none for what cannot be cut."""
    depth, index, begin, end = stratum
    importance = _importance(flux, stratum)
    if importance.min() < STEADY * importance.max() and end - begin >= 2 * SHORTEST:
        change = np.abs(np.diff(importance))[SHORTEST - 1 : len(importance) - SHORTEST]
        at = begin + SHORTEST + int(change.argmax())
        return [part for part in (Stratum(depth, index, begin, at), Stratum(depth, index, at, end)) if _importance(flux, part).any()]
    if depth == DEPTH:
        return []
    quarters = [Stratum(depth + 1, 4 * index + k, begin, end) for k in range(4)]
    return [part for part in quarters if _importance(flux, part).any()]
