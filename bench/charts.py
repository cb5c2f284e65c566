"""All charts of docs/, one bench after the other: python -m bench.charts [NAME ...]

Set VEMLIGHT_DATA to a folder with lat-long maps in hdri/ for the charts that need real maps; without it they are left out, and said so.
"""

import os
import subprocess
import sys
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

# Module and arguments, and whether it needs real maps; the quick ones first.
BENCHES: dict[str, tuple[list[str], bool]] = {
    "capture": (["bench.capture"], False),
    "renderer": (["bench.renderer"], False),
    "sampler": (["bench.sampler"], False),
    "sampler_failures": (["bench.sampler_failures"], False),
    "sampler_need": (["bench.sampler_need"], True),
    "luminaires": (["bench.luminaires"], False),
    "figure6": (["bench.accuracy", "figure6"], True),
    "pictures": (["bench.accuracy", "pictures"], True),
    "times": (["bench.accuracy", "times"], True),
    "still": (["bench.accuracy", "still"], True),
    "need": (["bench.accuracy", "need"], True),
    "renderer_figure6": (["bench.renderer_accuracy", "figure6"], True),
    "renderer_time": (["bench.renderer_accuracy", "time"], True),
    "gloss": (["bench.gloss"], True),
    "moving": (["bench.accuracy", "moving"], True),
}


def main(names: list[str]) -> int:
    """Runs the benches named, or all; 1 when one of them fails."""
    console, failed = Console(), []
    if unknown := sorted(set(names) - BENCHES.keys()):
        console.print(f"{', '.join(unknown)}: there is no such chart; choose from {', '.join(BENCHES)}")
        return 2
    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console) as progress:
        task = progress.add_task("charts", total=len(names or BENCHES))
        for name in names or BENCHES:
            arguments, needs_maps = BENCHES[name]
            progress.update(task, description=name)
            if needs_maps and not os.environ.get("VEMLIGHT_DATA"):
                console.print(f"{name}: left out, VEMLIGHT_DATA names no folder of maps")
            else:
                begin = time.monotonic()
                done = subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True, check=False)
                console.print(f"{name}: {'done' if done.returncode == 0 else 'FAILED'} in {time.monotonic() - begin:.0f} s")
                if done.returncode:
                    failed.append(name)
                    console.print(done.stderr[-2000:], markup=False)
            progress.advance(task)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
