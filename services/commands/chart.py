"""`vemlight chart`: error, flicker and time of each method on a user's own maps, as charts and as numbers."""

import csv
import os
import platform
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.source import open_source
from vemlight.errors import UserError
from vemlight.files import written_whole
from vemlight.light.bright_cells import BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_directions
from vemlight.sampler import score
from vemlight.sampler.light_map import light_map
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from vemlight.sampler.required_lights import DARK_PROBE, REQUIRED_PROBES
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler

METHODS = ("tracked", "havran-azimuth", "havran-radius", "standard")
UNFILTERED = "havran-azimuth, no filter"  # for moving light: shows the effect of the 2005 filter
COUNTS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
MOVING_COUNT = 64
FRAMES = 24  # of moving light
STILL_FRAMES = 6  # of a still map: enough for lights to settle and for a median of times
FPS = 25.0
EVENTS = {"lamp off and on": 8, "black frames": 2, "invalid cells": 4}  # duration in frames
BEFORE = 8  # frames before an event: as many as the 2005 filter looks back
LAMP_DEG = 10.0  # radius around the brightest cell of what goes out, or is invalid
ERROR_LIMITS = (40.0, 20.0, 10.0)  # per cent
SETTLING_FRAMES = 20  # within which the number of lights settles
MAX_LIGHTS = 512
PLOT_FLOOR = 1e-6  # drawn in place of 0, which has no logarithm
UNSEEN_PROBES = slice(REQUIRED_PROBES, 600)  # probes that the controller does not use
Row = dict[str, Any]


class Moment(NamedTuple):
    """One frame. radiance: (rows, cols, 3), the truth; given: what the methods get; bright_cells: of `given`."""

    time_s: float
    radiance: np.ndarray
    given: np.ndarray
    bright_cells: BrightCells


def chart(maps: list[Path], out: Path) -> None:
    """Writes charts as .png and .svg and their numbers as .csv to the folder `out`.

    error: of still maps, over milliseconds, 4 to 1024 lights. flicker and motion: of a sequence's first frames, or of a map rotated by
    one column a frame. events: frame by frame, when a lamp goes out and on, frames are black, or cells are invalid. required_lights:
    the lights chosen for an error limit, and the error measured.

    Each map is a lat-long .hdr or .exr, or a sequence, of which all but flicker and motion take the first frame. Raises UserError for
    maps that cannot be read, for a folder that cannot be made, and where matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise UserError("charts need matplotlib, which is not installed; pip install 'vemlight[bench]'") from error
    matplotlib.use("Agg")
    from rich.progress import track

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: cannot be made ({error.strerror}); choose another --out") from error
    sources = {path: open_source(settings.Capture(source=str(path.resolve()))) for path in maps}
    firsts = {path: _moment(source.frame(0)) for path, source in sources.items()}
    same = len({path.stem for path in maps}) < len(maps)
    rows: dict[str, list[Row]] = {"error": [], "moving": [], "events": [], "required_lights": []}
    for path, source in track(sources.items(), description="maps"):
        name, first = str(path) if same else path.stem, firsts[path]
        moving = [_moment(source.frame(k)) for k in range(min(len(source), FRAMES))] if len(source) > 1 else _rotating_moments(first)
        for method in (*METHODS, UNFILTERED):
            if method in METHODS:
                rows["error"] += [_still(method, count, first) | {"map": name} for count in COUNTS]
                rows["required_lights"] += [_required(method, limit, first) | {"map": name} for limit in ERROR_LIMITS]
            rows["moving"].append(_moving(method, moving) | {"map": name})
            for event in EVENTS:
                rows["events"] += [row | {"map": name} for row in _event(method, event, first)]
    command = f"vemlight chart {' '.join(path.name for path in maps)}   {machine()}"
    judged = f"{command}, one thread   error: RMS at {score.SCORE_PROBES} shadowed probes over their mean"
    _save(out, "error", rows["error"], _over("ms", "error"), f"a still map, {COUNTS[0]} to {COUNTS[-1]} lights", judged)
    title = f"{MOVING_COUNT} lights, {FRAMES} frames: a sequence's own, or the map turned a column a frame"
    _save(out, "flicker", rows["moving"], _over("error", "flicker"), title, judged)
    _save(out, "motion", rows["moving"], _bars("motion_deg", "jumps", "deaths"), title, judged)
    _save(out, "events", rows["events"], _frames, f"{MOVING_COUNT} lights, frame by frame; the event is gray", judged, len(EVENTS))
    limits = ", ".join(f"{limit:g} %" for limit in ERROR_LIMITS)
    unseen = f"{command}   error relative to what each probe receives, at probes that the controller has not seen"
    title = f"the lights chosen for an error of {limits}"
    _save(out, "required_lights", rows["required_lights"], _over("lights", "measured"), title, unseen)


def machine() -> str:
    """The processor and its number of cores, for captions."""
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text().splitlines() if listed.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return f"{model}, {os.cpu_count()} cores"


def _moment(frame: Frame) -> Moment:
    return Moment(frame.time_s, frame.radiance, frame.radiance, frame.bright_cells)


def _rotating_moments(first: Moment) -> list[Moment]:
    """The map rotated by one column a frame."""
    cols, moments = first.radiance.shape[1], []
    for k in range(FRAMES):
        turned = np.roll(first.radiance, k, axis=1)
        moments.append(Moment(k / FPS, turned, turned, _rotated(first.bright_cells, k, cols)))
    return moments


def _rotated(bright: BrightCells, columns: int, cols: int) -> BrightCells:
    """The bright cells of a map rotated by whole columns."""
    angle = columns * 2 * np.pi / cols
    row, col = np.divmod(bright.cells, cols)
    x, y, z = bright.directions.T
    turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=-1)
    cells = row * cols + (col + columns) % cols
    return _chosen(BrightCells(cells, turned.astype(np.float32), bright.weights), np.argsort(cells, kind="stable"))


def _chosen(bright: BrightCells, which: np.ndarray) -> BrightCells:
    return BrightCells(*(array[which] for array in bright))


def _event_moments(event: str, first: Moment) -> list[Moment]:
    """The frames of an event, on a still map."""
    rows, cols, _ = first.radiance.shape
    directions = cell_directions(rows, cols, "hemisphere")
    brightest = np.unravel_index(int(luminance_from_rgb(light_map(first.radiance, "hemisphere").radiance).argmax()), (rows, cols))
    around = (directions @ directions[brightest] > np.cos(np.radians(LAMP_DEG)))[..., None]
    changed = {
        "lamp off and on": np.where(around, np.nanmedian(first.radiance, axis=(0, 1)), first.radiance),
        "black frames": np.zeros_like(first.radiance),
        "invalid cells": np.where(around, np.float32(np.nan), first.radiance),
    }[event]
    moments = []
    for k in range(FRAMES):
        now = BEFORE <= k < BEFORE + EVENTS[event]
        truth = changed if now and event == "lamp off and on" else first.radiance
        # Bright cells of a lamp that is out would add light that is not there.
        bright = _chosen(first.bright_cells, ~around.ravel()[first.bright_cells.cells]) if now else first.bright_cells
        moments.append(Moment(k / FPS, truth, changed if now else first.radiance, bright))
    return moments


def _sampler(method: str, **values: Any) -> Sampler:
    name, _, unfiltered = method.partition(",")
    return settings.section_from_options(Sampler, {"method": name, **({"filter": "none"} if unfiltered else {}), **values})


def _lit(wanted: Sampler, moments: list[Moment]) -> Iterator[tuple[LightSet, float]]:
    """The lights of each frame, and the milliseconds they took."""
    state = initial_state()
    for moment in moments:
        begin = time.thread_time()
        state, lights, _ = step(wanted, state, SamplerInput(moment.given, "hemisphere", moment.time_s, moment.bright_cells))
        yield lights, 1e3 * (time.thread_time() - begin)


def _still(method: str, count: int, first: Moment) -> Row:
    moments = [first._replace(time_s=k / FPS) for k in range(STILL_FRAMES)]
    made, taken = zip(*_lit(_sampler(method, count=count, filter="none"), moments), strict=True)
    error = score.score([(first.radiance, made[-1])], "hemisphere").error
    return {"method": method, "lights": count, "ms": float(np.median(taken[1:])), "error": error}


def _moving(method: str, moments: list[Moment]) -> Row:
    made = [lights for lights, _ in _lit(_sampler(method, count=MOVING_COUNT), moments)]
    result = score.score(zip((moment.radiance for moment in moments), made, strict=True), "hemisphere")
    kept = ("error", "error_worst", "flicker", "motion_deg", "jumps", "deaths", "power_error")
    return {"method": method, "lights": MOVING_COUNT} | {key: getattr(result, key) for key in kept}


def _event(method: str, event: str, first: Moment) -> list[Row]:
    moments, at, truths = _event_moments(event, first), probes(score.SCORE_PROBES, "hemisphere"), {}
    for moment in moments:  # at most two different maps
        if id(moment.radiance) not in truths:
            truths[id(moment.radiance)] = irradiance_of_map(at, light_map(moment.radiance, "hemisphere").radiance, "hemisphere")
    scale = truths[id(first.radiance)].mean() or 1.0
    rows = []
    for k, (moment, (lights, _)) in enumerate(zip(moments, _lit(_sampler(method, count=MOVING_COUNT), moments), strict=True)):
        wrong = irradiance_of_lights(at, lights.directions, lights.irradiance) - truths[id(moment.radiance)]
        rows.append({"method": method, "event": event, "frame": k, "error": float(np.sqrt(np.mean(wrong**2)) / scale)})
    return rows


def _required(method: str, limit: float, first: Moment) -> Row:
    moments = [first._replace(time_s=k / FPS) for k in range(SETTLING_FRAMES)]
    *_, (lights, _) = _lit(_sampler(method, count=MAX_LIGHTS, filter="none", error_percent=limit), moments)
    at = probes(UNSEEN_PROBES.stop, "hemisphere")
    truth = irradiance_of_map(at, light_map(first.radiance, "hemisphere").radiance, "hemisphere")[UNSEEN_PROBES]
    got = irradiance_of_lights(at, lights.directions, lights.irradiance)[UNSEEN_PROBES]
    dark = DARK_PROBE * truth.mean() or 1.0
    measured = float(np.sqrt(np.mean(((got - truth) / (truth + dark)) ** 2)))
    return {"method": method, "limit": limit / 100, "lights": len(lights.ids), "measured": measured}


Draw = Callable[[Any, list[Row]], None]  # draws the rows of one map on its axes


def _by_method(rows: list[Row]) -> Iterator[tuple[str, str, list[Row]]]:
    """Each method's colour, name and rows."""
    for k, method in enumerate((*METHODS, UNFILTERED)):
        if own := [row for row in rows if row["method"] == method]:
            yield f"C{k}", method, own


def _over(across: str, up: str) -> Draw:
    """One line a method, one figure over another, and a band along the Pareto front."""

    def draw(axes: Any, rows: list[Row]) -> None:
        from matplotlib.ticker import LogLocator

        front: list[tuple[float, float]] = []
        for x, y in sorted((max(row[across], PLOT_FLOOR), max(row[up], PLOT_FLOOR)) for row in rows):
            if not front or y < front[-1][1]:
                front.append((x, y))
        axes[0].step(*zip(*front, strict=True), where="post", color="0.6", lw=5, alpha=0.4)
        for colour, method, own in _by_method(rows):
            axes[0].loglog(*([max(row[key], PLOT_FLOOR) for row in own] for key in (across, up)), "o-", label=method, color=colour)
        axes[0].set(xlabel=across, ylabel=up)
        axes[0].xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes[0].xaxis.set_major_formatter("{x:g}")
        axes[0].xaxis.minorticks_off()

    return draw


def _bars(*keys: str) -> Draw:
    """One group of bars a figure."""

    def draw(axes: Any, rows: list[Row]) -> None:
        for k, (colour, method, own) in enumerate(_by_method(rows)):
            axes[0].bar(np.arange(len(keys)) + 0.16 * (k - 2), [own[0][key] for key in keys], 0.16, color=colour, label=method)
        axes[0].set(xticks=range(len(keys)), xticklabels=keys, ylabel="a frame")
        axes[0].set_yscale("symlog", linthresh=0.1)

    return draw


def _frames(axes: Any, rows: list[Row]) -> None:
    """One line a method over the frames, one row of axes an event."""
    for axis, event in zip(axes, EVENTS, strict=True):
        axis.axvspan(BEFORE - 0.5, BEFORE + EVENTS[event] - 0.5, color="0.85")
        for colour, method, own in _by_method([row for row in rows if row["event"] == event]):
            axis.semilogy([row["frame"] for row in own], [max(row["error"], PLOT_FLOOR) for row in own], label=method, color=colour)
        axis.set(xlabel=f"frame: {event}", ylabel="error")


def _save(out: Path, name: str, rows: list[Row], draw: Draw, title: str, caption: str, down: int = 1) -> None:
    """Writes a chart with one column of `down` axes a map, and its numbers."""
    from matplotlib import pyplot as plt

    maps = list(dict.fromkeys(row["map"] for row in rows))
    size = (1 + 4.5 * len(maps), 1.5 + 3 * down)
    figure, axes = plt.subplots(down, len(maps), figsize=size, squeeze=False, sharey="row", layout="constrained")
    for column, of in zip(axes.T, maps, strict=True):
        draw(column, [row for row in rows if row["map"] == of])
        column[0].set_title(of)
        for axis in column:
            axis.grid(alpha=0.3, which="both")
    axes[0, 0].legend(fontsize=8)
    figure.suptitle(title, fontsize=9)
    figure.supxlabel(caption, fontsize=6, color="0.35")
    for suffix in (".png", ".svg"):
        with written_whole(out / f"{name}{suffix}") as part:
            figure.savefig(part, dpi=110)
    plt.close(figure)
    with written_whole(out / f"{name}.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, ["map", *(key for key in rows[0] if key != "map")])
        table.writeheader()
        table.writerows({key: f"{value:.5g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
