"""`vemlight chart`: how true, how steady and how quick each method is on a user's own maps, as charts and as numbers."""

import csv
import os
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

from services import settings
from services.capture.source import open_source
from services.files import BadInput, written_whole
from services.lights import Lights
from services.sampler import score
from services.sampler.control import DARKEST, PROBES
from services.sampler.density import light_map
from services.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from services.sampler.step import initial_state, step
from services.settings import Sampler

METHODS = ("tracked", "havran-azimuth", "havran-radius", "standard")
COUNTS = (4, 8, 16, 32, 64, 128, 256, 512)
MOVING_COUNT = 64
FRAMES = 24  # of the turning map
STILL_FRAMES = 6  # of the still one: enough for lights to settle and for a median of times
FPS = 25.0
PROMISES = (40.0, 20.0, 10.0)  # per cent of error asked for
NEED_FRAMES = 20  # in which the number of lights settles
MOST = 512
LEAST = 1e-6  # what is drawn where nothing is wrong: logarithms know no 0
UNSEEN = slice(PROBES, 600)  # probes that the controller does not look at


def chart(maps: list[Path], out: Path) -> None:
    """Writes error.png, .svg and .csv (a still map, 4 to 512 lights), flicker.* (the map turned a column a frame; its table has motion,
    jumps and deaths too) and need.* (the lights chosen for an error, and the error they have) to the folder `out`.

    Each map is a lat-long .hdr or .exr; of sequences the first frame is taken. Raises BadInput for maps that cannot be read, for
    a folder that cannot be made, and where matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise BadInput("charts need matplotlib, which is not installed; pip install 'vemlight[bench]'") from error
    matplotlib.use("Agg")
    from rich.progress import track

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be made ({error.strerror}); choose another --out") from error
    sources = {path: open_source(settings.Capture(source=str(path.resolve()))).frame(0) for path in maps}
    same = len({path.stem for path in maps}) < len(maps)
    still: list[dict[str, Any]] = []
    moving: list[dict[str, Any]] = []
    needs: list[dict[str, Any]] = []
    for path, frame in track(sources.items(), description="maps"):
        name, strong = str(path) if same else path.stem, np.column_stack(frame.strong)
        for method in METHODS:
            still += [_still(name, method, count, frame.radiance, strong) for count in COUNTS]
            moving.append(_moving(name, method, frame.radiance, strong))
            needs += [_need(name, method, promise, frame.radiance, strong) for promise in PROMISES]
    command = f"vemlight chart {' '.join(path.name for path in maps)}"
    caption = f"{command}   {machine()}, one thread   error: RMS at {score.PROBES} shadowed probes over their mean"
    _save(out, "error", still, "ms", "error", f"a still map, {COUNTS[0]} to {COUNTS[-1]} lights", caption)
    title = f"the map turned a column a frame, {MOVING_COUNT} lights, {FRAMES} frames"
    _save(out, "flicker", moving, "error", "flicker", title, caption)
    caption = f"{command}   {machine()}   error relative to what each probe receives, at probes that the controller has not seen"
    _save(out, "need", needs, "lights", "had", "the lights chosen for an error of " + ", ".join(f"{p:g} %" for p in PROMISES), caption)


def machine() -> str:
    """The processor and how many of it there are, for captions."""
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text().splitlines() if listed.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return f"{model}, {os.cpu_count()} cores"


def _still(name: str, method: str, count: int, radiance: np.ndarray, strong: np.ndarray) -> dict[str, Any]:
    wanted = settings.record(Sampler, {"method": method, "count": count, "filter": "none"}, "--")
    state, taken, made = initial_state(wanted), [], []
    for k in range(STILL_FRAMES):
        begin = time.thread_time()
        state, lights, _ = step(wanted, state, radiance, "hemisphere", k / FPS, 0, strong)
        taken.append(1e3 * (time.thread_time() - begin))
        made = [(radiance, lights)]
    result = score.score(made, "hemisphere")
    return {"map": name, "method": method, "lights": count, "ms": float(np.median(taken[1:])), "error": result.error}


def _moving(name: str, method: str, radiance: np.ndarray, strong: np.ndarray) -> dict[str, Any]:
    wanted = settings.record(Sampler, {"method": method, "count": MOVING_COUNT}, "--")
    state, made = initial_state(wanted), []
    cols = radiance.shape[1]
    for k in range(FRAMES):
        seen = np.roll(radiance, k, axis=1)
        state, lights, _ = step(wanted, state, seen, "hemisphere", k / FPS, 0, _turned(strong, k, cols))
        made.append((seen, lights))
    result = score.score(made, "hemisphere")
    kept = {key: getattr(result, key) for key in ("error", "error_worst", "flicker", "motion_deg", "jumps", "deaths", "power_error")}
    return {"map": name, "method": method, "lights": MOVING_COUNT, **kept}


def _need(name: str, method: str, promise: float, radiance: np.ndarray, strong: np.ndarray) -> dict[str, Any]:
    wanted = settings.record(Sampler, {"method": method, "count": MOST, "filter": "none", "error_percent": promise}, "--")
    state, lights = initial_state(wanted), Lights.none()
    for k in range(NEED_FRAMES):
        state, lights, _ = step(wanted, state, radiance, "hemisphere", k / FPS, 0, strong)
    at = probes(UNSEEN.stop, "hemisphere")
    truth = irradiance_of_map(at, light_map(radiance, "hemisphere").radiance, "hemisphere")[UNSEEN]
    got = irradiance_of_lights(at, lights.directions, lights.irradiance)[UNSEEN]
    dark = DARKEST * truth.mean() or 1.0
    had = float(np.sqrt(np.mean(((got - truth) / (truth + dark)) ** 2)))
    return {"map": name, "method": method, "promised": promise / 100, "lights": len(lights.ids), "had": had}


def _turned(strong: np.ndarray, columns: int, cols: int) -> np.ndarray:
    """The parts (k, 5) of strong cells of a map turned by whole columns."""
    angle = columns * 2 * np.pi / cols
    row, col = np.divmod(strong[:, 0].astype(np.int64), cols)
    x, y = strong[:, 1], strong[:, 2]
    turned = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    parts = np.column_stack([row * cols + (col + columns) % cols, *turned, strong[:, 3:]])
    return parts[np.argsort(parts[:, 0], kind="stable")]


def _save(out: Path, name: str, rows: list[dict[str, Any]], across: str, up: str, title: str, caption: str) -> None:
    from matplotlib import pyplot as plt

    maps = list(dict.fromkeys(row["map"] for row in rows))
    figure, axes = plt.subplots(1, len(maps), figsize=(1 + 4.5 * len(maps), 4.5), squeeze=False, sharey=True, layout="constrained")
    for axis, of in zip(axes[0], maps, strict=True):
        for k, method in enumerate(METHODS):
            own = [row for row in rows if row["map"] == of and row["method"] == method]
            axis.loglog(*([max(row[key], LEAST) for row in own] for key in (across, up)), "o-", label=method, color=f"C{k}")
        axis.set(title=of, xlabel=across)
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].set_ylabel(up)
    axes[0, 0].legend()
    figure.suptitle(title, fontsize=9)
    figure.supxlabel(caption, fontsize=6, color="0.35")
    for suffix in (".png", ".svg"):
        with written_whole(out / f"{name}{suffix}") as part:
            figure.savefig(part, dpi=110)
    plt.close(figure)
    with written_whole(out / f"{name}.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows({key: f"{value:.5g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
