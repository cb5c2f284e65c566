"""Whether a rig's cameras stand where its file says, by how lights' directions fit one place each.

Two explanations of a moment are weighed (a Bayes factor, Jeffreys 1961): all bearings are as wrong as declared, or WRONG times as much.
Flux has no say: a panel sends each camera another one, and no pose is wrong for that. A lamp that only some cameras see says nothing, for
it may be hidden from the others; but two sources that nothing explains, and that would be one lamp if poses were wrong, do.
"""

from typing import NamedTuple

import numpy as np

from vemlight.fuse.matching import CHI2_A_CAMERA, PAIR_CHI2, Matches, SeenSources, is_seen_at, matches
from vemlight.fuse.triangulation import UNKNOWN_FLUX, fits

WRONG = 3.0  # times the declared errors, of the other explanation: what is more wrong is told more easily
REACH = 8.0  # times the declared errors, up to which two free sources are looked at
PRIOR = 1.0  # ln of odds: a rig file is right as a rule, though a single lamp may be off by two sigma; 0.5 to 1.5 would do
OUTLIERS = 0.05  # of lights whose sources are two lamps in one, or half hidden, and fit no place though poses are right
NEAR_MISS = 4.0  # ln of odds: made-up rooms have one for 30 lights, wrong poses one for each
ABOUT_RAD = np.radians(3.0)  # of a free source from where its camera should see a light: a place by wrong poses is wrong itself
UNEXPLAINED = 0.3  # ln of odds of a source that is no light: as a rule it is hidden from the others
CLAIMED = 4  # degrees of freedom with which the rig file's own word counts for the misfit: one lamp alone says little
FRAMES = 4  # of whose evidence the mean counts: noise is new in each, poses are not


class Evidence(NamedTuple):
    """Of a moment. ln_odds: that poses are as declared over WRONG times as wrong. misfit: chi2 of all lights' directions over their degrees
    of freedom, with CLAIMED more of them at 1.
    """

    ln_odds: float
    misfit: float


def direction_chi2(matched: Matches, seen: SeenSources) -> np.ndarray:
    """chi2 (n,) of lights' directions, without their fluxes."""
    total = np.zeros(len(matched.fit))
    for k in range(matched.sources.shape[1]):
        there = np.flatnonzero(matched.sources[:, k] >= 0)
        own, fit = seen.table[k, matched.sources[there, k]], matched.fit[there]
        p = fit[:, :3] + fit[:, 3:4] * seen.offsets[k]
        length = np.linalg.norm(p, axis=1)
        off = own[:, :3] - p / length[:, None]
        variance = own[:, 4] + own[:, 5] + seen.pose[0] ** 2 + (seen.pose[1] * fit[:, 3] / length) ** 2
        total[there] += (off * off).sum(axis=1) / variance
    return total


def evidence(matched: Matches, seen: SeenSources, free: list[np.ndarray]) -> Evidence | None:
    """None where no light says anything of the poses.

    free: of each camera, the indices of its sources that are no light's and that another camera should see.
    """
    if not len(matched.fit):
        return None
    chi2, freedom = direction_chi2(matched, seen), 2 * (matched.sources >= 0).sum(axis=1) - 3
    # A light's fit has the density of its chi2, and WRONG^-freedom of that where errors are so much greater.
    fitting = np.log1p(-OUTLIERS) + freedom * np.log(WRONG) - chi2 / 2
    near, unexplained = _left_out(matched, seen, free, chi2) + _near_misses(seen, free), sum(len(each) for each in free)
    ln_odds = PRIOR + float(np.logaddexp(fitting, np.log(OUTLIERS)).sum()) - NEAR_MISS * near - UNEXPLAINED * unexplained
    return Evidence(ln_odds, float((CLAIMED + chi2.sum()) / (CLAIMED + freedom.sum())))


def _loose(table: np.ndarray) -> np.ndarray:
    """Sources whose flux says little, but whose colour counts."""
    table = table.copy()
    table[:, :, 6] = np.maximum(table[:, :, 6], 0.9 * UNKNOWN_FLUX)
    return table


def _left_out(matched: Matches, seen: SeenSources, free: list[np.ndarray], chi2: np.ndarray) -> int:
    """How many free sources are about where their camera should see a light that it has no source of, and do not fit its directions."""
    joined, lights, own = [np.zeros((0, len(free)), np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for k, each in enumerate(free):
        without = np.flatnonzero(matched.sources[:, k] < 0)
        fit = matched.fit[without]
        light, source = np.nonzero(is_seen_at(fit[:, :3], fit[:, 3], fit[:, 4], seen.offsets[k], seen.table[k, each], ABOUT_RAD))
        joined.append(matched.sources[without[light]])
        joined[-1][:, k] = each[source]
        lights.append(without[light])
        own.append(each[source])
    chosen, light = np.concatenate(joined), np.concatenate(lights)
    if not len(chosen):
        return 0
    table = _loose(seen.table)
    together = Matches(chosen, fits(table, chosen, seen.offsets, seen.pose), np.zeros(len(chosen)), False)
    off = direction_chi2(together, seen) - chi2[light] > PAIR_CHI2  # they have 2 more degrees of freedom, as a pair with its flux has
    count, start = 0, 0
    for each, source in zip(lights, own, strict=True):
        here = off[start : start + len(each)]
        count, start = count + min(len(np.unique(each[here])), len(np.unique(source[here]))), start + len(each)
    return count


def _near_misses(seen: SeenSources, free: list[np.ndarray]) -> int:
    """How many more sources would be lights' if poses were REACH times as wrong, and are none since their directions do not fit."""
    counts = np.array([len(each) for each in free], np.int64)
    if np.count_nonzero(counts) < 2:
        return 0
    table, chroma = np.zeros((len(free), counts.max(), seen.table.shape[2])), np.zeros((len(free), counts.max(), 3))
    for k, each in enumerate(free):
        table[k, : len(each)], chroma[k, : len(each)] = seen.table[k, each], seen.chroma[k, each]
    some = seen._replace(table=_loose(table), counts=counts, chroma=chroma)
    wrong = some.table.copy()
    wrong[:, :, 4:6] *= REACH**2
    found = matches(some._replace(table=wrong, pose=REACH * seen.pose))
    declared = found._replace(fit=fits(some.table, found.sources, seen.offsets, seen.pose))
    cameras = (found.sources >= 0).sum(axis=1)
    off = direction_chi2(declared, some) > PAIR_CHI2 + CHI2_A_CAMERA * (cameras - 2)
    return int((cameras[off] - 1).sum())
