"""Speed of the sampler: python -m bench.sampler [--frames 100000]. Writes docs/charts/sampler_speed.csv and .png, and prints the table.

Times are CPU times of the whole process, all its threads together, in the fastest of five batches: on a shared machine the others measure
the load of its other users. With mitsuba installed (extra `bench`; it needs libLLVM 15 or newer, DRJIT_LIBLLVM_PATH) its envmap
is measured in the same run on the same pixels and points, limited to one thread like ours, its kernels compiled before.
"""

import argparse
import csv
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np

from vemlight.files import written_whole
from vemlight.sampler import cluster
from vemlight.sampler.light_map import light_map
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.temporal import filter, flicker
from vemlight.sampler.warp_method import irradiance_from_tint
from vemlight.sampler.warps.points import halton, points
from vemlight.sampler.warps.warp import WarpName, steadied, warp_from_map
from vemlight.settings import Sampler

matplotlib.use("Agg")
from matplotlib import pyplot as plt

OUT = Path(__file__).parents[1] / "docs" / "charts"
METHODS: tuple[WarpName, ...] = ("havran-azimuth", "havran-radius", "standard")
BATCHES = 5
DEFAULT_STEP = "step: tracked, soft lights (default)"
PAPER_SAMPLES_PER_MS = 410  # Havran et al. 2005, section 5, a Pentium 4 of 3 GHz
FIRST_FRAME = """
import time; start = time.perf_counter()
import numpy as np
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler
settings = Sampler(method="havran-azimuth", count=300, clusters=72)
step(settings, initial_state(), SamplerInput(np.ones((90, 360, 3), np.float32), "hemisphere", 0.0))
print(time.perf_counter() - start)
"""


class Row(NamedTuple):
    """One measured figure: what, for which size, median and 99th percentile in ms, and per ms where things are counted."""

    what: str
    size: int
    median_ms: float
    p99_ms: float
    per_ms: float


def sky(rows: int = 90, cols: int = 360) -> np.ndarray:
    """A sky with texture, a sun of one cell and clouds."""
    generator = np.random.default_rng(1)
    theta, phi = (np.arange(rows) + 0.5) / rows, (np.arange(cols) + 0.5) / cols * 2 * np.pi
    gray = (1 + theta[:, None] ** 2) * (1.3 + np.cos(phi - 1)[None, :]) * generator.lognormal(0, 0.3, (rows, cols))
    gray[rows * 4 // 9, cols * 2 // 3] += 1e4 * (rows / 90) ** 2
    return (gray[..., None] * [0.8, 1.0, 1.3]).astype(np.float32)


def measured(what: str, size: int, work: Callable[[], Any], repeats: int, counted: int = 0) -> Row:
    """CPU time of `work` in the quietest of BATCHES batches, after three runs that are not counted."""
    for _ in range(3):
        work()
    batches = np.empty((BATCHES, repeats))
    for k in range(batches.size):
        start = time.process_time()
        work()
        batches.flat[k] = time.process_time() - start
    times = batches[np.median(batches, axis=1).argmin()]
    median, p99 = np.quantile(times, [0.5, 0.99]) * 1e3
    return Row(what, size, float(median), float(p99), counted / float(median) if counted else 0.0)


def whole_step() -> list[Row]:
    """The step on 90 x 360 to 300 lights with tables, sampling, FIR and clustering, and its parts."""
    radiance, settings = sky(), Sampler(method=METHODS[0], count=300, clusters=72)
    maps = [radiance * np.float32(1 + 0.02 * k) for k in range(4)]
    state = initial_state()
    frame = 0

    def one() -> None:
        nonlocal state, frame
        state, _, _ = step(settings, state, SamplerInput(maps[frame % 4], "hemisphere", frame / 25))
        frame += 1

    rows = [measured("step: 90 x 360 to 300 lights, FIR, 72 clusters", 300, one, 1000), own_tail(settings, maps)]
    light = light_map(radiance, "hemisphere")
    warp, anchor = steadied(warp_from_map(light, "havran-azimuth"), None, 1.0)
    table = points(300, "disc")
    samples = warp.sample(table)
    drawn = np.concatenate([samples.directions, samples.radiance / samples.density[:, None] / light.irradiance], axis=1)
    now = filter.FilterFrame(frame / 25, light.irradiance, drawn)
    lights = step(Sampler(method=METHODS[0], count=300), initial_state(), SamplerInput(radiance, "hemisphere", 0.0))[1]
    clusters = cluster.clustered(lights, 72, "hemisphere", cluster.NO_CLUSTERS)[0]
    parts: list[tuple[str, Callable[[], Any]]] = [
        ("part: cleaning, importance, integrals", lambda: light_map(radiance, "hemisphere")),
        ("part: tables", lambda: warp_from_map(light, "havran-azimuth")),
        ("part: offset", lambda: steadied(warp, anchor, 0.3)),
        ("part: 300 samples", lambda: warp.sample(table)),
        ("part: flicker", lambda: flicker.flicker_after(state.flicker, frame / 25, np.ones(1))),
        ("part: FIR", lambda: filter.filtered(settings, state.filter, now, 0.0)),
        ("part: irradiance", lambda: irradiance_from_tint(np.ones(300), drawn[:, 3:], light.irradiance)),
        ("part: clustering", lambda: cluster.clustered(lights, 72, "hemisphere", clusters)),
    ]
    rows += [measured(what, 300, work, 300) for what, work in parts]
    asked = Sampler(method=METHODS[0], count=300, error_percent=15.0)
    state = step(asked, initial_state(), SamplerInput(radiance, "hemisphere", 0.0))[0]
    later = SamplerInput(radiance, "hemisphere", 0.04)
    rows.append(measured("step with the number of lights controlled", 300, lambda: step(asked, state, later), 300))
    return rows


def own_tail(settings: Sampler, maps: list[np.ndarray]) -> Row:
    """The same step on the same 600 frames eight times, the least time of each frame: what is slow by its own work is slow each time."""
    times = np.empty((8, 600))
    for run in times:
        state = initial_state()
        for k in range(run.size):
            start = time.process_time()
            state, _, _ = step(settings, state, SamplerInput(maps[k % len(maps)], "hemisphere", k / 25))
            run[k] = time.process_time() - start
    median, p99 = np.quantile(times.min(axis=0)[100:], [0.5, 0.99]) * 1e3
    return Row("step, least of eight runs frame by frame", 300, float(median), float(p99), 0.0)


def scaling() -> list[Row]:
    """Samples a ms for each method and number of points; tables for each size of map; the whole step for many lights."""
    rows = []
    light = light_map(sky(), "hemisphere")
    for method in METHODS:
        warp = warp_from_map(light, method)
        for count in (300, 1000, 10_000, 100_000):
            table = halton(count)
            rows.append(measured(f"samples: {method}", count, lambda w=warp, t=table: w.sample(t), max(20, 100_000 // count), count))
    for factor in (0.5, 1, 2, 4, 8):
        size = (int(90 * factor), int(360 * factor))
        radiance = sky(*size)
        radiance = radiance.copy()  # as in a service, a frame has come and gone before: its memory stays with the process and is used again
        cells = size[0] * size[1]
        rows.append(measured("map to tables", cells, lambda r=radiance: warp_from_map(light_map(r, "hemisphere"), METHODS[0]), 30, cells))
    for count in (300, 3000, 30_000, 100_000):
        settings = Sampler(method=METHODS[0], count=count)
        state = step(settings, initial_state(), SamplerInput(sky(), "hemisphere", 0.0))[0]
        work = partial(step, settings, state, SamplerInput(sky(), "hemisphere", 0.04))
        rows.append(measured("step: lights of 2005, FIR", count, work, 20, count))
    for count in (16, 64, 256, 1000):
        settings = Sampler(count=count)
        state = step(settings, initial_state(), SamplerInput(sky(), "hemisphere", 0.0))[0]
        work = partial(step, settings, state, SamplerInput(sky(), "hemisphere", 0.04))
        rows.append(measured(DEFAULT_STEP, count, work, 50, count))
    return rows


def beside_mitsuba() -> list[Row]:
    """Rebuilding and sampling an environment map of 90 x 360 pixels over the sphere: ours, and Mitsuba's where it is installed."""
    radiance, counts = sky(), (300, 10_000, 100_000)
    rows = []
    for count in counts:
        table = halton(count)

        def build(table: np.ndarray = table) -> None:
            warp_from_map(light_map(radiance, "sphere"), "havran-azimuth").sample(table)

        rows.append(measured("vemlight: new map, then samples", count, build, 30, count))
    try:
        import drjit as dr  # pyright: ignore[reportMissingImports]
        import mitsuba as mi  # pyright: ignore[reportMissingImports]

        mi.set_variant("llvm_ad_rgb")
        dr.set_thread_count(1)
        assert dr.thread_count() == 1
    except (ImportError, RuntimeError, AttributeError) as error:
        print(f"mitsuba is not measured ({error}); install the extra `bench` and a libLLVM", file=sys.stderr)
        return rows
    emitter: Any = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(radiance)})
    parameters = mi.traverse(emitter)
    pixels = np.array(parameters["data"])  # as Mitsuba keeps them, with two columns repeated
    for count in counts:
        table = halton(count)
        at, point = dr.zeros(mi.SurfaceInteraction3f, count), mi.Point2f(table.T.astype(np.float32))

        def rebuild(at: Any = at, point: Any = point) -> None:
            parameters["data"] = mi.TensorXf(pixels)
            parameters.update()
            record, weight = emitter.sample_direction(at, point)
            dr.eval(record, weight)
            dr.sync_thread()

        rows.append(measured("mitsuba envmap: new map, then samples", count, rebuild, 30, count))
    return rows


def memory(frames: int) -> list[Row]:
    """Resident memory in MiB (in the column of the median) after a tenth and after all of many frames."""
    settings, radiance = Sampler(method=METHODS[0], count=72, clusters=36), sky(24, 96)
    state, rows = initial_state(), []
    for k in range(1, frames + 1):
        state, _, _ = step(settings, state, SamplerInput(radiance, "hemisphere", k / 25))
        if k in (frames // 10, frames):
            rows.append(Row("memory after frames, MiB", k, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 0.0, 0.0))
    return rows


def first_frame() -> Row:
    """Wall time from the start of Python's imports to the first lights, compiled code cached, median of five, in ms."""
    command = [sys.executable, "-c", FIRST_FRAME]
    times = [float(subprocess.run(command, capture_output=True, text=True, check=True).stdout) for _ in range(6)][1:]
    return Row("first frame after a cold start", 300, float(np.median(times)) * 1e3, float(np.max(times)) * 1e3, 0.0)


def chart(rows: list[Row], path: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.5))
    for what in dict.fromkeys(row.what for row in rows if row.what.startswith("samples")):
        own = [row for row in rows if row.what == what]
        left.loglog([row.size for row in own], [row.per_ms for row in own], "o-", label=what.removeprefix("samples: "))
    left.axhline(PAPER_SAMPLES_PER_MS, color="gray", linestyle="--", label="Havran et al. 2005, Pentium 4")
    left.set(xlabel="samples drawn at once", ylabel="samples per ms", title="Sampling by the warps of 2005, 90 x 360 map")
    left.legend()
    for what in (DEFAULT_STEP, "step: lights of 2005, FIR", "vemlight: new map, then samples", "mitsuba envmap: new map, then samples"):
        own = [row for row in rows if row.what == what]
        if own:
            right.loglog([row.size for row in own], [row.median_ms for row in own], "o-", label=what)
    right.set(xlabel="lights or samples", ylabel="ms (CPU, one thread)", title="New map to lights, 90 x 360")
    right.legend()
    figure.text(0.01, 0.01, f"python -m bench.sampler; {platform.machine()}, Python {platform.python_version()}, one thread", fontsize=7)
    figure.tight_layout(rect=(0, 0.03, 1, 1))
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000, help="of the test of memory")
    frames = parser.parse_args().frames
    rows = whole_step() + scaling() + beside_mitsuba() + [first_frame()] + memory(frames)
    OUT.mkdir(parents=True, exist_ok=True)
    with written_whole(OUT / "sampler_speed.csv") as part, open(part, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(Row._fields)
        table.writerows((row.what, row.size, f"{row.median_ms:.4g}", f"{row.p99_ms:.4g}", f"{row.per_ms:.4g}") for row in rows)
    chart(rows, OUT / "sampler_speed.png")
    for row in rows:
        print(f"{row.what:<50} {row.size:>8} {row.median_ms:>9.3f} ms  p99 {row.p99_ms:>9.3f} ms  {row.per_ms:>9.0f} per ms")


if __name__ == "__main__":
    main()
