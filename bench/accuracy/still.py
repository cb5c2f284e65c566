"""Error of still maps against time and against the number of lights, one curve a method."""

from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import colour, leave_margin, legend, save, write_table
from bench.accuracy.maps import chosen, maps
from bench.evaluation import (
    CIRCLES,
    TURNS,
    ProbeIrradiance,
    Source,
    points_of,
    points_of_lights,
    probe_irradiance,
    read_source,
    relative_rms,
    relative_rms_rgb,
)
from bench.methods import STILL, TRACKED, Method, settled

COUNTS = tuple(2**k for k in range(2, 11))


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
    for against, label in (("ms", "ms per frame"), ("lights", "lights")):
        figure, axes = plt.subplots(1, len(paths), figsize=(17, 5.4), sharey=True, squeeze=False, layout="constrained")
        leave_margin(figure, 0.16)
        for axis, kind in zip(axes[0], paths, strict=True):
            for k, method in enumerate(STILL):
                own = [r for r in rows if r["map"] == kind and r["method"] == method.name]
                heavy = method.name == TRACKED
                axis.loglog([r[against] for r in own], [r["error_hard"] for r in own], "o-", color=colour(k), ms=3,
                            lw=2.4 if heavy else 1, label=method.name, zorder=3 if heavy else 2)
            if against == "ms":
                front = _front([(r["ms"], r["error_hard"]) for r in rows if r["map"] == kind])
                axis.step(*zip(*front, strict=True), where="post", color="0.6", lw=5, alpha=0.4, zorder=1, label="Pareto front")
            axis.set(title=kind, xlabel=label)
            axis.grid(alpha=0.3, which="both")
        axes[0, 0].set_ylabel("relative RMS error of irradiance, hard edges")
        legend(figure, axes[0, 0])
        save(figure, rows, out, f"still_{against}", f"{CIRCLES} probes, each with {TURNS} occluders, N = 4 ... 1024.")


def _all_maps() -> list[dict[str, Any]]:
    """The default method's error on every map there is."""
    rows = []
    for path in maps():
        source = read_source(path)
        truth = probe_irradiance(points_of(source))
        rows += [_row(path.stem, STILL[0], count, source, truth) for count in (16, 64, 256)]
    return rows


def _row(kind: str, method: Method, count: int, source: Source, truth: ProbeIrradiance) -> dict[str, Any]:
    lights, ms = settled(method, count, source)
    got = probe_irradiance(points_of_lights(lights))
    return {
        "map": kind, "method": method.name, "asked": count, "lights": len(lights.ids), "ms": ms,
        "error_hard": relative_rms(got.hard - truth.hard, truth.hard), "error_soft": relative_rms(got.soft - truth.soft, truth.soft),
        "error_rgb": relative_rms_rgb(got.hard - truth.hard, truth.hard),
    }  # fmt: skip


def _front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that no other beats in both, in order."""
    front: list[tuple[float, float]] = []
    for x, y in sorted(points):
        if not front or y < front[-1][1]:
            front.append((x, y))
    return front
