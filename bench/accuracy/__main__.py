"""Charts of accuracy, stability and speed: VEMLIGHT_DATA=FOLDER python -m bench.accuracy [--out docs/charts] [CHART ...]

Writes accuracy_NAME.png, .svg and .csv; of frame_times the numbers alone. FOLDER holds hdri/*.hdr and *.exr, lat-long.
"""

import argparse
from pathlib import Path

from rich.progress import Progress

from bench.accuracy.figure6 import figure6, pictures
from bench.accuracy.frame_times import frame_times
from bench.accuracy.moving import moving
from bench.accuracy.requirement import requirement
from bench.accuracy.still import still
from bench.accuracy.tables import tables
from bench.accuracy.times import times

CHARTS = {
    "still": still,
    "moving": moving,
    "requirement": requirement,
    "figure6": figure6,
    "pictures": pictures,
    "times": times,
    "frame_times": frame_times,
    "tables": tables,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("charts", nargs="*", help=f"of {', '.join(CHARTS)}; none: all")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "docs" / "charts")
    asked = parser.parse_args()
    with Progress() as progress:
        for name in asked.charts or CHARTS:
            CHARTS[name](asked.out, progress)


if __name__ == "__main__":
    main()
