"""Lights with extent beside points: error with hard edges on every map, and identity over moving sequences.

Writes docs/charts/soft_lights.csv and soft_lights_moving.csv.

    VEMLIGHT_DATA=... python -m bench.soft_lights
"""

import csv
import math
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.accuracy.maps import maps
from bench.evaluation import Points, Source, judged_hard, points_of, probe_irradiance, read_source, relative_rms
from bench.sequences import SEQUENCES, SUN, World, disc, turned, world_from_latlong
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.sphere import direction_from_angles, rotation_xyz
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.tracking.tracked import initial_tracked, tracked_step

OUT = Path(__file__).parents[1] / "docs" / "charts"
COUNTS = (8, 16, 64, 256)
SETTLED = 8  # frames of a still map before it is judged
KNOWN_FRAMES = 25  # a second: an id that was not there for longer is born
NEAR_RAD, COMPACT = math.radians(3.0), 0.05  # where a source's light is sought; of the power, above which a source counts


class Moment(NamedTuple):
    """time_s: of the frame. sources: direction and fraction of the power of each compact source that is there."""

    time_s: float
    source: Source
    sources: list[tuple[np.ndarray, float]]


def step(count: int, soft: bool, state, moment: Moment):
    frame = SamplerInput(moment.source.polar, "hemisphere", moment.time_s, moment.source.bright_cells)
    state, lights, _ = tracked_step(count, state, frame, False, soft)
    return state, lights


def still() -> list[dict[str, object]]:
    """The error of each number of lights on each map."""
    rows = []
    for path in maps():
        source = read_source(path)
        truth = probe_irradiance(points_of(source), 1).hard.astype(float)
        for count in COUNTS:
            row: dict[str, object] = {"map": path.stem, "lights": count}
            for soft in (False, True):
                state = initial_tracked()
                for k in range(SETTLED):
                    state, lights = step(count, soft, state, Moment(k / 25, source, []))
                row["soft" if soft else "points"] = relative_rms(judged_hard(lights) - truth, truth)
            rows.append(row)
    return rows


def day(world: World) -> Iterator[Moment]:
    """A day in 48 frames: the sun crosses the sky, brightens and reddens while the sky turns."""
    for k in range(48):
        turn = (k + 0.5) / 48 * np.pi
        place = direction_from_angles(np.pi / 2 - 1.1 * np.sin(turn), turn - np.pi / 2)
        sun = disc(place, 0.53, SUN * np.sin(turn) * world.power * [1, 0.7 + 0.2 * np.sin(turn), 0.3 + 0.5 * np.sin(turn)])
        yield _moment(k / 25, turned(world, rotation_xyz((0, 0, 1.5 * k)), sun), [(place, sun)])


def clouds(world: World) -> Iterator[Moment]:
    """A sun that clouds hide for less than half a second at a time."""
    for k in range(60):
        open_ = max(np.sin(2 * np.pi * k / 20), 1e-6) ** 0.5 if 10 < k < 50 else 1.0
        place = direction_from_angles(np.radians(40 + 0.05 * k), np.radians(10))
        sun = disc(place, 0.53, open_ * SUN * world.power)
        yield _moment(k / 25, turned(world, rotation_xyz((0, 0, 0.1 * k)), sun), [(place, sun)])


def opposite_lamps(world: World) -> Iterator[Moment]:
    """Two lamps of 4 degrees opposite each other, one fading into the other."""
    for k in range(48):
        part, lamps = 0.5 + 0.5 * np.cos(2 * np.pi * k / 48), []
        for strength, azimuth in ((part, 0.3), (1 - part, 0.3 + np.pi)):
            place = direction_from_angles(np.radians(50), azimuth)
            lamps.append((place, disc(place, 4.0, max(strength, 1e-9) * 3 * world.power)))
        both = Points(*(np.concatenate([getattr(lamp, name) for _, lamp in lamps]) for name in Points._fields))
        yield _moment(k / 25, turned(world, np.eye(3), both), lamps)


def _moment(time_s: float, source: Source, lamps: list[tuple[np.ndarray, Points]]) -> Moment:
    whole = luminance_from_rgb(points_of(source).irradiance.sum(axis=0))
    return Moment(time_s, source, [(place, float(luminance_from_rgb(lamp.irradiance.sum(axis=0)) / whole)) for place, lamp in lamps])


def _from_frames(name: str):
    def moments(world: World) -> Iterator[Moment]:
        for frame in SEQUENCES[name](world):
            yield Moment(frame.time_s, frame.source._replace(polar=frame.seen), [])

    return moments


MOVING = {
    "day": day, "clouds": clouds, "opposite lamps": opposite_lamps,
    "rotation": _from_frames("rotation"), "hand-held": _from_frames("hand-held"),
}  # fmt: skip


def moving(path: Path, name: str, count: int, soft: bool) -> dict[str, object]:
    """Error, error over that of the same sampler begun anew in each frame, born power, and identity of compact sources."""
    state, errors, anew, born, times, carried = initial_tracked(), [], [], [], [], []
    known, last, changes = deque(maxlen=KNOWN_FRAMES), {}, 0
    for moment in MOVING[name](world_from_latlong(read_radiance(path)[0])):
        truth = probe_irradiance(points_of(moment.source), 1).hard.astype(float)
        begin = time.thread_time()
        state, lights = step(count, soft, state, moment)
        times.append(time.thread_time() - begin)
        errors.append(relative_rms(judged_hard(lights) - truth, truth))
        anew.append(relative_rms(judged_hard(step(count, soft, initial_tracked(), moment)[1]) - truth, truth))
        power = luminance_from_rgb(lights.irradiance.astype(float))
        if known:
            born.append(power[~np.isin(lights.ids, list(set().union(*known)))].sum() / power.sum())
        known.append(set(lights.ids.tolist()))
        for n, (place, fraction) in enumerate(moment.sources):
            near = np.flatnonzero(lights.directions @ place > np.cos(NEAR_RAD))
            if fraction >= COMPACT and len(near):
                strongest = near[power[near].argmax()]
                changes += last.get(n, lights.ids[strongest]) != lights.ids[strongest]
                last[n] = lights.ids[strongest]
                carried.append(power[strongest] / power.sum() / fraction)
    ratio = np.array(errors) / np.array(anew)
    return {
        "map": path.stem, "sequence": name, "lights": "soft" if soft else "points",
        "error": float(np.mean(errors)), "worst": float(np.max(errors)),
        "error_ratio": float(np.mean(errors) / np.mean(anew)), "ratio_p95": float(np.percentile(ratio, 95)),
        "born_power": float(np.mean(born)),
        "id_changes_per_100": 100 * changes / len(errors), "carried": float(np.mean(carried)) if carried else math.nan,
        "ms": 1e3 * float(np.median(times)),
    }  # fmt: skip


def write(name: str, rows: list[dict[str, object]]) -> None:
    with open(OUT / name, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)


def main() -> None:
    rows = still()
    write("soft_lights.csv", rows)
    for count in COUNTS:
        means = [np.mean([float(str(row[kind])) for row in rows if row["lights"] == count]) for kind in ("points", "soft")]
        print(f"{count:4} lights: points {means[0]:.4f}, soft {means[1]:.4f}")
    rows = [moving(path, name, 64, soft) for path in maps()[::4] for name in MOVING for soft in (False, True)]
    write("soft_lights_moving.csv", rows)
    for row in rows:
        print(*(f"{key} {value:.3f}" if isinstance(value, float) else value for key, value in row.items()))


if __name__ == "__main__":
    main()
