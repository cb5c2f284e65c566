"""Which sources of several cameras are one light: hypotheses that fit one place, and the set of them of the greatest value.

A hypothesis takes one source of each of two or more cameras. It begins with two sources that lie in one plane with their cameras, and grows
by a source of a further camera where the place that it has so far is seen from there.
"""

from typing import NamedTuple

import numpy as np

from vemlight.fuse.set_packing import best_disjoint
from vemlight.fuse.triangulation import FIT, UNKNOWN_FLUX, WORK, add_covariance, fit_light
from vemlight.kernels import kernel, subroutine

EPIPOLAR_SIGMAS = 4.0
SAME_CHROMA = 0.06  # of r, g and b over their sum
PAIR_LN_FLUX = 2.5  # of two cameras' flux: a light three and a half times as far from one as from the other
MORE_LN_FLUX = 1.0  # of a further camera's, from what the place says
PAIR_CHI2, CHI2_A_CAMERA = 16.0, 8.0  # a pair has 2 degrees of freedom, each further camera 3 more
NEAREST = 3  # sources of a further camera that are tried
AROUND_SIGMAS, AROUND_RAD = 5.0, 0.005  # of where it is looked for: errors, and what a model leaves out, .3 degrees
BEHIND_SIGMAS = 3.0  # of inverse distance: by which noise puts a far light beyond infinity
A_CAMERA, MISSED = 10.0, 4.0  # value of each camera after the first, and what a camera costs that should see the light and does not
APART_SIGMAS = 4.0  # of inverse distance, between two explanations of one source
ASKED = 6.0  # of value: a source with another explanation that is so nearly as good is looked into
ABOUT_RAD, ABOUT_LN_FLUX = np.radians(1.5), 1.0  # of a source that may be a light which it was not matched with
SEES = 0.02  # cosine from a lens's axis at which a map of its hemisphere ends
MAX_HYPOTHESES = 4096  # four cameras with twelve lamps alike have 133
MANY_CAMERAS = 5  # from here on a camera that fits is not left out of a hypothesis: sets of cameras double with each
SOURCE_NUMBERS = 8  # numbers of a source: see `fit_light`


class SeenSources(NamedTuple):
    """The sources of all cameras.

    table: (cameras, n, SOURCE_NUMBERS) float64 as `fit_light` takes them. counts: (cameras,) int64, how many are there.
    chroma: (cameras, n, 3), shares of r, g, b. offsets: (cameras, 3), centre - place, m. axes: (cameras, 3), of the maps in the world.
    limits: (cameras,), cosine from the axis above which a camera sees, -2 for a whole sphere, 2 for a silent one. pose: rad, m.
    """

    table: np.ndarray
    counts: np.ndarray
    chroma: np.ndarray
    offsets: np.ndarray
    axes: np.ndarray
    limits: np.ndarray
    pose: np.ndarray


class Matches(NamedTuple):
    """Lights that two or more cameras see. sources: (n, cameras) int64, of each camera its source, -1: none. fit: (n, FIT). margin: (n,),
    by which the set's value is above that of the best set in which a light's sources are something else; inf where nothing else is near it.
    cut: whether there were more hypotheses than MAX_HYPOTHESES, or sets to look at than a search takes: a better set may be missed then.
    """

    sources: np.ndarray
    fit: np.ndarray
    margin: np.ndarray
    cut: bool


def matches(seen: SeenSources) -> Matches:
    """The set of lights of the greatest value in which each source is used once."""
    sources, values, fit = _hypotheses(*seen)
    members = sources + np.where(sources >= 0, np.arange(sources.shape[1]) * seen.table.shape[1], 0)
    best, is_exact = best_disjoint(members, values)
    is_cut = len(values) == MAX_HYPOTHESES or not is_exact
    return Matches(sources[best], fit[best], _margins(members, values, fit, best), is_cut)


def from_camera(u: np.ndarray, rho: np.ndarray, s: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) of lights from a camera, and ln flux (n,) there."""
    p = u + rho[:, None] * offset
    length = np.linalg.norm(p, axis=1)
    return p / np.maximum(length, 1e-9)[:, None], s - 2 * np.log(np.maximum(length, 1e-9))


def is_seen_at(
    u: np.ndarray, rho: np.ndarray, s: np.ndarray, offset: np.ndarray, sources: np.ndarray, about_rad: float = ABOUT_RAD
) -> np.ndarray:
    """Which of a camera's sources (m, SOURCE_NUMBERS) are about where it would see which lights, and of about their flux: (n, m) bool."""
    directions, ln_flux = from_camera(u, rho, s, offset)
    here = directions @ sources[:, :3].T > np.cos(about_rad)
    return here & (np.abs(ln_flux[:, None] - sources[None, :, 3]) < ABOUT_LN_FLUX)


def _margins(members: np.ndarray, values: np.ndarray, fit: np.ndarray, best: np.ndarray) -> np.ndarray:
    """See Matches. Only where another explanation may be as good, the best set is sought in which none has the light at its place."""
    shares = ((members[best][:, None] == members[None]) & (members[None] >= 0)).any(axis=2)
    elsewhere = np.abs(fit[best, 3][:, None] - fit[None, :, 3]) > APART_SIGMAS * np.sqrt(fit[best, 16][:, None] + fit[None, :, 16])
    others = np.where(shares & elsewhere, values[None], -np.inf)
    margins = np.full(len(best), np.inf)
    whole = values[best].sum()
    for n in np.flatnonzero(values[best] - others.max(axis=1, initial=-np.inf) < ASKED):
        allowed = np.where(shares[n] & ~elsewhere[n], 0.0, values)
        margins[n] = whole - values[best_disjoint(members, allowed)[0]].sum()
    return margins


@kernel
def _hypotheses(table, counts, chroma, offsets, axes, limits, pose):
    cameras = len(counts)
    sources = np.empty((MAX_HYPOTHESES, cameras), np.int64)
    values, fit, work = np.empty(MAX_HYPOTHESES), np.empty((MAX_HYPOTHESES, FIT)), np.empty((WORK, 4))
    end, active = 0, 0
    for k in range(cameras):
        active += limits[k] < 2
    for a in range(cameras):
        for b in range(a + 1, cameras):
            baseline = offsets[a] - offsets[b]
            for i in range(counts[a]):
                for j in range(counts[b]):
                    first, second = table[a, i], table[b, j]
                    if end < MAX_HYPOTHESES and _may_be_one(first, second, chroma[a, i], chroma[b, j], baseline, pose):
                        for k in range(cameras):
                            sources[end, k] = i if k == a else j if k == b else -1
                        end = _kept(table, sources, offsets, pose, fit, work, PAIR_CHI2, end)
    at = 0
    while at < end:
        last, members = 0, 0
        for k in range(cameras):
            if sources[at, k] >= 0:
                last = k
                members += 1
        limit = PAIR_CHI2 + CHI2_A_CAMERA * (members - 1)
        for c in range(last + 1, cameras):
            before = end
            end = _extended(table, counts, chroma, offsets, pose, sources, fit, work, at, c, limit, end)
            if end > before and active > MANY_CAMERAS:
                break
        values[at] = A_CAMERA * (members - 1) - fit[at, 5] / 2 - MISSED * _missed(sources[at], offsets, axes, limits, fit[at])
        at += 1
    return sources[:end], values[:end], fit[:end]


@subroutine
def _may_be_one(a, b, chroma_a, chroma_b, baseline, pose):
    # whether two cameras' sources lie in a plane with them and have one colour
    for c in range(3):
        if abs(chroma_a[c] - chroma_b[c]) > SAME_CHROMA and max(a[6], b[6]) < UNKNOWN_FLUX:
            return False
    if abs(a[3] - b[3]) > PAIR_LN_FLUX + 2 * (np.sqrt(a[6]) + np.sqrt(b[6])):
        return False
    x, y, z = baseline
    length = np.sqrt(x * x + y * y + z * z)
    volume = x * (a[1] * b[2] - a[2] * b[1]) + y * (a[2] * b[0] - a[0] * b[2]) + z * (a[0] * b[1] - a[1] * b[0])
    variance = a[4] + a[5] + b[4] + b[5] + 2 * pose[0] ** 2 + 8 * pose[1] ** 2  # places: as for a light at half a metre
    return abs(volume) < EPIPOLAR_SIGMAS * np.sqrt(variance) * length


@subroutine
def _kept(table, sources, offsets, pose, fit, work, limit, end):
    # the end of the hypotheses after the one there is fitted: one further where it holds
    chi2 = fit_light(table, sources[end], offsets, pose, fit[end], work)
    if chi2 < limit:
        add_covariance(table, sources[end], offsets, pose, fit[end], work)
        if fit[end, 3] > -BEHIND_SIGMAS * np.sqrt(fit[end, 16]):
            return end + 1
    return end


@subroutine
def _extended(table, counts, chroma, offsets, pose, sources, fit, work, at, camera, limit, end):
    # a hypothesis with the sources of a further camera that lie nearest to where it should be seen
    p, across, length, along = np.empty(3), 0.0, 0.0, 0.0
    for x in range(3):
        p[x] = fit[at, x] + fit[at, 3] * offsets[camera, x]
        length += p[x] * p[x]
        along += p[x] * offsets[camera, x]
        across += offsets[camera, x] ** 2
    length = np.sqrt(max(length, 1e-12))
    across = max(across - (along / length) ** 2, 0.0)  # of the offset, squared, seen across the direction
    error = (fit[at, 6] + fit[at, 11] + across * fit[at, 16]) / length**2 + pose[0] ** 2 + (pose[1] * fit[at, 3] / length) ** 2
    first = -1
    for k in range(len(counts)):
        if first < 0 and sources[at, k] >= 0:
            first = k
    mean, loose = chroma[first, sources[at, first]], table[first, sources[at, first], 6]
    tried = np.full(NEAREST, -1, np.int64)
    for n in range(NEAREST):
        nearest, best = np.inf, -1
        for i in range(counts[camera]):
            light, taken, off = table[camera, i], False, 0.0
            for m in range(n):
                taken = taken or tried[m] == i
            for x in range(3):
                taken = taken or (abs(chroma[camera, i, x] - mean[x]) > SAME_CHROMA and max(loose, light[6]) < UNKNOWN_FLUX)
                off += (light[x] - p[x] / length) ** 2
            faint = abs(light[3] - fit[at, 4] + 2 * np.log(length)) > MORE_LN_FLUX + 2 * np.sqrt(fit[at, 21] + light[6])
            around = AROUND_RAD + AROUND_SIGMAS * np.sqrt(error + light[4] + light[5])
            if not taken and not faint and off < nearest and off < around * around:
                nearest, best = off, i
        if best < 0 or end >= MAX_HYPOTHESES:
            break
        tried[n] = best
        for k in range(len(counts)):
            sources[end, k] = sources[at, k]
        sources[end, camera] = best
        end = _kept(table, sources, offsets, pose, fit, work, limit, end)
    return end


@subroutine
def _missed(sources, offsets, axes, limits, fit):
    # how many cameras should see the light and have no source of it
    count = 0
    for k in range(len(sources)):
        if sources[k] < 0:
            length, along = 0.0, 0.0
            for x in range(3):
                p = fit[x] + fit[3] * offsets[k, x]
                length += p * p
                along += p * axes[k, x]
            count += along > limits[k] * np.sqrt(length)
    return count
