"""The benchmark of stability: error, flicker and identity of every method's lights, on maps and sequences from recipes.

    python -m bench.stability [--count 64] [--methods NAME ...] [--maps NAME ...] [--sequences NAME ...] [--out docs/charts]

Writes stability.csv, a row for each method, map and sequence (of some of them alone: their rows anew, the others stay), and the table of
docs/stability.md, which says what is measured and how to add a method. Nothing but the repository is needed, seeds are fixed, and each
method gets the same frames. A run that was cut off goes on where it was when the same command is given again.
"""

import argparse
import csv
import math
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from bench.evaluation import ProbeIrradiance, points_of
from bench.methods import MOVING as METHODS
from bench.methods import Method
from bench.rivals.sequential import begun, sequential
from bench.rivals.spatiotemporal import spatiotemporal
from bench.sequences import FRAMES, Frame, world_from_latlong
from bench.stability.measures import measured, truth_of
from bench.stability.moving import MOVING
from bench.stability.progress import Unfinished, show_table
from bench.stability.recipes import RECIPES
from vemlight.files import written_whole
from vemlight.light.light_set import LightSet
from vemlight.sampler.sampler_input import SamplerInput

OUT = Path(__file__).parents[2] / "docs" / "charts"
FAULTS = {"damaged frames", "black frames", "lost frames", "mains 21 fps", "mains 25 fps", "mains 30 fps", "strobe"}  # of the input
SEQUENTIAL = Method("sequential (Ghosh et al. 2006)", begun, sequential, steady=True)
SPATIOTEMPORAL = "spatiotemporal (Wan et al. 2011), offline"
NAMES = [*(method.name for method in METHODS), SEQUENTIAL.name, SPATIOTEMPORAL]
SHOWN = ("error", "error_worst", "flicker", "born", "torn", "id_changes", "carried", "wobble", "place_wobble", "ms")


def inputs(frames: Sequence[Frame]) -> list[SamplerInput]:
    return [SamplerInput(frame.seen, "hemisphere", frame.time_s, frame.source.bright_cells) for frame in frames]


def lights_of(name: str, count: int, frames: Sequence[SamplerInput]) -> tuple[list[LightSet], float]:
    """A method's lights of each frame, and the milliseconds of a frame, the median of all."""
    if name == SPATIOTEMPORAL:
        begin = time.thread_time()
        lights = spatiotemporal(count, frames)
        return lights, 1e3 * (time.thread_time() - begin) / len(frames)
    method = next(method for method in (*METHODS, SEQUENTIAL) if method.name == name)
    state, made, taken_ms = method.start(count), [], []
    for frame in frames:
        begin = time.thread_time()
        state, lights = method.step(state, frame)
        taken_ms.append(1e3 * (time.thread_time() - begin))
        made.append(lights)
    return made, float(np.median(taken_ms))


def rows_of(map_name: str, sequence: str, count: int, names: Sequence[str]) -> list[dict[str, object]]:
    """One row for each method of these names."""
    frames = [*MOVING[sequence](world_from_latlong(RECIPES[map_name]()))]
    truths: list[ProbeIrradiance] = []
    for k, frame in enumerate(frames):
        still = k > 0 and frame.source.brightest is frames[k - 1].source.brightest
        truths.append(truths[-1] if still else truth_of(points_of(frame.source)))
    rows = []
    for name in names:
        lights, ms = lights_of(name, count, inputs(frames))
        row = {"method": name, "map": map_name, "sequence": sequence}
        rows.append(row | measured(frames, truths, lights, len(frames) - FRAMES) | {"ms": ms})
    return rows


def table(rows: list[dict[str, object]]) -> str:
    """The means over maps and sequences of each method, as Markdown: of moving light, and of frames with faults their error and flicker."""
    lines = [["", *(key.replace("_", " ") for key in SHOWN), "error, faults", "flicker, faults"]]
    for name in dict.fromkeys(str(row["method"]) for row in rows):
        own = [row for row in rows if row["method"] == name]
        sound = [row for row in own if row["sequence"] not in FAULTS]
        faulty = [row for row in own if row["sequence"] in FAULTS]
        values = [_mean(sound, key) for key in SHOWN] + [_mean(faulty, key) for key in ("error", "flicker")]
        lines.append([name, *("" if math.isnan(value) else f"{value:.2g}" if value >= 10 else f"{value:.3g}" for value in values)])
    head, *rest = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([head, "|" + "---|" * len(lines[0]), *rest])


def complete(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """The rows of the methods that have one for every map and sequence of any: means over others could not be compared."""
    counts = Counter(str(row["method"]) for row in rows)
    pairs = {(row["map"], row["sequence"]) for row in rows}
    return [row for row in rows if counts[str(row["method"])] == len(pairs)]


def caption(rows: list[dict[str, object]]) -> str:
    """Which maps and sequences the means of the table are over, and which methods it lacks."""
    names = [list(dict.fromkeys(str(row[key]) for row in rows)) for key in ("map", "sequence")]
    sound, shown = [name for name in names[1] if name not in FAULTS], {row["method"] for row in complete(rows)}
    lacking = [name for name in dict.fromkeys(str(row["method"]) for row in rows) if name not in shown]
    text = (
        f"Maps: {', '.join(names[0])}. Means over {len(sound)} sequences without faults, and over {len(names[1]) - len(sound)} with faults "
        "([stability.csv](charts/stability.csv))"
    )
    return text + (f"; not yet run on all of them, and left out: {'; '.join(lacking)}:" if lacking else ":")


def _mean(rows: list[dict[str, object]], key: str) -> float:
    values = [float(str(row[key])) for row in rows]
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else math.nan


def with_earlier(rows: list[dict[str, object]], path: Path) -> list[dict[str, object]]:
    """The rows, and those of an earlier file that they do not replace, in the order of methods, maps and sequences."""
    made: dict[tuple[object, ...], dict[str, object]] = {(row["method"], row["map"], row["sequence"]): row for row in rows}
    if path.exists():
        with open(path, newline="") as file:
            earlier: list[dict[str, object]] = [{**row} for row in csv.DictReader(file)]
        made = {(row["method"], row["map"], row["sequence"]): row for row in earlier} | made
    orders = NAMES, list(RECIPES), list(MOVING)
    known = [key for key in made if all(part in order for part, order in zip(key, orders, strict=True))]
    return [made[key] for key in sorted(known, key=lambda key: [order.index(str(part)) for part, order in zip(key, orders, strict=True)])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=64, help="lights of each method")
    parser.add_argument("--methods", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--maps", nargs="+", choices=RECIPES, default=list(RECIPES))
    parser.add_argument("--sequences", nargs="+", choices=MOVING, default=list(MOVING))
    parser.add_argument("--jobs", type=int, default=1, help="processes; times are those of one where this is 1")
    parser.add_argument("--out", type=Path, default=OUT)
    chosen = parser.parse_args()
    pairs = [(map_name, sequence) for map_name in chosen.maps for sequence in chosen.sequences]
    chosen.out.mkdir(parents=True, exist_ok=True)
    path = chosen.out / "stability.csv"
    unfinished = Unfinished(chosen.out / "stability_unfinished.json", [chosen.count, chosen.methods, pairs])
    with ProcessPoolExecutor(chosen.jobs) as pool:
        made = {pool.submit(rows_of, *pair, chosen.count, chosen.methods): pair for pair in unfinished.left(pairs)}
        for future in as_completed(made):
            rows = with_earlier(future.result(), path)
            with written_whole(path) as part, open(part, "w", newline="") as file:
                writer = csv.DictWriter(file, list(rows[0]))
                writer.writeheader()
                writer.writerows({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
            unfinished.add(made[future])
            print(*made[future], flush=True)
    rows = with_earlier([], path)
    text = f"{caption(rows)}\n\n{table(complete(rows))}"
    print(text)
    if chosen.out == OUT:
        show_table("stability", text)
    unfinished.finish()


if __name__ == "__main__":
    main()
