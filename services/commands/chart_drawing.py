"""Draws the charts of `vemlight chart` and writes their tables."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.ticker import LogLocator

from vemlight.commands import chart as measure
from vemlight.commands.chart import METHODS, UNFILTERED, Row, Tables, machine
from vemlight.files import written_whole
from vemlight.sampler.score import SCORE_PROBES

PLOT_FLOOR = 1e-6  # drawn in place of 0, which has no logarithm

Draw = Callable[[Any, list[Row]], None]  # on the axes of a map, its rows


class Chart(NamedTuple):
    """name: of the files. down: axes for each map, one below the other."""

    name: str
    rows: list[Row]
    draw: Draw
    title: str
    caption: str
    down: int = 1


def draw_charts(tables: Tables, command: str, out: Path) -> list[Path]:
    """Writes each chart as .png, .svg and .csv to the folder `out` and returns the files; `command` made the charts."""
    written: list[Path] = []
    command = f"{command}   {machine()}"
    judged = f"{command}, one thread   error: RMS at {SCORE_PROBES} shadowed probes over their mean"
    counts, count, frames = measure.COUNTS, measure.MOVING_COUNT, measure.FRAMES
    limits = ", ".join(f"{limit:g} %" for limit in measure.ERROR_LIMITS)
    unseen = f"{command}   error relative to what each probe receives, at probes that did not choose the number"
    still = f"a still map, {counts[0]} to {counts[-1]} lights"
    moving = f"{count} lights, {frames} frames: a sequence's own, or the map turned by a column a frame"
    events = f"{count} lights, frame by frame; the event is gray"
    for chart in (
        Chart("error", tables["error"], _over("ms", "error"), still, judged),
        Chart("flicker", tables["moving"], _over("error", "flicker"), moving, judged),
        Chart("motion", tables["moving"], _bars("motion_deg", "jumps", "deaths"), moving, judged),
        Chart("events", tables["events"], _event_frames, events, judged, down=len(measure.EVENT_FRAMES)),
        Chart("required_lights", tables["required_lights"], _over("lights", "measured"), f"lights for an error of {limits}", unseen),
    ):
        written += _save(chart, out)
    return written


def _by_method(rows: list[Row]) -> Iterator[tuple[str, str, list[Row]]]:
    """Each method's colour, name and rows."""
    for k, method in enumerate((*METHODS, UNFILTERED)):
        if own := [row for row in rows if row["method"] == method]:
            yield f"C{k}", method, own


def _over(across: str, up: str) -> Draw:
    """One column over another, a line a method, and the Pareto front as a band."""

    def draw(axes: Any, rows: list[Row]) -> None:
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
    """A group of bars a column."""

    def draw(axes: Any, rows: list[Row]) -> None:
        for k, (colour, method, own) in enumerate(_by_method(rows)):
            axes[0].bar(np.arange(len(keys)) + 0.16 * (k - 2), [own[0][key] for key in keys], 0.16, color=colour, label=method)
        axes[0].set(xticks=range(len(keys)), xticklabels=keys, ylabel="a frame")
        axes[0].set_yscale("symlog", linthresh=0.1)

    return draw


def _event_frames(axes: Any, rows: list[Row]) -> None:
    """A line a method over the frames, one event below the other."""
    for axis, (event, frames) in zip(axes, measure.EVENT_FRAMES.items(), strict=True):
        axis.axvspan(measure.FRAMES_BEFORE - 0.5, measure.FRAMES_BEFORE + frames - 0.5, color="0.85")
        for colour, method, own in _by_method([row for row in rows if row["event"] == event]):
            axis.semilogy([row["frame"] for row in own], [max(row["error"], PLOT_FLOOR) for row in own], label=method, color=colour)
        axis.set(xlabel=f"frame: {event}", ylabel="error")


def _save(chart: Chart, out: Path) -> list[Path]:
    """Writes a chart with a column of axes for each map; returns its files."""
    rows, down = chart.rows, chart.down
    maps = list(dict.fromkeys(row["map"] for row in rows))
    size = (1 + 4.5 * len(maps), 1.5 + 3 * down)
    figure, axes = plt.subplots(down, len(maps), figsize=size, squeeze=False, sharey="row", layout="constrained")
    for column, of in zip(axes.T, maps, strict=True):
        chart.draw(column, [row for row in rows if row["map"] == of])
        column[0].set_title(of)
        for axis in column:
            axis.grid(alpha=0.3, which="both")
    axes[0, 0].legend(fontsize=8)
    figure.suptitle(chart.title, fontsize=9)
    figure.supxlabel(chart.caption, fontsize=6, color="0.35")
    files = [out / f"{chart.name}{suffix}" for suffix in (".png", ".svg", ".csv")]
    for path in files[:-1]:
        with written_whole(path) as part:
            figure.savefig(part, dpi=110)
    plt.close(figure)
    with written_whole(files[-1]) as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, ["map", *(key for key in rows[0] if key != "map")])
        table.writeheader()
        table.writerows({key: f"{value:.5g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
    return files
