"""`vemlight chart`: error, flicker and time of each method on a user's own maps, as numbers and charts."""

import os
import platform
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.source import open_source
from vemlight.errors import UserError
from vemlight.light.bright_cells import BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_directions
from vemlight.runtime.progress import counted
from vemlight.sampler.hard_probes import HARD_PROBES, hard_probes, relative_squares
from vemlight.sampler.light_map import light_map
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import SCORE_PROBES, score
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.settings import Sampler
from vemlight.settings_file import section_from_options

# What is measured: any other values give other charts, each as true.
METHODS: tuple[str, ...] = get_args(get_type_hints(Sampler)["method"])
UNFILTERED = "havran-azimuth, no filter"  # for moving light: shows the effect of the 2005 filter
COUNTS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
MOVING_COUNT = 64
FRAMES = 24  # of light that moves
STILL_FRAMES = 6  # of a map that stands still: enough for lights to settle and for a median of times
FPS = 25.0
EVENT_FRAMES = {"lamp off and on": 8, "black frames": 2, "invalid cells": 4}  # how many frames each event lasts
FRAMES_BEFORE = 8  # an event: as many as the 2005 filter looks back
LAMP_DEG = 10.0  # around the brightest cell: what goes out, or becomes invalid
ERROR_LIMITS = (40.0, 20.0, 10.0)  # per cent
SETTLING_FRAMES = 20  # in which the number of lights settles
MAX_LIGHTS = 512
UNSEEN = (HARD_PROBES, 3 * HARD_PROBES)  # probes that the choice of the number does not look at
SINGLE_CELLS = 100_000  # lights, for which a map's tiles are its cells; any number above its cells does
ROWS, COLS = 90, 360  # of the polar maps

Row = dict[str, Any]
Tables = dict[str, list[Row]]


class Moment(NamedTuple):
    """One frame. truth: (rows, cols, 3), the radiance as it is. seen: what the methods get. bright_cells: of `seen`."""

    time_s: float
    truth: np.ndarray
    seen: np.ndarray
    bright_cells: BrightCells


def chart(maps: list[Path], out: Path) -> list[Path]:
    """Writes charts as .png and .svg and their numbers as .csv to the folder `out`; returns the files.

    error: of still maps, over milliseconds, 4 to 1024 lights. flicker and motion: of a sequence's first frames, or of a map turned by a
    column a frame. events: frame by frame, when a lamp goes out and on, frames are black, or cells are invalid. required_lights: the
    numbers of lights chosen for an error limit, and their errors.

    Each map is a lat-long .hdr or .exr, or a sequence, of which all but flicker and motion take the first frame. Raises UserError for
    maps that cannot be read, for a folder that cannot be made, and where matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise UserError("charts need matplotlib, which is not installed; pip install 'vemlight[bench]'") from error
    matplotlib.use("Agg")
    from vemlight.commands.chart_drawing import draw_charts

    tables = measured(maps)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: cannot be made ({error.strerror}); choose another --out") from error
    return draw_charts(tables, f"vemlight chart {' '.join(path.name for path in maps)}", out)


def measured(maps: list[Path]) -> Tables:
    """The tables of the charts: error, moving, events, required_lights. Raises UserError for maps that cannot be read."""
    sources = {path: open_source(settings.Capture(source=str(path.resolve()), rows=ROWS, cols=COLS)) for path in maps}
    firsts = {path: _moment(source.frame(0)) for path, source in sources.items()}
    ambiguous = len({path.stem for path in maps}) < len(maps)
    tables: Tables = {"error": [], "moving": [], "events": [], "required_lights": []}
    for path, source in counted(sources.items(), "maps", len(sources)):
        name, first = {"map": str(path) if ambiguous else path.stem}, firsts[path]
        moving = [_moment(source.frame(k)) for k in range(min(len(source), FRAMES))] if len(source) > 1 else _turning(first)
        for method in (*METHODS, UNFILTERED):
            if method in METHODS:
                tables["error"] += [_still(method, count, first) | name for count in COUNTS]
                tables["required_lights"] += [_within_limit(method, limit, first) | name for limit in ERROR_LIMITS]
            tables["moving"].append(_moving(method, moving) | name)
            for event in EVENT_FRAMES:
                tables["events"] += [row | name for row in _event(method, event, first)]
    return tables


def machine() -> str:
    """The processor and how many of it there are, for captions."""
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text().splitlines() if listed.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return f"{model}, {os.cpu_count()} cores"


def _moment(frame: Frame) -> Moment:
    return Moment(frame.time_s, frame.radiance, frame.radiance, frame.bright_cells)


def _turning(first: Moment) -> list[Moment]:
    """The map turned by a column a frame."""
    cols, moments = first.truth.shape[1], []
    for k in range(FRAMES):
        turned = np.roll(first.truth, k, axis=1)
        moments.append(Moment(k / FPS, turned, turned, _turned(first.bright_cells, k, cols)))
    return moments


def _turned(bright: BrightCells, columns: int, cols: int) -> BrightCells:
    """The bright cells of a map turned by whole columns."""
    angle = columns * 2 * np.pi / cols
    row, col = np.divmod(bright.cells, cols)
    x, y, z = bright.directions.T
    turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=-1)
    cells = row * cols + (col + columns) % cols
    return _chosen(BrightCells(cells, turned.astype(np.float32), bright.weights), np.argsort(cells, kind="stable"))


def _chosen(bright: BrightCells, which: np.ndarray) -> BrightCells:
    return BrightCells(*(array[which] for array in bright))


def _eventful(event: str, first: Moment) -> list[Moment]:
    """The frames of an event, on a map that stands still."""
    rows, cols, _ = first.truth.shape
    directions = cell_directions(rows, cols, "hemisphere")
    brightest = np.unravel_index(int(luminance_from_rgb(light_map(first.truth, "hemisphere").radiance).argmax()), (rows, cols))
    lamp = (directions @ directions[brightest] > np.cos(np.radians(LAMP_DEG)))[..., None]
    changed = {
        "lamp off and on": np.where(lamp, np.nanmedian(first.truth, axis=(0, 1)), first.truth),
        "black frames": np.zeros_like(first.truth),
        "invalid cells": np.where(lamp, np.float32(np.nan), first.truth),
    }[event]
    moments = []
    for k in range(FRAMES):
        during = FRAMES_BEFORE <= k < FRAMES_BEFORE + EVENT_FRAMES[event]
        truth = changed if during and event == "lamp off and on" else first.truth
        # Without the samples of what goes out, which would place light where none is.
        bright = _chosen(first.bright_cells, ~lamp.ravel()[first.bright_cells.cells]) if during else first.bright_cells
        moments.append(Moment(k / FPS, truth, changed if during else first.truth, bright))
    return moments


def _sampler(method: str, **values: Any) -> Sampler:
    name, _, unfiltered = method.partition(",")
    return section_from_options(Sampler, {"method": name, **({"filter": "none"} if unfiltered else {}), **values})


def _sampled(sampler: Sampler, moments: list[Moment]) -> Iterator[tuple[LightSet, float]]:
    """The lights of each frame, and the milliseconds they took."""
    state = initial_state()
    for moment in moments:
        begin = time.thread_time()
        state, lights, _ = step(sampler, state, SamplerInput(moment.seen, "hemisphere", moment.time_s, moment.bright_cells))
        yield lights, 1e3 * (time.thread_time() - begin)


def _still(method: str, count: int, first: Moment) -> Row:
    moments = [first._replace(time_s=k / FPS) for k in range(STILL_FRAMES)]
    lights, taken_ms = zip(*_sampled(_sampler(method, count=count, filter="none"), moments), strict=True)
    error = score([(first.truth, lights[-1])], "hemisphere").error
    return {"method": method, "lights": count, "ms": float(np.median(taken_ms[1:])), "error": error}


def _moving(method: str, moments: list[Moment]) -> Row:
    lights = [lights for lights, _ in _sampled(_sampler(method, count=MOVING_COUNT), moments)]
    result = score(zip((moment.truth for moment in moments), lights, strict=True), "hemisphere")
    keys = ("error", "error_worst", "flicker", "motion_deg", "jumps", "deaths", "power_error")
    return {"method": method, "lights": MOVING_COUNT} | {key: getattr(result, key) for key in keys}


def _event(method: str, event: str, first: Moment) -> list[Row]:
    moments, at, truths = _eventful(event, first), probes(SCORE_PROBES, "hemisphere"), {}
    for moment in moments:  # two maps at most
        if id(moment.truth) not in truths:
            truths[id(moment.truth)] = irradiance_of_map(at, light_map(moment.truth, "hemisphere").radiance, "hemisphere")
    scale = truths[id(first.truth)].mean() or 1.0
    rows = []
    for k, (moment, (lights, _)) in enumerate(zip(moments, _sampled(_sampler(method, count=MOVING_COUNT), moments), strict=True)):
        difference = irradiance_of_lights(at, lights.directions, lights.irradiance) - truths[id(moment.truth)]
        rows.append({"method": method, "event": event, "frame": k, "error": float(np.sqrt(np.mean(difference**2)) / scale)})
    return rows


def _within_limit(method: str, limit: float, first: Moment) -> Row:
    moments = [first._replace(time_s=k / FPS) for k in range(SETTLING_FRAMES)]
    *_, (lights, _) = _sampled(_sampler(method, count=MAX_LIGHTS, filter="none", error_percent=limit), moments)
    cells = tiles_from_map(light_map(first.truth, "hemisphere").radiance, "hemisphere", SINGLE_CELLS, first.bright_cells)
    error = float(np.sqrt(relative_squares(hard_probes("hemisphere", *UNSEEN), cells, lights).mean()))
    return {"method": method, "limit": limit / 100, "lights": len(lights.ids), "measured": error}
