"""Error of still maps against time and against the number of lights, one curve a method."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import colour, leave_margin, legend, save, write_table
from bench.accuracy.maps import chosen, maps
from bench.evaluation import (
    CIRCLES,
    TURNS,
    ProbeIrradiance,
    Source,
    judged_hard,
    judged_softened,
    points_of,
    probe_irradiance,
    read_source,
    relative_rms,
    relative_rms_rgb,
)
from bench.methods import POINTS, SOFT, STILL, Method, settled
from vemlight.light.colour import luminance_from_rgb

BOUND = Path(__file__).parents[2] / "docs" / "charts" / "soft_bound.csv"
COUNTS = tuple(2**k for k in range(2, 11))
MAP_COUNTS = (8, 16, 64, 256)


def still(out: Path, progress: Progress) -> None:
    """Error against time and against the number of lights, for each kind of map."""
    rows, paths = [], chosen()
    task = progress.add_task("still maps", total=len(paths) * len(STILL) * len(COUNTS))
    for kind, path in paths.items():
        source = read_source(path)
        truth = probe_irradiance(points_of(source))
        for method in STILL:
            for count in COUNTS:
                if count <= method.most:
                    rows.append(_row(kind, method, count, source, truth))
                progress.advance(task)
    write_table(_all_maps(), out, "still_maps")
    _chart(rows, paths, out)


def _chart(rows: list[dict[str, Any]], paths: dict[str, Path], out: Path) -> None:
    for against, label in (("ms", "ms per frame"), ("lights", "lights")):
        figure, axes = plt.subplots(1, len(paths), figsize=(17, 5.4), sharey=True, squeeze=False, layout="constrained")
        leave_margin(figure, 0.16)
        for axis, kind in zip(axes[0], paths, strict=True):
            bound = _bound(paths[kind])
            if against == "lights" and bound:
                axis.loglog(*zip(*bound, strict=True), "--", color="black", lw=1.5, label="best soft lights found", zorder=4)
            for k, method in enumerate(STILL):
                own = [r for r in rows if r["map"] == kind and r["method"] == method.name]
                heavy = method.name in (POINTS, SOFT)
                axis.loglog(
                    [r[against] for r in own],
                    [r["error_hard"] for r in own],
                    "o-",
                    color=colour(k),
                    ms=3,
                    lw=2.4 if heavy else 1,
                    label=method.name,
                    zorder=3 if heavy else 2,
                )
            if against == "ms":
                front = _front([(r["ms"], r["error_hard"]) for r in rows if r["map"] == kind])
                axis.step(*zip(*front, strict=True), where="post", color="0.6", lw=5, alpha=0.4, zorder=1, label="Pareto front")
            axis.set(title=kind, xlabel=label)
            axis.grid(alpha=0.3, which="both")
        axes[0, 0].set_ylabel("relative RMS error of irradiance, hard edges")
        legend(figure, axes[0, 0])
        save(figure, rows, out, f"still_{against}", f"{CIRCLES} probes, each with {TURNS} occluders, N = 4 ... 1024.")


def _all_maps() -> list[dict[str, Any]]:
    """The error of tracked lights, points and soft, on every map there is."""
    rows = []
    for path in maps():
        source = read_source(path)
        truth = probe_irradiance(points_of(source))
        both = [method for method in STILL if method.name in (POINTS, SOFT)]
        rows += [_row(path.stem, method, count, source, truth) for method in both for count in MAP_COUNTS]
    return rows


def _row(kind: str, method: Method, count: int, source: Source, truth: ProbeIrradiance) -> dict[str, Any]:
    lights, ms = settled(method, count, source)
    hard, softened = judged_hard(lights), luminance_from_rgb(truth.soft)
    error_soft = np.sqrt(np.mean((judged_softened(lights) - softened) ** 2)) / softened.mean()
    return {
        "map": kind, "method": method.name, "asked": count, "lights": len(lights.ids), "ms": ms,
        "error_hard": relative_rms(hard - truth.hard, truth.hard), "error_soft": float(error_soft),
        "error_rgb": relative_rms_rgb(hard - truth.hard, truth.hard),
    }  # fmt: skip


def _bound(path: Path) -> list[tuple[float, float]]:
    """(lights, error) of the best soft lights that `bench.soft_bound` found for a map; none where it has not been run."""
    if not BOUND.exists():
        return []
    with open(BOUND, newline="") as file:
        return [(float(row["lights"]), float(row["bound"])) for row in csv.DictReader(file) if row["map"] == path.stem]


def _front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that no other beats in both, in order."""
    front: list[tuple[float, float]] = []
    for x, y in sorted(points):
        if not front or y < front[-1][1]:
            front.append((x, y))
    return front
