"""Lights followed from frame to frame: their ids, a filter for each, and which of them are near.

A light is constant in direction u, inverse distance rho and ln flux s about the rig's centre (Kalman 1960). Only what is new in each frame
is filtered: the errors of poses, lenses and lamps' shapes are the same in each, averaging does not lessen them, and they are added after
the filter. A light is near when its inverse distance stands NEAR_SIGMAS above nothing.
"""

from typing import NamedTuple

import numpy as np

from vemlight.fuse.matching import Matches
from vemlight.fuse.set_packing import best_disjoint
from vemlight.fuse.triangulation import set_basis, solve
from vemlight.kernels import kernel, subroutine

STEP_RAD, STEP_RHO, STEP_LN_FLUX = 1e-4, 0.003, 0.03  # by which a light may change from frame to frame; of rho relative
GATE = 20.0  # chi2 of 4 degrees of freedom
NEAR_SIGMAS, STAY_SIGMAS = 5.0, 3.0
MOVED_RAD, MOVED_CHROMA, MOVED_LN_INTENSITY = np.radians(20.0), 0.04, 0.4  # a light that jumps is the same one within these
NEW_SLOWER = 5.0  # one that was seen once and moves does so within 4 degrees: a lamp that is carried past at two metres
DIMMED_RHO = 0.2  # relative, by which the distance of one that moves and is dimmed at once may change: 4 degrees are 7 % across
BACK_SIGMAS, BACK_M = 4.0, 0.03  # and one that comes back, where it was; what a lamp on a stand sways
DIMMED_LN_FLUX = 3.0  # by which a light that stays may become fainter or brighter at once: a factor of 20
MIN_MARGIN = 3.0  # of a light over another explanation, in halves of chi2, for it to be thought near: 20 to 1
HITS = 2  # frames in which a light must be seen before it is published
HIDDEN_FRAMES = 8  # for which a light stays that one camera still sees
MAX_LOST = 64  # lights that are off and may come back


class Tracks(NamedTuple):
    """n lights. ids: (n,) int64. u: (n, 3). rho: (n,) 1/m. s: (n,). noise: (n, 4, 4), covariance of what is filtered, of u in the basis
    e1, e2 across it, rho and s. fixed: (n, 4, 4), of what is not. basis: (n, 2, 3). chroma: (n, 3). spread: (n,) rad^2 as seen from the
    centre. hits, missed: (n,) int64, frames in which it was seen, and since it was. near, sure: (n,) bool; sure: of this frame, that its
    sources have no other explanation. sources: (n, cameras) int64, of this frame, -1: none.
    """

    ids: np.ndarray
    u: np.ndarray
    rho: np.ndarray
    s: np.ndarray
    noise: np.ndarray
    fixed: np.ndarray
    basis: np.ndarray
    chroma: np.ndarray
    spread: np.ndarray
    hits: np.ndarray
    missed: np.ndarray
    near: np.ndarray
    sure: np.ndarray
    sources: np.ndarray

    def take(self, which: np.ndarray) -> "Tracks":
        return Tracks(*(field[which] for field in self))

    def joined(self, others: "Tracks") -> "Tracks":
        return Tracks(*(np.concatenate(pair) for pair in zip(self, others, strict=True)))

    def offsets(self) -> np.ndarray:
        """The lights' places (n, 3) m from the centre; inf for those at infinity."""
        with np.errstate(divide="ignore"):
            return self.u / self.rho[:, None]

    def place_covariances(self) -> np.ndarray:
        """(n, 3, 3) m^2, of places that are not at infinity."""
        rho = self.rho[:, None]
        jacobian = np.stack([self.basis[:, 0] / rho, self.basis[:, 1] / rho, -self.u / rho**2], axis=-1)
        return jacobian @ (self.noise + self.fixed)[:, :3, :3] @ jacobian.transpose(0, 2, 1)


def no_tracks(cameras: int) -> Tracks:
    """Before the first frame."""
    whole, number, vector, matrix, flag = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4, 4)), np.zeros(0, bool)
    return Tracks(whole, vector, number, number, matrix, matrix, np.zeros((0, 2, 3)), vector, number, whole, whole, flag, flag,
                  np.zeros((0, cameras), np.int64))  # fmt: skip


class Followed(NamedTuple):
    """tracks: lights of this frame. lost: lights that are off, the newest last. next_id: of a new light."""

    tracks: Tracks
    lost: Tracks
    next_id: int


def tracks_of(found: Matches, chroma: np.ndarray, spread: np.ndarray, sure: np.ndarray) -> Tracks:
    """A frame's lights as tracks without ids; chroma (n, 3) and spread (n,) of each, and whether its sources are sure (n,)."""
    fit, n = found.fit, len(found.fit)
    total, noise = fit[:, 6:22].reshape(n, 4, 4), fit[:, 22:38].reshape(n, 4, 4)
    ones = np.ones(n, np.int64)
    return Tracks(np.full(n, -1), fit[:, :3], fit[:, 3], fit[:, 4], noise, total - noise, fit[:, 38:44].reshape(n, 2, 3), chroma, spread,
                  ones, 0 * ones, np.zeros(n, bool), sure & (found.margin > MIN_MARGIN), found.sources)  # fmt: skip


def followed(before: Followed, seen: Tracks, is_still_lit: np.ndarray) -> Followed:
    """The lights after a frame: `seen` of this frame, with ids from before where they are the same ones.

    is_still_lit: (n,) bool of before.tracks, whether any camera has a source where it would see it: a light that none has is off.
    """
    known = before.tracks
    own, new = _same(known, seen)
    tracks = _filtered(known.take(own), seen.take(new))
    own_left, new_left = np.delete(np.arange(len(known.ids)), own), np.delete(np.arange(len(seen.ids)), new)
    if len(own_left) and len(new_left):
        dimmed = _dimmed(known.take(own_left))
        a, b = _same(dimmed, seen.take(new_left))
        tracks = tracks.joined(_filtered(dimmed.take(a), seen.take(new_left[b])))
        own_left, new_left = np.delete(own_left, a), np.delete(new_left, b)
        for values in (_moved_values, _moved_and_dimmed_values):
            a, b = _pairs(values(known.take(own_left), seen.take(new_left)))
            tracks = tracks.joined(_restarted(known.take(own_left[a]), seen.take(new_left[b])))
            own_left, new_left = np.delete(own_left, a), np.delete(new_left, b)
    lost = before.lost
    if len(lost.ids) and len(new_left):
        a, b = _pairs(_back_values(lost, seen.take(new_left)))
        tracks = tracks.joined(_restarted(lost.take(a), seen.take(new_left[b])))
        lost, new_left = lost.take(np.delete(np.arange(len(lost.ids)), a)), np.delete(new_left, b)
    fresh = seen.take(new_left)
    fresh = fresh._replace(ids=before.next_id + np.arange(len(fresh.ids)))
    gone = known.take(own_left)
    hidden = is_still_lit[own_left] & (gone.missed < HIDDEN_FRAMES) & (gone.hits >= HITS)
    waits = gone.take(hidden)
    waits = waits._replace(missed=waits.missed + 1, sources=np.full_like(waits.sources, -1))
    off = gone.take(~hidden & (gone.hits >= HITS) & gone.near)
    lost = lost.joined(off)
    lost = lost.take(np.arange(max(len(lost.ids) - MAX_LOST, 0), len(lost.ids)))
    tracks = tracks.joined(waits).joined(fresh)
    sigmas = tracks.rho / np.sqrt(np.maximum((tracks.noise + tracks.fixed)[:, 2, 2], 1e-30))
    tracks = tracks._replace(near=np.where(tracks.near, sigmas > STAY_SIGMAS, tracks.sure & (sigmas > NEAR_SIGMAS)))
    order = np.argsort(tracks.ids, kind="stable")
    return Followed(tracks.take(order), lost, before.next_id + len(fresh.ids))


def _pairs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which row goes with which column of values (n, m), each once, so that the values, those above 0, add up to the most."""
    rows, cols = np.nonzero(values > 0)
    best, _ = best_disjoint(np.stack([rows, cols + len(values)], axis=1).astype(np.int64), values[rows, cols])
    return rows[best], cols[best]


def _same(known: Tracks, seen: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Which light of before is which of this frame, by the gate of the filter."""
    chi2 = _distances(known.u, known.rho, known.s, known.basis, known.noise + known.fixed, seen.u, seen.rho, seen.s,
                      seen.noise + seen.fixed)  # fmt: skip
    return _pairs(GATE - chi2)


def _dimmed(known: Tracks) -> Tracks:
    """The lights of before, if nothing were known of how bright they are now: what is in the same place is the same lamp."""
    noise = known.noise.copy()
    noise[:, 3, 3] += DIMMED_LN_FLUX**2
    return known._replace(noise=noise)


def _moved_values(known: Tracks, seen: Tracks) -> np.ndarray:
    """How like each light of before is each of this frame, where it may have moved; 0 and below: too little."""
    angle = np.arccos(np.clip(known.u @ seen.u.T, -1, 1)) / MOVED_RAD
    colour = np.abs(known.chroma[:, None] - seen.chroma[None]).max(axis=2, initial=0.0) / MOVED_CHROMA
    intensity = np.abs(_ln_intensity(known)[:, None] - _ln_intensity(seen)[None]) / MOVED_LN_INTENSITY
    angle = np.where((known.hits >= HITS)[:, None], angle, NEW_SLOWER * angle)
    return np.where((angle < 1) & (colour < 1) & (intensity < 1), 4 - angle - colour - intensity, 0.0)


def _moved_and_dimmed_values(known: Tracks, seen: Tracks) -> np.ndarray:
    """The same where it may have become fainter or brighter, too: within 4 degrees, and not much nearer or farther."""
    angle = NEW_SLOWER * np.arccos(np.clip(known.u @ seen.u.T, -1, 1)) / MOVED_RAD
    colour = np.abs(known.chroma[:, None] - seen.chroma[None]).max(axis=2, initial=0.0) / MOVED_CHROMA
    variances = (known.noise + known.fixed)[:, 2, 2, None] + (seen.noise + seen.fixed)[None, :, 2, 2]
    inward = np.abs(known.rho[:, None] - seen.rho[None]) / (DIMMED_RHO * np.abs(known.rho[:, None]) + BACK_SIGMAS * np.sqrt(variances))
    dimmed = np.abs(_ln_intensity(known)[:, None] - _ln_intensity(seen)[None]) / DIMMED_LN_FLUX
    like = (angle < 1) & (colour < 1) & (inward < 1) & (dimmed < 1) & (known.near & (known.hits >= HITS))[:, None]
    return np.where(like, 4 - angle - colour - inward, 0.0)


def _back_values(lost: Tracks, seen: Tracks) -> np.ndarray:
    """How like each light that is off is each of this frame, by place; by colour and intensity, which may be others now, among several."""
    here = seen.rho > BACK_SIGMAS * np.sqrt(np.maximum(seen.fixed[:, 2, 2] + seen.noise[:, 2, 2], 0))
    values = np.zeros((len(lost.ids), len(seen.ids)))
    if not (len(lost.ids) and here.any()):
        return values
    found = seen.take(here)
    away = np.linalg.norm(lost.offsets()[:, None] - found.offsets()[None], axis=2)
    variances = [np.trace(each.place_covariances(), axis1=1, axis2=2) for each in (lost, found)]
    limit = BACK_M + BACK_SIGMAS * np.sqrt(variances[0][:, None] + variances[1][None])
    colour = np.abs(lost.chroma[:, None] - found.chroma[None]).max(axis=2) / MOVED_CHROMA
    intensity = np.abs(_ln_intensity(lost)[:, None] - _ln_intensity(found)[None]) / MOVED_LN_INTENSITY
    values[:, here] = np.where(away < limit, 4 - away / limit - np.minimum(colour, 1) - np.minimum(intensity, 1), 0.0)
    return values


def _ln_intensity(tracks: Tracks) -> np.ndarray:
    """ln of the intensity, W/sr; of lights beyond 1 km as if they were there."""
    return tracks.s - 2 * np.log(np.maximum(tracks.rho, 1e-3))


def _filtered(known: Tracks, seen: Tracks) -> Tracks:
    """Each light of before after its measurement; the basis becomes that of its new direction."""
    if not len(known.ids):
        return known
    noise = _turned(seen.noise, seen.basis, known.basis)
    state = _updated(known.u, known.rho, known.s, known.basis, known.noise, seen.u, seen.rho, seen.s, noise)
    u, rho, s, noise, bases, fixed = *state, _turned(seen.fixed, seen.basis, state[4])
    chroma = known.chroma + (seen.chroma - known.chroma) / 4  # of the last frames
    spread = known.spread + (seen.spread - known.spread) / 4
    return Tracks(known.ids, u, rho, s, noise, fixed, bases, chroma, spread, known.hits + 1, 0 * known.missed, known.near, seen.sure,
                  seen.sources)  # fmt: skip


def _restarted(known: Tracks, seen: Tracks) -> Tracks:
    """Lights of before, published as they were, in the state of this frame."""
    return seen._replace(ids=known.ids, hits=known.hits + 1, near=known.near)


def _turned(covariance: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Covariances (n, 4, 4) about bases `old` (n, 2, 3) about bases `new`, of nearly the same directions."""
    turn = np.zeros_like(covariance)
    turn[:, :2, :2] = new @ old.transpose(0, 2, 1)
    turn[:, 2, 2] = turn[:, 3, 3] = 1.0
    return turn @ covariance @ turn.transpose(0, 2, 1)


@kernel
def _distances(u, rho, s, bases, covariance, seen_u, seen_rho, seen_s, noise):
    """Mahalanobis distance, squared, of each light of before (n) to each of this frame (m); 1e9 far off."""
    out = np.full((len(u), len(seen_u)), 1e9)
    matrix, right, kept = np.empty((4, 4)), np.empty(4), np.empty(4)
    for n in range(len(u)):
        for m in range(len(seen_u)):
            if u[n, 0] * seen_u[m, 0] + u[n, 1] * seen_u[m, 1] + u[n, 2] * seen_u[m, 2] < 0.9:
                continue
            _difference(u[n], rho[n], s[n], bases[n], seen_u[m], seen_rho[m], seen_s[m], right)
            for i in range(4):
                kept[i] = right[i]
                for j in range(4):
                    matrix[i, j] = covariance[n, i, j] + noise[m, i, j]
            _add_steps(matrix, rho[n])
            if solve(matrix, right, 4):
                out[n, m] = kept[0] * right[0] + kept[1] * right[1] + kept[2] * right[2] + kept[3] * right[3]
    return out


@subroutine
def _difference(u, rho, s, bases, seen_u, seen_rho, seen_s, out):
    # of a light of this frame from one of before, in the basis of that
    out[0], out[1], out[2], out[3] = 0.0, 0.0, seen_rho - rho, seen_s - s
    along = 0.0
    for x in range(3):
        along += u[x] * seen_u[x]
        out[0] += bases[0, x] * seen_u[x]
        out[1] += bases[1, x] * seen_u[x]
    out[0] /= along
    out[1] /= along


@subroutine
def _add_steps(matrix, rho):
    # by what a light may have changed
    matrix[0, 0] += STEP_RAD * STEP_RAD
    matrix[1, 1] += STEP_RAD * STEP_RAD
    matrix[2, 2] += (STEP_RHO * rho) ** 2 + 1e-12
    matrix[3, 3] += STEP_LN_FLUX * STEP_LN_FLUX


@kernel
def _updated(u, rho, s, bases, covariance, seen_u, seen_rho, seen_s, noise):
    """The filter's step of n lights: u, rho, s, covariance and basis after it."""
    n = len(u)
    new_u, new_rho, new_s, new_covariance, new_bases = np.empty((n, 3)), np.empty(n), np.empty(n), np.empty((n, 4, 4)), np.empty((n, 2, 3))
    before, total, gain, right, difference = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty(4), np.empty(4)
    for k in range(n):
        for i in range(4):
            for j in range(4):
                before[i, j] = covariance[k, i, j]
        _add_steps(before, rho[k])
        for c in range(4):  # gain = before (before + noise)^-1, row by row, since both are symmetric
            for i in range(4):
                for j in range(4):
                    total[i, j] = before[i, j] + noise[k, i, j]
                right[i] = before[c, i]
            if not solve(total, right, 4):
                for i in range(4):
                    right[i] = 0.0
            for i in range(4):
                gain[c, i] = right[i]
        _difference(u[k], rho[k], s[k], bases[k], seen_u[k], seen_rho[k], seen_s[k], difference)
        for i in range(4):
            right[i] = 0.0
            for j in range(4):
                right[i] += gain[i, j] * difference[j]
                new_covariance[k, i, j] = before[i, j]
                for x in range(4):
                    new_covariance[k, i, j] -= gain[i, x] * before[x, j]
        length = 0.0
        for x in range(3):
            new_u[k, x] = u[k, x] + right[0] * bases[k, 0, x] + right[1] * bases[k, 1, x]
            length += new_u[k, x] ** 2
        for x in range(3):
            new_u[k, x] /= np.sqrt(length)
        new_rho[k], new_s[k] = rho[k] + right[2], s[k] + right[3]
        set_basis(new_u[k], new_bases[k, 0], new_bases[k, 1])
    return new_u, new_rho, new_s, new_covariance, new_bases
