"""Charts of accuracy, speed and steadiness: VEMLIGHT_DATA=FOLDER python -m bench.accuracy [--out docs/charts] [CHART ...]

Charts: still, moving, need, figure6, pictures. Writes accuracy_NAME.png, .svg and .csv. FOLDER holds hdri/*.hdr and *.exr, lat-long.
"""

import argparse
import csv
import itertools
import os
import platform
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from rich.progress import Progress

from bench.judge import Judged, judge, points_of, points_of_lights, read_source, relative_rms, relative_rms_rgb
from bench.methods import MOVING, STILL, TRACKED, Method
from bench.sequences import FRAMES, SEQUENCES, world_from_latlong
from services.files import written_whole
from services.images import read_radiance
from services.lights import Lights
from services.sphere import LUMINANCE, angle_between, map_irradiance

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

COMMAND = "python -m bench.accuracy"
COUNTS = tuple(2**k for k in range(2, 11))
COUNT = 64  # of lights, over the sequences
KINDS = {
    "kloppenheim_05": "a sun",
    "potsdamer_platz": "an overcast sky",
    "aerodynamics_workshop": "an interior",
    "studio_small_03": "lamps",
}
PROBES = 400  # over the sequences: the error's own uncertainty is 1 / sqrt(2 x 400) = 4 %
JUMP_DEG = 10.0
REFERENCE = 512  # lights of the picture that others are compared with
SETTLED = 8  # frames of a still map before it is judged and timed
COLOURS = plt.get_cmap("tab20").colors  # type: ignore[attr-defined]


def maps() -> list[Path]:
    """The lat-long maps of VEMLIGHT_DATA."""
    folder = os.environ.get("VEMLIGHT_DATA")
    if not folder:
        raise SystemExit("set VEMLIGHT_DATA to the folder that holds hdri/")
    return sorted(p for p in (Path(folder) / "hdri").iterdir() if p.suffix in (".hdr", ".exr"))


def chosen() -> dict[str, Path]:
    """The map of each kind."""
    return {kind: next(p for p in maps() if p.stem.startswith(name)) for name, kind in KINDS.items()}


def machine() -> str:
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text().splitlines() if listed.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return f"{model}, {os.cpu_count()} cores, one thread"


def save(figure: Figure, rows: Iterable[dict[str, Any]], out: Path, name: str, note: str) -> None:
    """The chart as PNG and SVG with its caption, the rows as CSV."""
    figure.text(0.01, 0.004, f"{note}   {COMMAND} {name.split('_')[0]}   {machine()}", fontsize=7, color="0.35")
    out.mkdir(parents=True, exist_ok=True)
    for suffix in (".png", ".svg"):
        with written_whole(out / f"accuracy_{name}{suffix}") as part:
            figure.savefig(part, dpi=85)
    plt.close(figure)
    rows = list(rows)
    with written_whole(out / f"accuracy_{name}.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)


# --- one map, many numbers of lights ---------------------------------------------------------------------------------------------------


def still(out: Path, progress: Progress) -> None:
    """Error against time and against the number of lights, for each kind of map."""
    rows, paths = [], chosen()
    task = progress.add_task("still maps", total=len(paths) * len(STILL) * len(COUNTS))
    for kind, path in paths.items():
        source = read_source(path)
        truth = judge(points_of(source))
        for method in STILL:
            for count in COUNTS:
                if count <= method.most:
                    rows.append(_still_row(kind, method, count, source.polar, source.centroids, truth))
                progress.advance(task)
    for against, label in (("ms", "ms per frame"), ("lights", "lights")):
        figure, axes = plt.subplots(1, 4, figsize=(17, 5.4), sharey=True, layout="constrained")
        figure.get_layout_engine().set(rect=(0, 0.09, 1, 0.91))  # type: ignore[union-attr]
        for axis, kind in zip(axes, paths, strict=True):
            for k, method in enumerate(STILL):
                own = [r for r in rows if r["map"] == kind and r["method"] == method.name]
                heavy = method.name == TRACKED
                axis.loglog([r[against] for r in own], [r["error_hard"] for r in own], "o-", color=COLOURS[2 * k % 20 + k // 10], ms=3,
                            lw=2.4 if heavy else 1, label=method.name, zorder=3 if heavy else 2)
            if against == "ms":
                front = _front([(r["ms"], r["error_hard"]) for r in rows if r["map"] == kind])
                axis.step(*zip(*front, strict=True), where="post", color="0.6", lw=5, alpha=0.4, zorder=1, label="Pareto front")
            axis.set(title=kind, xlabel=label)
            axis.grid(alpha=0.3, which="both")
        axes[0].set_ylabel("relative RMS error of irradiance, hard edges")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8, bbox_to_anchor=(0.5, 0.02))
        save(figure, rows, out, f"still_{against}", "1500 probes, N = 4 ... 1024.")


def _still_row(kind: str, method: Method, count: int, polar: np.ndarray, centroids: np.ndarray, truth: Judged) -> dict[str, Any]:
    state, taken, lights = method.start(count), [], None
    for k in range(SETTLED if method.steady else 2):
        begin = time.thread_time()
        state, lights = method.step(state, polar, k / 25, centroids)
        taken.append(time.thread_time() - begin)
    assert lights is not None
    got = judge(points_of_lights(lights))
    return {
        "map": kind, "method": method.name, "asked": count, "lights": len(lights.ids), "ms": 1e3 * float(np.median(taken[1:])),
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


# --- sequences -------------------------------------------------------------------------------------------------------------------------


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
    """One row a method, and its error and flicker in each frame (frames, 2); of sequences that settle first, the last FRAMES."""
    truths: list[Judged] = []
    for k, frame in enumerate(frames):
        steady = k > 0 and frame.source.strong is frames[k - 1].source.strong
        truths.append(truths[-1] if steady else judge(points_of(frame.source), PROBES))
    mean = np.mean([truth.hard @ LUMINANCE for truth in truths])
    made = []
    for method in MOVING:
        state, hard, soft, lights, ms, power = method.start(COUNT), [], [], [], [], []
        for frame, truth in zip(frames, truths, strict=True):
            begin = time.thread_time()
            state, now = method.step(state, frame.seen, frame.time_s, frame.source.centroids)
            ms.append(1e3 * (time.thread_time() - begin))
            got = judge(points_of_lights(now), PROBES)
            hard.append((got.hard - truth.hard) @ LUMINANCE / mean)
            soft.append((got.soft - truth.soft) @ LUMINANCE / mean)
            lights.append(now)
            total = map_irradiance(frame.source.polar, "hemisphere")
            power.append(float(np.abs(now.irradiance.sum(axis=0, dtype=float) / total - 1).max()))
        error = np.sqrt(np.mean(np.square(hard), axis=1))[-FRAMES:]
        flicker = np.sqrt(np.mean(np.square(np.diff(soft, axis=0, prepend=soft[:1])), axis=1))[-FRAMES:]
        row = {
            "method": method.name, "error": float(error.mean()), "error_worst": float(error.max()),
            "flicker": float(np.sqrt(np.mean(flicker[1:] ** 2))), "flicker_worst": float(flicker[1:].max()),
            **_motion(lights[-FRAMES:]), "power_worst": max(power[-FRAMES:]), "ms": float(np.median(ms)),
        }  # fmt: skip
        made.append((row, np.stack([error, flicker], axis=-1)))
    return made


def _motion(lights: list[Lights]) -> dict[str, float]:
    """Per frame: mean way of a light by its id in degrees, lights that jump, ids that end."""
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


def _grid(count: int, height: float) -> tuple[Figure, np.ndarray]:
    figure, axes = plt.subplots(-(-count // 3), 3, figsize=(16, height * -(-count // 3)), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.09, 1, 0.91))  # type: ignore[union-attr]
    return figure, axes.ravel()


def _legend(figure: Figure, axis: Any) -> None:
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8, bbox_to_anchor=(0.5, 0.015))


def _chart_flicker(rows: list[dict[str, Any]], out: Path) -> None:
    figure, axes = _grid(len(SEQUENCES), 3.9)
    for axis, name in zip(axes, SEQUENCES, strict=False):
        for k, method in enumerate(MOVING):
            axis.loglog(_means(rows, name, method.name, "error"), _means(rows, name, method.name, "flicker"), "*" if k < 1 else "o",
                        ms=15 if k < 1 else 7, color=COLOURS[2 * k % 20 + k // 10], label=method.name)
        axis.set(title=name, xlabel="error, hard edges", ylabel="flicker per frame, softened edges")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.set(xlim=(0.01, 1), ylim=(5e-4, 0.6))
        axis.grid(alpha=0.3, which="both")
    _legend(figure, axes[0])
    save(figure, rows, out, "moving_flicker", f"N = {COUNT}, mean over four maps, {FRAMES} frames; bottom left is best.")


def _chart_motion(rows: list[dict[str, Any]], out: Path) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(16, 5.4), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.13, 1, 0.87))  # type: ignore[union-attr]
    methods = [method for method in MOVING if method.steady]
    labels = {"motion_deg": "mean way of a light, degrees", "jumps": "lights over 10 degrees", "deaths": "ids that end"}
    for axis, (key, label) in zip(axes, labels.items(), strict=True):
        for k, method in enumerate(methods):
            axis.bar(np.arange(len(SEQUENCES)) + (k - 2.5) * 0.14, [_means(rows, name, method.name, key) for name in SEQUENCES], 0.14,
                     color=COLOURS[2 * MOVING.index(method) % 20], label=method.name)
        axis.set(ylabel=f"{label}, per frame", yscale="symlog")
        axis.set_yscale("symlog", linthresh=0.1)
        axis.set_xticks(np.arange(len(SEQUENCES)), list(SEQUENCES), rotation=40, ha="right", fontsize=8)
        axis.grid(alpha=0.3, axis="y")
    _legend(figure, axes[0])
    keep = ("map", "sequence", "method", "motion_deg", "jumps", "deaths")
    save(figure, [{k: r[k] for k in keep} for r in rows], out, "moving_motion", f"N = {COUNT}; methods with identity only.")


def _chart_events(curves: list[dict[str, Any]], out: Path) -> None:
    figure, axes = _grid(2 * len(SEQUENCES), 2.5)
    rows = []
    for place, name in enumerate(SEQUENCES):
        for k, method in enumerate(MOVING):
            own = np.mean([c["curve"] for c in curves if c["sequence"] == name and c["method"] == method.name], axis=0)
            for n, (error, flicker) in enumerate(own):
                rows.append({"sequence": name, "method": method.name, "frame": n, "error": float(error), "flicker": float(flicker)})
            for part, label in enumerate(("error", "flicker")):
                axis = axes[2 * place + part]
                shown = own[part:, part].clip(1e-4)  # the first frame has no flicker
                colour, width = COLOURS[2 * k % 20 + k // 10], 2.2 if k == 0 else 0.9
                axis.semilogy(np.arange(part, len(own)), shown, color=colour, lw=width, label=method.name)
                axis.set_title(f"{name}: {label}", fontsize=9)
                axis.grid(alpha=0.3)
    _legend(figure, axes[0])
    save(figure, rows, out, "moving_events", f"N = {COUNT}, mean over four maps, frame by frame.")


# --- what a scene needs ----------------------------------------------------------------------------------------------------------------

PROMISES = (40.0, 30.0, 20.0, 15.0, 10.0, 7.0)  # per cent
NEED_FRAMES = 20  # in which the number of lights settles
DARKEST = 0.05  # of the mean irradiance, as the controller has it


def need(out: Path, progress: Progress) -> None:
    """The number of lights that the controller chooses, and the error that they have on probes it has not seen."""
    from services.sampler.step import initial_state, step
    from services.settings import Sampler

    rows, paths = [], maps()
    task = progress.add_task("what scenes need", total=len(paths) * len(PROMISES) * 2)
    for path in paths:
        source = read_source(path)
        truth = judge(points_of(source)).soft[500:] @ LUMINANCE  # the controller looks at the first ones of the same sequence
        for method in ("tracked", "havran-azimuth"):
            for promise in PROMISES:
                settings = Sampler(method=method, filter="none", count=1024, error_percent=promise)
                state, lights = initial_state(settings), None
                for k in range(NEED_FRAMES):
                    state, lights, _ = step(settings, state, source.polar, "hemisphere", k / 25, None, source.centroids)
                assert lights is not None
                got = judge(points_of_lights(lights)).soft[500:] @ LUMINANCE
                error = float(np.sqrt(np.mean(((got - truth) / (truth + DARKEST * truth.mean())) ** 2)))
                rows.append({"map": path.stem, "method": method, "promised": promise / 100, "lights": len(lights.ids), "had": error})
                progress.advance(task)
    figure, axes = plt.subplots(1, 3, figsize=(17, 5.6), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.05, 1, 0.95))  # type: ignore[union-attr]
    for axis, method in zip(axes, ("tracked", "havran-azimuth"), strict=False):
        for k, path in enumerate(paths):
            own = [r for r in rows if r["map"] == path.stem and r["method"] == method]
            axis.loglog([r["promised"] for r in own], [r["had"] for r in own], "o-", ms=4, lw=0.8, color=COLOURS[k], label=path.stem)
            axes[2].loglog([r["promised"] for r in own], [r["lights"] for r in own], "o-" if method == "tracked" else "x:", ms=4, lw=0.8,
                           color=COLOURS[k])
        axis.plot([0.06, 0.5], [0.06, 0.5], color="0.5", lw=3, alpha=0.5)
        axis.set(title=method, xlabel="error promised", ylabel="error had, on other probes")
        axis.grid(alpha=0.3, which="both")
    axes[0].legend(fontsize=7)
    axes[2].set(title="lights chosen (dotted: havran-azimuth)", xlabel="error promised", ylabel="lights")
    axes[2].grid(alpha=0.3, which="both")
    save(figure, rows, out, "need", "Error relative to what each probe receives; below the gray line the promise is kept.")


# --- the paper's figure 6, its light half ----------------------------------------------------------------------------------------------


def figure6(out: Path, progress: Progress) -> None:
    """4 to 128 lights of each method on one sky, and the error they have."""
    counts, path = (4, 8, 16, 32, 64, 128), chosen()["an overcast sky"]
    names = ("structured", "Kollig and Keller", "Penrose tiling", "Havran, azimuth first", TRACKED)
    methods = [next(m for m in STILL if m.name == name) for name in names]
    source = read_source(path)
    truth, rows = judge(points_of(source)), []
    figure, axes = plt.subplots(len(methods), len(counts), figsize=(11, 9.6), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.03, 1, 0.97))  # type: ignore[union-attr]
    task = progress.add_task("figure 6", total=len(methods) * len(counts))
    picture = _disc(source.polar)
    for line, method in zip(axes, methods, strict=True):
        for axis, count in zip(line, counts, strict=True):
            state, lights = method.start(count), None
            for k in range(SETTLED if method.steady else 1):
                state, lights = method.step(state, source.polar, k / 25, source.centroids)
            assert lights is not None
            got = judge(points_of_lights(lights))
            error = relative_rms(got.hard - truth.hard, truth.hard)
            rows.append({"method": method.name, "lights": count, "error_hard": error})
            axis.imshow(picture, extent=(-1, 1, -1, 1), origin="lower")
            d = lights.directions
            radius = np.sqrt(np.maximum(1 - d[:, 2], 0) / np.maximum(1 - d[:, 2] ** 2, 1e-12))
            power = lights.irradiance @ LUMINANCE
            axis.scatter(d[:, 0] * radius, d[:, 1] * radius, s=6 + 900 * power / power.sum(), facecolors="none", edgecolors="lime", lw=0.9)
            axis.set_title(f"{count}: {100 * error:.1f} %", fontsize=8)
            axis.set(xticks=[], yticks=[])
            progress.advance(task)
        line[0].set_ylabel(method.name, fontsize=9)
    save(figure, rows, out, "figure6", f"{path.stem}: equal areas, circles as large as a light's share; error, hard edges.")


def pictures(out: Path, progress: Progress) -> None:
    """The product's own scene under 4 to 128 lights of each method, and its difference from the picture under REFERENCE lights."""
    from services.renderer.renderer import Renderer
    from services.renderer.scene import load_scene
    from services.settings import Renderer as Size

    counts, source = (4, 8, 16, 32, 64, 128), read_source(chosen()["a sun"])
    names = ("structured", "Kollig and Keller", "Penrose tiling", "Havran, azimuth first", TRACKED)
    methods = [next(m for m in STILL if m.name == name) for name in names]
    renderer, rows = Renderer(load_scene(None), Size(width=200, height=150, shadow_map=256), 4), []
    task = progress.add_task("pictures", total=len(methods) * len(counts) + 1)

    def rendered(method: Method, count: int) -> np.ndarray:
        state, lights = method.start(count), None
        for k in range(SETTLED if method.steady else 1):
            state, lights = method.step(state, source.polar, k / 25, source.centroids)
        assert lights is not None
        progress.advance(task)
        return np.array(renderer.render(lights))[..., :3]

    try:
        truth = rendered(methods[-1], REFERENCE)
        figure, axes = plt.subplots(len(methods), len(counts), figsize=(13, 8.6), layout="constrained")
        figure.get_layout_engine().set(rect=(0, 0.03, 1, 0.97))  # type: ignore[union-attr]
        for line, method in zip(axes, methods, strict=True):
            for axis, count in zip(line, counts, strict=True):
                picture = rendered(method, count)
                error = float(np.sqrt(np.mean(((picture - truth) @ LUMINANCE) ** 2)) / np.mean(truth @ LUMINANCE))
                rows.append({"method": method.name, "lights": count, "difference": error})
                axis.imshow((picture / (picture + truth.mean())).clip(0, 1) ** (1 / 2.2))
                axis.set_title(f"{count}: {100 * error:.1f} %", fontsize=8)
                axis.set(xticks=[], yticks=[])
            line[0].set_ylabel(method.name, fontsize=9)
    finally:
        renderer.release()
    save(figure, rows, out, "pictures", f"Under a sun; difference in luminance from the picture under {REFERENCE} tracked lights.")


def _disc(polar: np.ndarray) -> np.ndarray:
    """A polar map seen from below, equal areas, tone-mapped for the eye (150, 150, 3)."""
    rows, cols, _ = polar.shape
    x, y = np.meshgrid(np.linspace(-1, 1, 150), np.linspace(-1, 1, 150))
    theta = 2 * np.arcsin(np.minimum(np.sqrt((x**2 + y**2) / 2), np.sqrt(0.5)))
    phi = np.arctan2(y, x) % (2 * np.pi)
    row, col = (theta / (np.pi / 2) * rows).astype(int), (phi / (2 * np.pi) * cols).astype(int)
    seen = polar[np.minimum(row, rows - 1), np.minimum(col, cols - 1)]
    seen = seen / (seen + 2 * np.median(seen))
    return np.where((x**2 + y**2 <= 1)[..., None], seen.clip(0, 1) ** (1 / 2.2), 1.0)


CHARTS = {"still": still, "moving": moving, "need": need, "figure6": figure6, "pictures": pictures}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("charts", nargs="*", help=f"of {', '.join(CHARTS)}; none: all")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "charts")
    asked = parser.parse_args()
    with Progress() as progress:
        for name in asked.charts or CHARTS:
            CHARTS[name](asked.out, progress)


if __name__ == "__main__":
    main()
