"""What an archive costs, and how many workers help: `VEMLIGHT_DATA=FOLDER python -m bench.archive [--frames 250] [--long 2000]`.

Measures, on a real map that turns (EXR files of its own size, forth and back): processor time of a frame's map and of its lights, wall time
with 1 and with 2 workers in turn, and peak memory at --frames and --long. From the costs it models 1 to 1,000 workers; docs/archives.md
says with which assumptions. Writes archive_costs.csv, archive.csv and archive.png to docs/charts.
"""

import argparse
import csv
import math
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import pyplot as plt

from bench.accuracy.maps import one
from vemlight.files import decoded_json
from vemlight.light.images import read_radiance, write_exr

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "charts"
TURN_FRAMES, TURN_PIXELS = 48, 2  # different frames, and by how much each is turned
LIGHTS = {"as few as 5 % takes": (), "72 points": ("--count", "72", "--points")}
ROUNDS = 3  # of 1 and 2 workers in turn, so that a busy moment of the machine meets both
MAX_WORKERS = 1000
MAP_BYTES = 90 * 360 * 12
NETWORKS = {"1 Gbit/s": 1e9 / 8, "10 Gbit/s": 1e10 / 8}  # bytes/s to and from the storage that all share


class Costs(NamedTuple):
    """Of a frame. maps_s, lights_s: processor time. map_bytes: of a map on its way. file_bytes: of the frame's file."""

    maps_s: float
    lights_s: float
    map_bytes: float
    file_bytes: float


class Run(NamedTuple):
    """A command's wall and processor time, the largest peak of memory of its processes, and its report."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    report: dict[str, Any]


def one_recording(costs: Costs, workers: int) -> float:
    """Frames a second of one recording: maps by `workers`, lights by one process beside them, whichever is slower."""
    return 1 / max(costs.maps_s / workers, costs.lights_s)


def useful_workers(costs: Costs) -> int:
    """Beyond which more of them make one recording no faster."""
    return math.ceil(costs.maps_s / costs.lights_s)


def many_recordings(costs: Costs, workers: int) -> float:
    """Frames a second of as many recordings as have useful_workers each, the last one with those that are left."""
    full, rest = divmod(workers, useful_workers(costs))
    return full * one_recording(costs, useful_workers(costs)) + (one_recording(costs, rest) if rest else 0)


def carried(costs: Costs, bytes_a_second: float, on_one_host: bool) -> float:
    """Frames a second that shared storage carries: files out and, unless a recording's workers share a host, maps in and out again."""
    return bytes_a_second / (costs.file_bytes + (0 if on_one_host else 2 * costs.map_bytes))


def measured(*arguments: str) -> Run:
    """Runs the command line with --json in a process whose children are counted by themselves."""
    code = (
        "import json, resource, subprocess, sys, time; begin = time.monotonic();"
        "done = subprocess.run([sys.executable, '-m', 'vemlight', *sys.argv[1:], '--json'], stdout=subprocess.PIPE, check=True);"
        "r = resource.getrusage(resource.RUSAGE_CHILDREN);"
        "print(json.dumps([time.monotonic() - begin, r.ru_utime + r.ru_stime, r.ru_maxrss / 1e3, json.loads(done.stdout)]))"
    )
    said = subprocess.run([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, check=True).stdout
    return Run(*decoded_json(said, tuple[float, float, float, dict[str, Any]]))


def turning(folder: Path) -> list[Path]:
    """A real map, turned about the vertical from frame to frame."""
    image = read_radiance(one("an overcast sky"))[0]
    folder.mkdir()
    files = [folder / f"{k:04d}.exr" for k in range(TURN_FRAMES)]
    for k, path in enumerate(files):
        write_exr(path, np.roll(image, k * TURN_PIXELS, axis=1))
    return files


def recording(folder: Path, files: list[Path], frames: int) -> Path:
    """So many frames, by links to the files forth and back."""
    folder.mkdir()
    for k in range(frames):
        turn, place = divmod(k, len(files))
        os.symlink(files[place if turn % 2 == 0 else -1 - place], folder / f"frame_{k:06d}.exr")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=250)
    parser.add_argument("--long", type=int, default=2000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        files = turning(here / "files")
        file_bytes = statistics.mean(path.stat().st_size for path in files)
        short, long = recording(here / "short", files, given.frames), recording(here / "long", files, given.long)
        rows, costs = [], {}
        for name, options in LIGHTS.items():
            runs = timed(here, short, options)
            costs[name] = costs_of(runs, file_bytes)
            rows += [
                {"lights": name, "what": what, "value": f"{value:.4g}"} for what, value in figures(costs[name], runs, given.frames).items()
            ]
        for command, suffix, more in (("lights", ".jsonl", ()), ("archive", "", ("--workers", "1"))):
            for frames, source in ((given.frames, short), (given.long, long)):
                peak = measured(command, str(source), "--out", str(here / f"{command}{frames}{suffix}"), *more).peak_mb
                rows.append(
                    {"lights": "as few as 5 % takes", "what": f"peak memory, {command}, {frames} frames, MB", "value": f"{peak:.4g}"}
                )
    write(OUT / "archive_costs.csv", rows)
    model(costs)


def row_of(lights: str, what: str, value: float) -> dict[str, str]:
    return {"lights": lights, "what": what, "value": f"{value:.4g}"}


def timed(here: Path, source: Path, options: tuple[str, ...]) -> dict[int, list[Run]]:
    """Runs by 1 and by 2 workers."""
    runs: dict[int, list[Run]] = {1: [], 2: []}
    for _ in range(ROUNDS):
        for workers, own in runs.items():
            with tempfile.TemporaryDirectory(dir=here) as out:
                own.append(measured("archive", str(source), "--workers", str(workers), "--out", f"{out}/a", *options))
            print(f"{workers} workers: {own[-1]}", file=sys.stderr, flush=True)
    return runs


def costs_of(runs: dict[int, list[Run]], file_bytes: float) -> Costs:
    """The medians; of one worker alone, since two on a busy machine share its caches."""
    reports = [run.report for run in runs[1]]
    maps_ms, lights_ms = (statistics.median(report[key] for report in reports) for key in ("maps_ms", "lights_ms"))
    return Costs(maps_ms / 1e3, lights_ms / 1e3, MAP_BYTES, file_bytes)


def figures(costs: Costs, runs: dict[int, list[Run]], frames: int) -> dict[str, float]:
    """What the table has of one kind of lights."""
    walls = {workers: statistics.median(run.wall_s for run in own) for workers, own in runs.items()}
    return {
        "maps, ms of processor time a frame": 1e3 * costs.maps_s,
        "lights, ms of processor time a frame": 1e3 * costs.lights_s,
        "useful workers of one recording": useful_workers(costs),
        f"wall time of {frames} frames, 1 worker, s": walls[1],
        f"wall time of {frames} frames, 2 workers, s": walls[2],
        "1 worker over 2, wall time": walls[1] / walls[2],
        # 2 workers and the lights' process share two processors; 1 worker has one, the lights' process the other
        "1 worker over 2, by processor time, two idle processors": max(costs.maps_s, costs.lights_s)
        / max((costs.maps_s + costs.lights_s) / 2, costs.lights_s),
        "load average while measured": os.getloadavg()[1],
    }


def model(of_kind: dict[str, Costs]) -> None:
    """The curves from 1 to MAX_WORKERS, for each kind of lights."""
    workers = np.unique(np.geomspace(1, MAX_WORKERS, 120).astype(int)).tolist()
    figure, all_axes = plt.subplots(1, len(of_kind), figsize=(12, 5), sharey=True, layout="constrained")
    rows = []
    for axes, (kind, costs) in zip(all_axes, of_kind.items(), strict=True):
        curves = {
            "one recording": [one_recording(costs, w) for w in workers],
            "many recordings": [many_recordings(costs, w) for w in workers],
        }
        for name, rate in NETWORKS.items():
            curves[f"many, frames over {name}"] = np.minimum(curves["many recordings"], carried(costs, rate, on_one_host=True)).tolist()
        slow = carried(costs, NETWORKS["1 Gbit/s"], on_one_host=False)
        curves["one, frames and maps over 1 Gbit/s"] = np.minimum(curves["one recording"], slow).tolist()
        for (name, curve), style in zip(curves.items(), ("C0-", "C1-", "C1:", "C1--", "C0:"), strict=True):
            axes.loglog(workers, curve, style, label=name)
            rows += [
                {"lights": kind, "curve": name, "workers": w, "frames_a_second": f"{rate:.5g}"}
                for w, rate in zip(workers, curve, strict=True)
            ]
        end = useful_workers(costs)
        axes.axvline(end, color="gray", lw=0.8)
        axes.annotate(f"one recording ends\nto scale at {end}", (end * 1.1, 12), fontsize=9)
        axes.set(xlabel="workers", xlim=(1, MAX_WORKERS), ylim=(10, None))
        axes.grid(alpha=0.3, which="both", lw=0.4)
        axes.set_title(f"{kind}: {1e3 * costs.maps_s:.1f} ms a map, {1e3 * costs.lights_s:.1f} ms for its lights", fontsize=10)
    all_axes[0].set_ylabel("frames a second, modelled")
    all_axes[0].legend(fontsize=8, loc="upper left")
    write(OUT / "archive.csv", rows)
    figure.savefig(OUT / "archive.png", dpi=90)


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    with open(path, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    main()
