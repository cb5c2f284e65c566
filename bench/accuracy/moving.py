"""Error against flicker over moving sequences, motion and deaths of lights, and each event frame by frame."""

import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import colour, grid, leave_margin, legend, save
from bench.accuracy.maps import chosen
from bench.evaluation import ProbeIrradiance, judged_hard, judged_softened, points_of, probe_irradiance
from bench.methods import MOVING
from bench.sequences import FRAMES, SEQUENCES, world_from_latlong
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import angle_between, map_irradiance
from vemlight.sampler.sampler_input import SamplerInput

COUNT = 64  # of lights
JUMP_DEG = 10.0


def moving(out: Path, progress: Progress) -> None:
    """Error against flicker, motion and deaths, and the frames of each event."""
    rows, curves, paths = [], [], chosen()
    task = progress.add_task("sequences", total=len(paths) * len(SEQUENCES))
    for kind, path in paths.items():
        world = world_from_latlong(read_radiance(path)[0])
        for name, frames in SEQUENCES.items():
            made = _run([*frames(world)])
            rows += [{"map": kind, "sequence": name, **row} for row, _ in made]
            curves += [{"map": kind, "sequence": name, "method": row["method"], "curve": curve} for row, curve in made]
            progress.advance(task)
    _chart_flicker(rows, out)
    _chart_motion(rows, out)
    _chart_events(curves, out)


def _run(frames: list[Any]) -> list[tuple[dict[str, Any], np.ndarray]]:
    """One row a method, and its error and flicker in each of the last FRAMES (FRAMES, 2): some sequences settle first."""
    truths: list[ProbeIrradiance] = []
    for k, frame in enumerate(frames):
        steady = k > 0 and frame.source.brightest is frames[k - 1].source.brightest
        truths.append(truths[-1] if steady else probe_irradiance(points_of(frame.source)))
    mean = np.mean([luminance_from_rgb(truth.hard).mean() for truth in truths])
    made = []
    for method in MOVING:
        state, lights, ms, power = method.start(COUNT), [], [], []
        for frame in frames:
            begin = time.thread_time()
            state, now = method.step(state, SamplerInput(frame.seen, "hemisphere", frame.time_s, frame.source.bright_cells))
            ms.append(1e3 * (time.thread_time() - begin))
            lights.append(now)
            total = map_irradiance(frame.source.polar, "hemisphere")
            power.append(float(np.abs(now.irradiance.sum(axis=0, dtype=float) / total - 1).max()))
        counted = [*zip(lights, truths, strict=True)][-FRAMES:]
        error = np.array([np.sqrt(np.mean(luminance_from_rgb(judged_hard(now) - truth.hard) ** 2)) / mean for now, truth in counted])
        soft = np.array([judged_softened(now) - luminance_from_rgb(truth.soft) for now, truth in counted]) / mean
        flicker = np.sqrt(np.mean(np.square(np.diff(soft, axis=0, prepend=soft[:1])), axis=1))
        row = {
            "method": method.name, "error": float(error.mean()), "error_worst": float(error.max()),
            "flicker": float(np.sqrt(np.mean(flicker[1:] ** 2))), "flicker_worst": float(flicker[1:].max()),
            **_motion(lights[-FRAMES:]), "power_worst": max(power[-FRAMES:]), "ms": float(np.median(ms)),
        }  # fmt: skip
        made.append((row, np.stack([error, flicker], axis=-1)))
    return made


def _motion(lights: list[LightSet]) -> dict[str, float]:
    """Per frame: mean motion of a light by its id in degrees, lights that jump, ids that end."""
    way, jumps, deaths = [], 0, 0
    for before, after in itertools.pairwise(lights):
        shared, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
        lit = (before.irradiance[a].sum(axis=1) > 0) & (after.irradiance[b].sum(axis=1) > 0)
        angle = np.degrees(angle_between(before.directions[a].astype(float), after.directions[b].astype(float)))[lit]
        way.append(float(angle.mean()) if len(angle) else 0.0)
        jumps += int((angle > JUMP_DEG).sum())
        deaths += len(before.ids) - len(shared)
    frames = len(lights) - 1
    return {"motion_deg": float(np.mean(way)), "jumps": jumps / frames, "deaths": deaths / frames}


def _means(rows: list[dict[str, Any]], sequence: str, method: str, key: str) -> float:
    return float(np.mean([r[key] for r in rows if r["sequence"] == sequence and r["method"] == method]))


def _chart_flicker(rows: list[dict[str, Any]], out: Path) -> None:
    figure, axes = grid(len(SEQUENCES), 3.9)
    for axis, name in zip(axes, SEQUENCES, strict=False):
        for k, method in enumerate(MOVING):
            axis.loglog(
                _means(rows, name, method.name, "error"),
                _means(rows, name, method.name, "flicker"),
                "*" if k < 1 else "o",
                ms=15 if k < 1 else 7,
                color=colour(k),
                label=method.name,
            )
        axis.set(title=name, xlabel="error, hard edges", ylabel="flicker per frame, softened edges")
        axis.set(xlim=(0.003, 1), ylim=(5e-5, 1))
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    legend(figure, axes[0])
    save(figure, rows, out, "moving_flicker", f"N = {COUNT}, mean over the maps, {FRAMES} frames; bottom left is best.")


def _chart_motion(rows: list[dict[str, Any]], out: Path) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(16, 5.4), layout="constrained")
    leave_margin(figure, 0.13)
    methods = [method for method in MOVING if method.steady]
    labels = {"motion_deg": "mean motion of a light, degrees", "jumps": "lights over 10 degrees", "deaths": "ids that end"}
    for axis, (key, label) in zip(axes, labels.items(), strict=True):
        for k, method in enumerate(methods):
            width = 0.84 / len(methods)
            place = np.arange(len(SEQUENCES)) + (k - (len(methods) - 1) / 2) * width
            axis.bar(
                place,
                [_means(rows, name, method.name, key) for name in SEQUENCES],
                width,
                color=colour(MOVING.index(method)),
                label=method.name,
            )
        axis.set(ylabel=f"{label}, per frame", yscale="symlog")
        axis.set_yscale("symlog", linthresh=0.1)
        axis.set_xticks(np.arange(len(SEQUENCES)), list(SEQUENCES), rotation=40, ha="right", fontsize=8)
        axis.grid(alpha=0.3, axis="y")
    legend(figure, axes[0])
    keep = ("map", "sequence", "method", "motion_deg", "jumps", "deaths")
    save(figure, [{k: r[k] for k in keep} for r in rows], out, "moving_motion", f"N = {COUNT}; only methods whose lights keep their ids.")


def _chart_events(curves: list[dict[str, Any]], out: Path) -> None:
    figure, axes = grid(2 * len(SEQUENCES), 2.5)
    rows = []
    for place, name in enumerate(SEQUENCES):
        for k, method in enumerate(MOVING):
            own = np.mean([c["curve"] for c in curves if c["sequence"] == name and c["method"] == method.name], axis=0)
            for n, (error, flicker) in enumerate(own):
                rows.append({"sequence": name, "method": method.name, "frame": n, "error": float(error), "flicker": float(flicker)})
            for part, label in enumerate(("error", "flicker")):
                axis = axes[2 * place + part]
                shown = own[part:, part].clip(1e-4)  # the first frame has no flicker
                front = {"lw": 2.2, "zorder": 3} if k == 0 else {"lw": 0.9}
                axis.semilogy(np.arange(part, len(own)), shown, color=colour(k), label=method.name, **front)
                axis.set_title(f"{name}: {label}", fontsize=9)
                axis.minorticks_off()
                axis.grid(alpha=0.3)
        for axis in axes[2 * place : 2 * place + 2]:
            low, high = axis.get_ylim()
            axis.set_ylim(min(low, 10 ** np.floor(np.log10(high))), high)  # a power of ten in sight
    legend(figure, axes[0])
    save(figure, rows, out, "moving_events", f"N = {COUNT}, mean over the maps, frame by frame.", dpi=72)
