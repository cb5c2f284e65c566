"""Lights that scenes require: VEMLIGHT_DATA=FOLDER python -m bench.sampler_required_lights.

Writes docs/charts/sampler_required_lights.csv and .png. For each map of FOLDER/hdri and the CIE's overcast sky: the number of lights that
the sampler chooses for error limits of 5 to 40 %, and their error at 2048 other probes, against every cell of the map.
"""

import csv
import os
import sys
from pathlib import Path

import matplotlib
import numpy as np

from bench.evaluation import Source, read_source
from vemlight.files import written_whole
from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.sampler.hard_probes import HARD_PROBES, hard_probes, relative_squares
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.settings import Sampler

matplotlib.use("Agg")
from matplotlib import pyplot as plt

OUT = Path(__file__).parents[1] / "docs" / "charts"
LIMITS = (0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4)
MAX_COUNT = 1024
UNSEEN = (HARD_PROBES, 3 * HARD_PROBES)  # probes that the choice does not use
SINGLE_CELLS = 100_000  # lights, for which a map's tiles are its cells


def chosen(source: Source | np.ndarray) -> list[tuple[float, int, float]]:
    """(error limit, number of lights, error at other probes) for a source, or a polar map (90, 360, 3)."""
    radiance, bright = (source, NO_BRIGHT_CELLS) if isinstance(source, np.ndarray) else (source.polar, source.bright_cells)
    cells, result = tiles_from_map(radiance, "hemisphere", SINGLE_CELLS, bright), []
    for limit in LIMITS:
        wanted = Sampler(filter="none", count=MAX_COUNT, error_percent=100 * limit)
        _, lights, _ = step(wanted, initial_state(), SamplerInput(radiance, "hemisphere", 0.0, bright))
        error = np.sqrt(relative_squares(hard_probes("hemisphere", *UNSEEN), cells, lights).mean())
        result.append((limit, len(lights.ids), float(error)))
    return result


def overcast() -> np.ndarray:
    """The CIE's overcast sky as a polar map (90, 360, 3): three times as bright at the zenith as at the horizon."""
    gray = (1 + 2 * np.cos((np.arange(90) + 0.5) * np.pi / 180)) / 3
    return np.repeat(np.repeat(gray[:, None, None], 360, axis=1), 3, axis=2).astype(np.float32)


def main() -> None:
    folder = Path(os.environ.get("VEMLIGHT_DATA", "")) / "hdri"
    paths = sorted(path for path in folder.glob("*") if path.suffix in (".hdr", ".exr"))
    if not paths:
        sys.exit(f"{folder}: there are no .hdr or .exr maps; set VEMLIGHT_DATA to a folder with hdri/ in it")
    results = {path.stem.removesuffix("_1k"): chosen(read_source(path)) for path in paths}
    results["overcast sky (CIE)"] = chosen(overcast())
    OUT.mkdir(parents=True, exist_ok=True)
    with written_whole(OUT / "sampler_required_lights.csv") as part, open(part, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("map", "limit", "lights", "error"))
        table.writerows((name, p, n, f"{e:.4f}") for name, rows in results.items() for p, n, e in rows)
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5))
    for k, (name, rows) in enumerate(sorted(results.items(), key=lambda item: -item[1][3][1])):
        limit, count, error = np.array(rows).T
        left.loglog(limit * 100, count, "o-", color=plt.get_cmap("turbo")(k / max(len(results) - 1, 1)), label=name)
        right.loglog(limit * 100, error * 100, "o-", color=plt.get_cmap("turbo")(k / max(len(results) - 1, 1)))
        print(f"{name:<28}", " ".join(f"{100 * p:4.1f} %: {n:4.0f} ({100 * e:4.1f} %)" for p, n, e in rows))
    left.set(xlabel="error limit, %", ylabel="lights chosen", title="Lights that a scene requires")
    left.legend(fontsize=7)
    right.plot([4, 50], [4, 50], color="gray", linestyle="--")
    right.set(xlabel="error limit, %", ylabel="error on other probes, %", title="Error and its limit")
    for axis, down in ((left, (5, 10, 20, 40, 80)), (right, (5, 10, 20, 40))):
        axis.set_xticks((5, 10, 20, 40), ("5", "10", "20", "40"))
        axis.set_yticks(down, map(str, down))
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    figure.text(0.01, 0.01, "python -m bench.sampler_required_lights; tracked, soft lights (default), at most 1024", fontsize=7)
    figure.tight_layout(rect=(0, 0.03, 1, 1))
    figure.savefig(OUT / "sampler_required_lights.png", dpi=110)


if __name__ == "__main__":
    main()
