"""Scores a sequence of lights: how close it is to its maps, and how steady. For `vemlight lights --score`, the charts and the tests."""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import LUMINANCE_WEIGHTS, luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, angle_between
from vemlight.sampler.light_map import light_map
from vemlight.sampler.probes import SOFTNESS, Probes, irradiance_of_lights, irradiance_of_map, probes

MIN_SPREAD_RAD = float(np.radians(0.06))  # across a light: a shadow's edge is never sharper than a tenth of a cell
SCORE_PROBES = 512  # the error's own uncertainty is 1 / sqrt(2 x 512) = 3 %; any larger value does
KNOWN_FRAMES = 25  # a second: a light that was away for less comes back, a longer one is new
JUMP_DEG = 10.0  # between two frames: seen as one light that goes and another that comes


class Score(NamedTuple):
    """Of a sequence of `frames` frames. Errors and changes are relative to the mean irradiance at the probes, RMS over them, luminance.

    error: lights against map, mean over the frames; error_worst: of the worst frame. flicker: change of that difference from frame to
    frame; change: of the lights' own irradiance. motion_deg, motion_worst_deg: angle by which a light moves from frame to frame, by id,
    mean and largest. births, deaths, jumps: ids that come, that go, and moves of more than JUMP_DEG, per frame. born_power: fraction of
    the power under ids that were not there in the last KNOWN_FRAMES frames, mean over the frames but the first. power_error: total
    irradiance of the lights against the map's, worst frame and channel; power_drift: over the whole sequence.
    """

    frames: int
    lights_min: int
    lights_mean: float
    lights_max: int
    error: float
    error_worst: float
    flicker: float
    change: float
    motion_deg: float
    motion_worst_deg: float
    births: float
    deaths: float
    jumps: float
    born_power: float
    power_error: float
    power_drift: float


def score(sequence: Iterable[tuple[np.ndarray, LightSet]], coverage: Coverage = "hemisphere") -> Score:
    """The score of maps (rows, cols, 3) with their lights, in order. Black frames take part with the mean of the sequence as scale.

    Raises ValueError for an empty sequence.
    """
    at = probes(SCORE_PROBES, coverage)
    errors, irradiance, totals, moves, counts = [], [], [], [], []
    births, deaths, born = 0, 0, []
    known: deque[set[int]] = deque(maxlen=KNOWN_FRAMES)
    previous: LightSet | None = None
    for radiance, lights in sequence:
        light = light_map(radiance, coverage)
        truth = irradiance_of_map(at, light.radiance, coverage)
        irradiance.append((truth, _irradiance(at, lights)))
        errors.append(_rms(irradiance[-1][1] - truth))
        totals.append((light.irradiance, lights.irradiance.sum(axis=0, dtype=np.float64)))
        counts.append(len(lights.ids))
        if previous is not None:
            _, now, before = np.intersect1d(lights.ids, previous.ids, return_indices=True)
            pair = lights.directions[now].astype(np.float64), previous.directions[before].astype(np.float64)
            moves.append(np.degrees(angle_between(*pair)))
            power = luminance_from_rgb(lights.irradiance.astype(np.float64))
            born.append(float(power[~np.isin(lights.ids, list(set().union(*known)))].sum() / (power.sum() or 1.0)))
            births, deaths = births + len(lights.ids) - len(now), deaths + len(previous.ids) - len(now)
        previous = lights
        known.append(set(lights.ids.tolist()))
    if not counts:
        raise ValueError("a score needs at least one frame")
    truth, got = np.moveaxis(np.array(irradiance), 1, 0)
    scale = truth.mean() or 1.0
    steps = max(len(counts) - 1, 1)
    given, made = np.moveaxis(np.array(totals), 1, 0)
    received, emitted = luminance_from_rgb(given.sum(axis=0)), luminance_from_rgb(made.sum(axis=0))
    moved = np.concatenate(moves) if moves else np.zeros(0)
    return Score(
        frames=len(counts),
        lights_min=min(counts),
        lights_mean=float(np.mean(counts)),
        lights_max=max(counts),
        error=float(np.mean(errors) / scale),
        error_worst=float(np.max(errors) / scale),
        flicker=float(sum(_rms(d) for d in np.diff(got - truth, axis=0)) / steps / scale),
        change=float(sum(_rms(d) for d in np.diff(got, axis=0)) / steps / scale),
        motion_deg=float(moved.mean()) if moved.size else 0.0,
        motion_worst_deg=float(moved.max()) if moved.size else 0.0,
        births=births / steps,
        deaths=deaths / steps,
        born_power=float(np.mean(born)) if born else 0.0,
        jumps=float((moved > JUMP_DEG).sum() / steps),
        power_error=float((np.abs(made - given).max(axis=0) / np.maximum(given.mean(axis=0), 1e-30)).max()),
        power_drift=float(emitted / (received or 1.0) - 1) if given.any() else 0.0,
    )


def _irradiance(at: Probes, lights: LightSet) -> np.ndarray:
    if lights.covariances is None:
        return irradiance_of_lights(at, lights.directions, lights.irradiance)
    return irradiance_of_soft_lights(at, lights.directions, lights.irradiance @ LUMINANCE_WEIGHTS, lights.covariances)


def irradiance_of_soft_lights(at: Probes, directions: np.ndarray, strength: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Irradiance (k,) at the probes of lights with extent: directions (n, 3), strength (n,), covariances (n, 6) as in LightSet.

    For a normal n, an occluder h, a mean m and a covariance C, with a = n.m, u^2 = n.C n, s = h.m and v^2 = h.C h: E f(a, u) g, where
    f(a, u) = a Phi(a / u) + u phi(a / u) is the mean of a normal variable's positive part, and g = (f(s + w, v) - f(s - w, v)) / (2 w) that
    of the probe's own edge, a ramp of w = SOFTNESS either way.
    """
    full = covariances.astype(np.float64)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    means = np.sqrt(np.maximum(1 - np.trace(full, axis1=1, axis2=2), 0))[:, None] * directions
    u2, v2 = (np.maximum(np.einsum("ki,nij,kj->kn", axis, full, axis), MIN_SPREAD_RAD**2) for axis in at)
    s, v = at.occluders @ means.T, np.sqrt(v2)
    open_ = (_positive_part(s + SOFTNESS, v) - _positive_part(s - SOFTNESS, v)) / (2 * SOFTNESS)
    return (_positive_part(at.normals @ means.T, np.sqrt(u2)) * open_) @ strength


def _positive_part(mean: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The mean of max(0, x) of normal variables x."""
    from scipy.special import ndtr  # here, since it takes a sixth of a second to load

    return mean * ndtr(mean / spread) + spread * np.exp(-0.5 * (mean / spread) ** 2) / np.sqrt(2 * np.pi)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values)))


def score_text(score: Score) -> str:
    """The score for a terminal, one figure a line."""
    rows = [
        ("frames", f"{score.frames}"),
        ("lights", f"{score.lights_mean:.1f} a frame ({score.lights_min} to {score.lights_max})"),
        ("error", f"{100 * score.error:.2f} % of the irradiance (worst frame {100 * score.error_worst:.2f} %)"),
        ("flicker", f"{100 * score.flicker:.2f} % a frame (the lights' own change {100 * score.change:.2f} %)"),
        ("motion", f"{score.motion_deg:.2f} degrees a frame and light (largest {score.motion_worst_deg:.1f})"),
        ("come and go", f"{score.births:.2f} born, {score.deaths:.2f} dead, {score.jumps:.2f} jumping over {JUMP_DEG:g} degrees a frame"),
        ("new lights", f"{100 * score.born_power:.2f} % of the power a frame"),
        ("power", f"{100 * score.power_error:.4f} % off in the worst frame, {100 * score.power_drift:+.4f} % over the sequence"),
    ]
    return "\n".join(f"{name:<12} {value}" for name, value in rows)
