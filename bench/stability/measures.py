"""What is measured of the lights of a sequence: error, flicker, and whether lights keep their identity."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from bench.evaluation import Points, ProbeIrradiance, judged_hard, judged_softened, points_of, probe_irradiance
from bench.sequences import Frame
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import angle_between

SOFT_PROBES = 512
KNOWN_FRAMES = 25  # a second: an id that was not there for longer is born
TORN_DEG = 10.0  # from frame to frame; no sequence moves light by more than half of it
NEAR_DEG = 3.0  # of a source: where its light is sought
COMPACT = 0.05  # of the power: below, a source's id is not counted
Measures = dict[str, float]


def measured(frames: Sequence[Frame], truths: Sequence[ProbeIrradiance], lights: Sequence[LightSet], settling: int) -> Measures:
    """Of the frames after the first `settling`; means over the frames, but for what is called worst.

    error: RMS with hard edges over the mean irradiance of the sequence. flicker: RMS change from frame to frame of the difference to the
    truth, soft edges. born, torn: power under ids that are new, and also under ids that jumped. id_changes: of the strongest light within
    NEAR_DEG of each compact source, per 100 frames; carried: its power over the source's, wobble: RMS change of that, place_wobble: of its
    direction's error, degrees; nan without such sources.
    """
    mean = float(np.mean([luminance_from_rgb(truth.hard).mean() for truth in truths]))
    hard = [_rms(judged_hard(now) - truth.hard) / mean for now, truth in zip(lights, truths, strict=True)][settling:]
    softened = [judged_softened(now, SOFT_PROBES) - luminance_from_rgb(truth.soft) for now, truth in zip(lights, truths, strict=True)]
    soft = np.array(softened[settling:]) / mean
    steps = np.sqrt(np.mean(np.diff(soft, axis=0) ** 2, axis=1))
    return {
        "error": float(np.mean(hard)), "error_worst": float(np.max(hard)),
        "flicker": float(np.sqrt(np.mean(steps**2))), "flicker_worst": float(steps.max()),
        **_identity(lights, settling), **_sources(frames[settling:], lights[settling:]),
        "lights": float(np.mean([len(now.ids) for now in lights])),
    }  # fmt: skip


def truth_of(points: Points) -> ProbeIrradiance:
    return probe_irradiance(points, SOFT_PROBES)


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(luminance_from_rgb(difference) ** 2)))


def _identity(lights: Sequence[LightSet], settling: int) -> Measures:
    """born and torn: fractions of the power, mean over the frames after the settling ones."""
    known: deque[set[int]] = deque(maxlen=KNOWN_FRAMES)
    last: dict[int, np.ndarray] = {}
    born, torn = [], []
    for now in lights:
        power = luminance_from_rgb(now.irradiance.astype(float))
        fresh = ~np.isin(now.ids, list(set().union(*known)))
        before = np.array([last.get(k, d) for k, d in zip(now.ids.tolist(), now.directions, strict=True)]).reshape(-1, 3)
        moved = np.degrees(angle_between(now.directions.astype(float), before.astype(float))) > TORN_DEG
        whole = power.sum() or 1.0
        born.append(power[fresh].sum() / whole)
        torn.append(power[fresh | moved].sum() / whole)
        known.append(set(now.ids[power > 0].tolist()))
        last |= dict(zip(now.ids.tolist(), now.directions, strict=True))
    begin = max(settling, 1)  # in the first frame all ids are new
    return {"born": float(np.mean(born[begin:])), "torn": float(np.mean(torn[begin:]))}


class Followed:
    """A compact source, followed from frame to frame."""

    def __init__(self, place: np.ndarray) -> None:
        self.place = place
        self.ids: list[int] = []
        self.carried: list[float] = []
        self.shifts: list[np.ndarray] = []  # of its light from its place


def _sources(frames: Sequence[Frame], lights: Sequence[LightSet]) -> Measures:
    """How each compact source is represented: by the strongest light near it."""
    followed: list[Followed] = []
    for frame, now in zip(frames, lights, strict=True):
        power = luminance_from_rgb(now.irradiance.astype(float))
        whole = luminance_from_rgb(points_of(frame.source).irradiance.sum(axis=0))
        for place, light in frame.added:
            strength = luminance_from_rgb(light.irradiance.sum(axis=0))
            if strength < COMPACT * whole:
                continue
            source = next((old for old in followed if old.place @ place > np.cos(np.radians(TORN_DEG))), None)
            if source is None:
                followed.append(source := Followed(place))
            source.place = place
            near = np.flatnonzero(now.directions @ place > np.cos(np.radians(NEAR_DEG)))
            if not len(near):
                source.carried.append(0.0)
                continue
            best = int(near[power[near].argmax()])
            source.ids.append(int(now.ids[best]))
            source.carried.append(float(power[best] / strength))
            source.shifts.append(now.directions[best] - place)
    carried = [value for source in followed for value in source.carried]
    if not carried:
        return dict.fromkeys(("id_changes", "carried", "wobble", "place_wobble"), float("nan"))
    changes = sum(int(np.count_nonzero(np.diff(source.ids))) for source in followed)
    steps = np.concatenate([np.diff(source.carried) for source in followed])
    shifts = np.concatenate([np.diff(source.shifts, axis=0).reshape(-1, 3) for source in followed])
    return {
        "id_changes": 100 * changes / len(carried),
        "carried": float(np.mean(carried)),
        "wobble": float(np.sqrt(np.mean(steps**2))) if len(steps) else 0.0,
        "place_wobble": float(np.degrees(np.sqrt(np.mean(np.sum(shifts**2, axis=1))))) if len(shifts) else float("nan"),
    }
