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
from services.sampler.score import score
from services.sampler.step import initial_state, step
from services.settings import Sampler

METHODS = ("tracked", "havran-azimuth", "havran-radius", "standard")
COUNTS = (4, 8, 16, 32, 64, 128, 256, 512)
MOVING_COUNT = 64
FRAMES = 24  # of the turning map
STILL_FRAMES = 6  # of the still one: enough for lights to settle and for a median of times
FPS = 25.0


def chart(maps: list[Path], out: Path) -> None:
    """Writes error.png, .svg and .csv (a still map, 4 to 512 lights) and flicker.* (the map turned a column a frame) to the
    folder `out`.

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
    still: list[dict[str, Any]] = []
    moving: list[dict[str, Any]] = []
    for path, frame in track(sources.items(), description="maps"):
        strong = np.column_stack(frame.strong)
        for method in METHODS:
            still += [_still(path.stem, method, count, frame.radiance, strong) for count in COUNTS]
            moving.append(_moving(path.stem, method, frame.radiance, strong))
    _save(out, "error", still, "ms", "error", f"a still map, {COUNTS[0]} to {COUNTS[-1]} lights")
    _save(out, "flicker", moving, "error", "flicker", f"the map turned a column a frame, {MOVING_COUNT} lights, {FRAMES} frames")


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
        state, lights, _ = step(wanted, state, radiance, "hemisphere", k / FPS, None, strong)
        taken.append(1e3 * (time.thread_time() - begin))
        made = [(radiance, lights)]
    result = score(made, "hemisphere")
    return {"map": name, "method": method, "lights": count, "ms": float(np.median(taken[1:])), "error": result.error}


def _moving(name: str, method: str, radiance: np.ndarray, strong: np.ndarray) -> dict[str, Any]:
    wanted = settings.record(Sampler, {"method": method, "count": MOVING_COUNT}, "--")
    state, made = initial_state(wanted), []
    cols = radiance.shape[1]
    for k in range(FRAMES):
        seen = np.roll(radiance, k, axis=1)
        state, lights, _ = step(wanted, state, seen, "hemisphere", k / FPS, None, _turned(strong, k, cols))
        made.append((seen, lights))
    result = score(made, "hemisphere")
    kept = {key: getattr(result, key) for key in ("error", "error_worst", "flicker", "motion_deg", "jumps", "deaths", "power_error")}
    return {"map": name, "method": method, "lights": MOVING_COUNT, **kept}


def _turned(strong: np.ndarray, columns: int, cols: int) -> np.ndarray:
    """The parts (k, 5) of strong cells of a map turned by whole columns."""
    angle = columns * 2 * np.pi / cols
    row, col = np.divmod(strong[:, 0].astype(np.int64), cols)
    x, y = strong[:, 1], strong[:, 2]
    turned = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    parts = np.column_stack([row * cols + (col + columns) % cols, *turned, strong[:, 3:]])
    return parts[np.argsort(parts[:, 0], kind="stable")]


def _save(out: Path, name: str, rows: list[dict[str, Any]], across: str, up: str, title: str) -> None:
    from matplotlib import pyplot as plt

    maps = list(dict.fromkeys(row["map"] for row in rows))
    figure, axes = plt.subplots(1, len(maps), figsize=(1 + 4.5 * len(maps), 4.5), squeeze=False, sharey=True, layout="constrained")
    for axis, of in zip(axes[0], maps, strict=True):
        for k, method in enumerate(METHODS):
            own = [row for row in rows if row["map"] == of and row["method"] == method]
            axis.loglog([row[across] for row in own], [row[up] for row in own], "o-", label=method, color=f"C{k}")
        axis.set(title=of, xlabel=across)
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].set_ylabel(up)
    axes[0, 0].legend()
    figure.suptitle(title, fontsize=9)
    for suffix in (".png", ".svg"):
        with written_whole(out / f"{name}{suffix}") as part:
            figure.savefig(part, dpi=110)
    plt.close(figure)
    with written_whole(out / f"{name}.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows({key: f"{value:.5g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
