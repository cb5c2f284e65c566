"""Pictures of the renderer against the map itself, over the number of lights.

    VEMLIGHT_DATA=FOLDER python -m bench.renderer_accuracy [--out docs/charts]

Writes renderer_figure6.png, .svg and .csv. Lights, renderer and samples a pixel are the defaults of `vemlight render`, with its bounce. The
truth is Mitsuba's picture under the whole map with one bounce, TRUTH paths a pixel. Measures: RMSE of radiance over the root mean square of
the truth; mean FLIP (Andersson et al. 2020) and mean colour difference in CIE 1976 L*a*b* of both pictures, tone-mapped alike as the truth
is. Needs the extra `bench` and a libLLVM. More scenes and maps, and the renderers of others: bench/pictures.py.
"""

import argparse
import csv
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import flip_evaluator  # pyright: ignore[reportMissingImports]
import numpy as np
from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import leave_margin
from bench.accuracy.maps import chosen
from bench.evaluation import read_source
from bench.methods import POINTS, SETTLED, SOFT
from bench.renderer import paper_scene
from bench.rivals import mitsuba_picture
from tests.support.scenes import SHAPES
from vemlight.commands.chart import machine
from vemlight.files import written_whole
from vemlight.light.images import read_radiance
from vemlight.light.light_set import LightSet
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.output.tonemap import adapt, tone_mapped
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import load_scene
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Renderer as Settings
from vemlight.settings import Sampler

TRUTH = 1024  # paths a pixel: leaves a noise of 0.4 % under a sun and 0.6 % under an overcast sky
SAMPLES = 4  # of a pixel, as `vemlight render` has them
COUNTS = (4, 8, 16, 32, 64, 128, 256)
METHODS: dict[str, dict[str, Any]] = {SOFT: {}, POINTS: {"soft": False}, "Havran 2005": {"method": "havran-azimuth"}}
STYLES = ("o-", "^--", "x:")
MEASURES = {"rmse": "relative RMSE", "flip": "mean FLIP", "lab": "mean difference in L*a*b*"}
FRAMES, LONGEST_S = 9, 1.0  # pictures timed, after two that are not; three where they take longer


class Error(NamedTuple):
    """How far a picture is from the truth: `MEASURES`."""

    rmse: float
    flip: float
    lab: float


def errors(picture: np.ndarray, truth: np.ndarray) -> Error:
    """The difference of two linear pictures (height, width, 3)."""
    rmse = float(np.sqrt(np.mean((picture - truth) ** 2) / np.mean(truth**2)))
    whole = [np.concatenate([p, np.ones_like(p[..., :1])], axis=-1) for p in (truth, picture)]
    eye = adapt(None, whole[0], 0.0)
    coded = [(tone_mapped(p, eye, 0.0)[..., :3] / np.float32(255)).astype(np.float32) for p in whole]
    flip = float(flip_evaluator.evaluate(coded[0], coded[1], "LDR")[1])
    lab = [cv2.cvtColor(p, cv2.COLOR_RGB2Lab) for p in coded]
    return Error(rmse, flip, float(np.linalg.norm(lab[0] - lab[1], axis=-1).mean()))


@lru_cache(maxsize=64)
def lights_of(path: Path, count: int, name: str) -> LightSet:
    """What the sampler makes of a still map, by the name of a method."""
    settings, source = Sampler(filter="none", count=count, **METHODS[name]), read_source(path)
    state, lights = initial_state(), None
    for k in range(SETTLED):
        state, lights, _ = step(settings, state, SamplerInput(source.polar, "hemisphere", k / 25, source.bright_cells))
    assert lights is not None
    return lights


def figure6(out: Path, progress: Progress) -> None:
    """Error over 4 to 256 lights, two scenes, four maps; the whole area of each pixel. As figure 6 of Havran et al. 2005 has it by eye."""
    size, rows = (200, 150), []
    scenes = {"the paper's size": paper_scene(), "shapes": load_scene(SHAPES)}
    task = progress.add_task("against the map", total=len(scenes) * len(chosen()) * (1 + len(METHODS) * len(COUNTS)))
    for scene_name, scene in scenes.items():
        renderer = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1]), SAMPLES))
        for kind, path in chosen().items():
            world = mitsuba_picture.mitsuba_scene(scene, size, read_radiance(path)[0])
            truth = mitsuba_picture.picture(world, TRUTH, method="path")
            progress.advance(task)
            for name in METHODS:
                for count in COUNTS:
                    made = renderer.render(lights_of(path, count, name))[..., :3].copy()
                    rows.append({"scene": scene_name, "map": kind, "method": name, "lights": count, **errors(made, truth)._asdict()})
                    progress.advance(task)
        renderer.release()
    note = (
        f"Against Mitsuba 3 under the whole map with one bounce, {TRUTH} paths a pixel; {size[0]} x {size[1]}, {SAMPLES} samples a pixel."
    )
    save(draw_figure6(rows), rows, out, "figure6", note)


def draw_figure6(rows: list[dict[str, Any]]) -> Any:
    """A column for each kind of map, a line for each measure."""
    kinds, scenes = list(dict.fromkeys(r["map"] for r in rows)), list(dict.fromkeys(r["scene"] for r in rows))
    figure, axes = plt.subplots(len(MEASURES), len(kinds), figsize=(16, 10), sharex=True, sharey="row", layout="constrained")
    leave_margin(figure, 0.06)
    for line, (measure, label) in zip(axes, MEASURES.items(), strict=True):
        for axis, kind in zip(line, kinds, strict=True):
            for k, scene in enumerate(scenes):
                for name, style in zip(METHODS, STYLES, strict=True):
                    own = [r for r in rows if (r["scene"], r["map"], r["method"]) == (scene, kind, name)]
                    heavy = 2.2 if name == SOFT else 1
                    axis.loglog(
                        [r["lights"] for r in own], [r[measure] for r in own], style, color=f"C{k}", lw=heavy, label=f"{scene}: {name}"
                    )
            axis.set_xticks(COUNTS, map(str, COUNTS))
            axis.minorticks_off()
            axis.grid(alpha=0.3, which="both")
        line[0].set_ylabel(label)
    for top, bottom, kind in zip(axes[0], axes[-1], kinds, strict=True):
        top.set_title(kind)
        bottom.set_xlabel("lights")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8, bbox_to_anchor=(0.5, 0.015))
    return figure


class Timed(NamedTuple):
    """What a picture took on the clock, and of all cores together, which other work on the machine does not change."""

    ms: float
    processor_ms: float
    picture: np.ndarray


def timed(work: Callable[[int], np.ndarray], frames: int = FRAMES) -> Timed:
    """Medians for a piece of work that is given the frame's number, and what it made last."""
    times, made = [], np.empty(0)
    for frame in range(-2, frames):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        made = work(frame)
        times.append((time.perf_counter() - begin, time.process_time() - begin_cpu))
        if frame >= 2 and frames == FRAMES and np.sum(times[2:], axis=0)[1] > LONGEST_S:
            break
    ms, processor_ms = (np.median(times[2:], axis=0) * 1e3).tolist()
    return Timed(ms, processor_ms, made)


def save(figure: Any, rows: list[dict[str, Any]], out: Path, name: str, note: str) -> None:
    """The chart as PNG and SVG with its caption, the rows as CSV: renderer_NAME."""
    figure.text(0.01, 0.004, f"{note}   python -m bench.renderer_accuracy   {machine()}", fontsize=7, color="0.35")
    out.mkdir(parents=True, exist_ok=True)
    for suffix in (".png", ".svg"):
        with written_whole(out / f"renderer_{name}{suffix}") as part:
            figure.savefig(part, dpi=85)
    plt.close(figure)
    with written_whole(out / f"renderer_{name}.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), restval="")
        table.writeheader()
        table.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "charts")
    asked = parser.parse_args()
    mitsuba_picture.start()
    with Progress() as progress:
        figure6(asked.out, progress)


if __name__ == "__main__":
    main()
