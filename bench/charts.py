"""All charts of docs/, one bench after the other: python -m bench.charts [NAME ...]

Set VEMLIGHT_DATA to a folder with lat-long maps in hdri/ for the charts that need real maps; without it they are skipped with a line.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class Bench(NamedTuple):
    """arguments: module and its arguments. needs_maps: real ones. seconds: typical time on 2 cores, for the progress bar."""

    arguments: list[str]
    needs_maps: bool
    seconds: int


# The quick ones first; the tables are made from the others' results.
BENCHES = {
    "capture": Bench(["bench.capture"], False, 56),
    "renderer": Bench(["bench.renderer"], False, 98),
    "sampler": Bench(["bench.sampler"], False, 47),
    "sampler_failures": Bench(["bench.sampler_failures"], False, 59),
    "sampler_required_lights": Bench(["bench.sampler_required_lights"], True, 4),
    "flicker": Bench(["bench.flicker"], True, 200),
    "soft_lights": Bench(["bench.soft_lights"], True, 300),
    "soft_bound": Bench(["bench.soft_bound"], True, 500),
    "luminaires": Bench(["bench.luminaires"], False, 189),
    "figure6": Bench(["bench.accuracy", "figure6"], True, 10),
    "pictures": Bench(["bench.accuracy", "pictures"], True, 13),
    "times": Bench(["bench.accuracy", "times"], True, 6),
    "still": Bench(["bench.accuracy", "still"], True, 42),
    "requirement": Bench(["bench.accuracy", "requirement"], True, 60),
    "renderer_figure6": Bench(["bench.renderer_accuracy"], True, 900),
    "gloss": Bench(["bench.gloss"], True, 61),
    "moving": Bench(["bench.accuracy", "moving"], True, 860),
    "archive": Bench(["bench.archive"], True, 180),
    "frame_times": Bench(["bench.accuracy", "frame_times"], True, 60),
    "tables": Bench(["bench.accuracy", "tables"], False, 4),
}


def main(names: list[str]) -> int:
    """Runs the benches named, or all; 1 when one of them fails."""
    console, failed = Console(), []
    if unknown := sorted(set(names) - BENCHES.keys()):
        console.print(f"{', '.join(unknown)}: no such chart; choose from {', '.join(BENCHES)}")
        return 2
    wanted = {name: BENCHES[name] for name in names or BENCHES}
    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn(), console=console) as progress:
        task = progress.add_task("charts", total=sum(bench.seconds for bench in wanted.values()))
        for name, bench in wanted.items():
            progress.update(task, description=name)
            before = progress.tasks[task].completed
            if bench.needs_maps and not os.environ.get("VEMLIGHT_DATA"):
                console.print(f"{name}: skipped, VEMLIGHT_DATA names no folder of maps")
            else:
                begin = time.monotonic()

                def tick(before: float = before, begin: float = begin, most: int = bench.seconds) -> None:
                    progress.update(task, completed=before + min(time.monotonic() - begin, most))

                status, errors = _run(bench.arguments, tick)
                console.print(f"{name}: {'FAILED' if status else 'done'} in {time.monotonic() - begin:.0f} s")
                if status:
                    failed.append(name)
                    console.print(errors[-2000:], markup=False)
            progress.update(task, completed=before + bench.seconds)
    return 1 if failed else 0


def _run(arguments: list[str], tick: Callable[[], object]) -> tuple[int, str]:
    """The exit status of a bench and its stderr; `tick` is called every second meanwhile."""
    with tempfile.TemporaryFile("w+") as errors:
        quiet = {"OPENBLAS_NUM_THREADS": "1", **os.environ}  # matrices are small here, and its threads would only wait for each other
        process = subprocess.Popen([sys.executable, "-m", *arguments], stdout=subprocess.DEVNULL, stderr=errors, env=quiet)
        while True:
            try:
                status = process.wait(1)
            except subprocess.TimeoutExpired:
                tick()
            else:
                errors.seek(0)
                return status, errors.read()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
