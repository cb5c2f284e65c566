"""The times that the paper gives for each part of its system, and ours.

Havran et al. 2005, section 5: a Pentium 4 of 3 GHz and a GeForce 6800 GT. What it gives as "below" is its upper end here.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import leave_margin, save
from bench.accuracy.maps import one
from bench.evaluation import read_source
from bench.real_maps import LENS, RESPONSE
from vemlight.capture.frames import FrameMaker
from vemlight.renderer.passes.lights.light_regions import light_regions, region_rows
from vemlight.sampler.cluster import NO_CLUSTERS, clustered
from vemlight.sampler.light_map import light_map
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.warps.points import points
from vemlight.sampler.warps.warp import warp_from_map
from vemlight.settings import Capture, Sampler

ROUNDS = 200


def times(out: Path, progress: Progress) -> None:
    """Milliseconds of each part of a frame, the paper's and ours."""
    radiance = read_source(one("a sun")).polar
    parts = _parts(radiance)
    task = progress.add_task("times", total=len(parts))
    rows = []
    for what, paper_ms, run in parts:
        rows.append({"part": what, "paper_ms": paper_ms or "", "ours_ms": _median_ms(run)})
        progress.advance(task)
    figure, axis = plt.subplots(figsize=(11, 5.2), layout="constrained")
    leave_margin(figure, 0.05)
    place = np.arange(len(rows))[::-1]
    published = [(y, row["paper_ms"]) for y, row in zip(place, rows, strict=True) if row["paper_ms"]]
    axis.barh([y + 0.2 for y, _ in published], [ms for _, ms in published], 0.38, color="0.7", label="the paper, 2005")
    axis.barh(place - 0.2, [row["ours_ms"] for row in rows], 0.38, color="C0", label="ours")
    for y, row in zip(place, rows, strict=True):
        axis.text(row["ours_ms"] * 1.05, y - 0.2, f"{row['ours_ms']:.2g}", va="center", fontsize=8)
    for y, ms in published:
        axis.text(ms * 1.05, y + 0.2, f"{ms:.2g}", va="center", fontsize=8)
    axis.set_yticks(place, [row["part"] for row in rows], fontsize=8)
    axis.set(xscale="log", xlabel="ms a frame")
    axis.grid(alpha=0.3, axis="x")
    axis.legend()
    save(figure, rows, out, "times", f"CPU time, median of {ROUNDS}.")


def _median_ms(run: Callable[[], object]) -> float:
    run()
    taken = []
    for _ in range(ROUNDS):
        begin = time.thread_time()
        run()
        taken.append(1e3 * (time.thread_time() - begin))
    return float(np.median(taken))


def _parts(radiance: np.ndarray) -> list[tuple[str, float | None, Callable[[], object]]]:
    """(name, the paper's ms or None, ours)."""
    light = light_map(radiance, "hemisphere")
    warp, some = warp_from_map(light, "havran-azimuth"), points(300, "halton")
    wanted = Sampler(method="havran-azimuth", count=300, filter="none")
    _, lights, _ = step(wanted, initial_state(), SamplerInput(radiance, "hemisphere", 0.0))
    clusters, _ = clustered(lights, 72, "hemisphere", NO_CLUSTERS)
    regions = light_regions(200)
    return [
        ("raw frame to polar map, 640 x 640 to 360 x 90", 1.0, _capture()),
        ("luminous power and tables of a 360 x 90 map", 2.0, lambda: warp_from_map(light_map(radiance, "hemisphere"), "havran-azimuth")),
        ("300 samples", 300 / 410, lambda: warp.sample(some)),
        ("lights for 200 regions of normals", 1.0, lambda: region_rows(regions, lights.directions)),
        ("clustering of 300 lights", 1.0, lambda: clustered(lights, 72, "hemisphere", clusters)),
        ("300 lights with filter and clusters, whole", 5.0, _step(radiance, method="havran-azimuth", count=300, clusters=72)),
        ("64 tracked soft lights (default), whole", None, _step(radiance, method="tracked", count=64)),
        ("300 tracked soft lights (default), whole", None, _step(radiance, method="tracked", count=300)),
    ]


def _step(radiance: np.ndarray, **settings: object) -> Callable[[], object]:
    """A step on one map again and again, 40 ms apart."""
    wanted = Sampler(**settings)  # type: ignore[arg-type]
    state, time_s = initial_state(), 0.0
    bright_cells = read_source(one("a sun")).bright_cells

    def run() -> None:
        nonlocal state, time_s
        state, _, _ = step(wanted, state, SamplerInput(radiance, "hemisphere", time_s, bright_cells))
        time_s += 0.04

    return run


def _capture() -> Callable[[], object]:
    with TemporaryDirectory() as folder:
        for name, text in (("lens.toml", LENS), ("response.toml", RESPONSE)):
            (Path(folder) / name).write_text(text)
        maker = FrameMaker(Capture(), Path(folder))
        codes = np.random.default_rng(0).integers(200, 4000, (640, 640), dtype=np.uint16)
        maker.frame_from_codes("noise", codes, "mono", 0.0)
    return partial(maker.frame_from_codes, "noise", codes, "mono", 0.0)
