"""Pictures of the renderer against the map itself.

    VEMLIGHT_DATA=FOLDER python -m bench.renderer_accuracy [--out docs/charts] [CHART ...] [--curves TEXT ...]

Charts: figure6 (error over the number of lights), time (error over ms a picture, with Mitsuba 3 and Embree: on a software renderer, for a
graphics card's time is not the processor's). Writes renderer_NAME.png, .svg and .csv. The truth is Mitsuba's picture under the whole map,
TRUTH paths a pixel. Measures: RMSE of radiance over the root mean square of the truth; mean FLIP (Andersson et al. 2020) and mean colour
difference in CIE 1976 L*a*b* of both pictures tone-mapped alike, as the truth is. Needs the extra `bench` and a libLLVM.
"""

import argparse
import time
from collections.abc import Callable
from functools import lru_cache, partial
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
from bench.renderer import paper_scene
from bench.rivals import mitsuba_picture
from tests.support.scenes import SHAPES
from vemlight.commands.chart import machine
from vemlight.files import written_whole
from vemlight.light.images import read_radiance
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import rotation_xyz
from vemlight.renderer import frame_plan
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.output.tonemap import adapt, tone_mapped
from vemlight.renderer.passes.lights.light_regions import SPHERE_REGIONS
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Renderer as Settings
from vemlight.settings import Sampler

TRUTH = 1024  # paths a pixel: leaves a noise of 0.4 % under a sun and 0.6 % under an overcast sky
COUNTS = (4, 8, 16, 32, 64, 128, 256)
SETTLED = 8  # frames in which tracked lights find their places on a still map
METHODS = {"tracked (default)": {"method": "tracked"}, "Havran 2005": {"method": "havran-azimuth"}}
MEASURES = {"rmse": "relative RMSE", "flip": "mean FLIP", "lab": "mean difference in L*a*b*"}
FRAMES, LONGEST_S = 9, 1.0  # pictures timed, after two that are not; three where they take longer
TURN_DEG = 0.5  # a frame, of the lights whose maps are drawn within a budget


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
def lights_of(path: Path, count: int, method: str, clusters: int = 0) -> LightSet:
    """What the sampler makes of a still map."""
    settings, source = Sampler(method=method, filter="none", count=count, clusters=clusters), read_source(path)  # type: ignore[arg-type]
    state, lights = initial_state(), None
    for k in range(SETTLED):
        state, lights, _ = step(settings, state, SamplerInput(source.polar, "hemisphere", k / 25, source.bright_cells))
    assert lights is not None
    return lights


# --- over the number of lights: the paper's figure 6 -----------------------------------------------------------------------------------


def figure6(out: Path, progress: Progress) -> None:
    """Error over 4 to 256 lights, two scenes, four maps; 16 samples and the whole area of each pixel."""
    size, rows = (200, 150), []
    scenes = {"the paper's size": paper_scene(), "bundled scene": load_scene(SHAPES)}
    task = progress.add_task("against the map", total=len(scenes) * len(chosen()) * (1 + len(METHODS) * len(COUNTS)))
    for scene_name, scene in scenes.items():
        renderer = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1], light_regions=0), 16))
        for kind, path in chosen().items():
            truth = mitsuba_picture.picture(mitsuba_picture.mitsuba_scene(scene, size, read_radiance(path)[0]), TRUTH)
            progress.advance(task)
            for name, method in METHODS.items():
                for count in COUNTS:
                    made = renderer.render(lights_of(path, count, **method))[..., :3].copy()
                    rows.append({"scene": scene_name, "map": kind, "method": name, "lights": count, **errors(made, truth)._asdict()})
                    progress.advance(task)
        renderer.release()
    note = f"Against Mitsuba 3 under the whole map, {TRUTH} paths a pixel; {size[0]} x {size[1]}, 16 samples a pixel."
    save(draw_figure6(rows), rows, out, "figure6", note)


def draw_figure6(rows: list[dict[str, Any]]) -> Any:
    """A column for each kind of map, a line for each measure."""
    kinds, scenes = list(dict.fromkeys(r["map"] for r in rows)), list(dict.fromkeys(r["scene"] for r in rows))
    figure, axes = plt.subplots(len(MEASURES), len(kinds), figsize=(16, 10), sharex=True, sharey="row", layout="constrained")
    leave_margin(figure, 0.03)
    for line, (measure, label) in zip(axes, MEASURES.items(), strict=True):
        for axis, kind in zip(line, kinds, strict=True):
            for k, scene in enumerate(scenes):
                for name, style in zip(METHODS, ("o-", "x:"), strict=True):
                    own = [r for r in rows if (r["scene"], r["map"], r["method"]) == (scene, kind, name)]
                    axis.loglog([r["lights"] for r in own], [r[measure] for r in own], style, color=f"C{k}", label=f"{scene}, {name}")
            axis.set_xticks(COUNTS, map(str, COUNTS))
            axis.minorticks_off()
            axis.grid(alpha=0.3, which="both")
        line[0].set_ylabel(label)
    for top, bottom, kind in zip(axes[0], axes[-1], kinds, strict=True):
        top.set_title(kind)
        bottom.set_xlabel("lights")
    axes[0, 0].legend(fontsize=8)
    return figure


# --- over time -------------------------------------------------------------------------------------------------------------------------


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


def turned(lights: LightSet, degrees: float) -> LightSet:
    """The lights turned about z."""
    return LightSet.of(lights.ids, lights.directions @ rotation_xyz((0.0, 0.0, degrees)).T, lights.irradiance)


class Ours:
    """Renderers of a scene in a picture of `size`, one for each of the settings asked for."""

    def __init__(self, scene: Scene, size: tuple[int, int]) -> None:
        self._scene, self._size = scene, size
        self._made: dict[tuple[Any, ...], FrameSequence] = {}

    def timed(self, lights: LightSet, **settings: Any) -> Timed:
        """A picture with these settings; frame_ms = 1e4: the lights stand still and keep their maps."""
        renderer = self._renderer(**settings)
        return timed(lambda _: renderer.render(lights)[..., :3].copy())

    def within(self, budget: int, lights: LightSet) -> Timed:
        """The same with lights that turn and have come to `lights` in the last of 48 pictures; `budget` maps drawn in each at most."""
        renderer = self._renderer(frame_ms=1e4)
        usual = frame_plan.affordable_maps, frame_plan.coarsening
        frame_plan.affordable_maps, frame_plan.coarsening = lambda *_: budget, lambda _demand, previous, _most: previous
        try:
            return timed(lambda frame: renderer.render(turned(lights, TURN_DEG * (frame - 45)))[..., :3].copy(), 46)
        finally:
            frame_plan.affordable_maps, frame_plan.coarsening = usual

    def _renderer(self, **settings: Any) -> FrameSequence:
        settings = {"light_regions": 0, **settings}  # as for all light from above
        key = tuple(sorted(settings.items()))
        if key not in self._made:
            self._made[key] = FrameSequence(Renderer(self._scene, Settings(width=self._size[0], height=self._size[1], **settings)))
        return self._made[key]

    def release(self) -> None:
        for renderer in self._made.values():
            renderer.release()


def curves_of(ours: Ours, traced: Any, world: Any, path: Path) -> dict[str, dict[str, Callable[[], Timed]]]:
    """Every curve's points: what is measured under which label."""
    lights = partial(lights_of, path, method="tracked")
    return {
        "lights, maps redrawn": {str(n): partial(ours.timed, lights(n)) for n in COUNTS},
        "lights, maps cached": {str(n): partial(ours.timed, lights(n), frame_ms=1e4) for n in COUNTS},
        "lights, maps of 256 x 256": {str(n): partial(ours.timed, lights(n), shadow_map=256) for n in COUNTS},
        "lights, 24 regions": {str(n): partial(ours.timed, lights(n), light_regions=SPHERE_REGIONS) for n in COUNTS},
        "2005 lights": {str(n): partial(ours.timed, lights_of(path, n, "havran-azimuth")) for n in COUNTS},
        "2005 lights, 4 n merged to n": {
            str(n): partial(ours.timed, lights_of(path, 4 * n, "havran-azimuth", n)) for n in COUNTS
        },
        "72 lights, texels of a map": {str(n): partial(ours.timed, lights(72), shadow_map=n) for n in (32, 64, 128, 256, 512, 1024)},
        "72 turning lights, maps a frame": {str(n): partial(ours.within, n, lights(72)) for n in (3, 6, 12, 24, 72)},
        "Embree, the same lights": {str(n): partial(_traced, traced, lights(n)) for n in COUNTS},
        "Mitsuba 3, paths a pixel": {str(n): partial(_sampled, world, n) for n in (1, 2, 4, 8, 16, 32, 64, 128, 256)},
    }


def _traced(traced: Any, lights: LightSet) -> Timed:
    return timed(lambda frame: traced.picture(lights))


def _sampled(world: Any, samples: int) -> Timed:
    return timed(lambda frame: mitsuba_picture.picture(world, samples, frame + 2, centred=True))


def times(out: Path, progress: Progress, wanted: list[str] | None = None) -> None:
    """Error against ms a picture at the scene of the paper's size, at the pixels' centres; of curves that name one of `wanted`."""
    size, scene, rows = (320, 240), paper_scene(), []
    ours = Ours(scene, size)
    kinds = ("a sun", "an overcast sky")
    task = progress.add_task("against time", total=None)
    for kind in kinds:
        path = chosen()[kind]
        world = mitsuba_picture.mitsuba_scene(scene, size, read_radiance(path)[0])
        truth = mitsuba_picture.picture(world, TRUTH, centred=True)
        points = curves_of(ours, mitsuba_picture.TracedLights(world, size), world, path)
        points = {curve: works for curve, works in points.items() if not wanted or any(name in curve for name in wanted)}
        progress.update(task, total=len(kinds) * sum(map(len, points.values())))
        for curve, works in points.items():
            for label, work in works.items():
                ms, processor_ms, made = work()
                took = {"ms": ms, "processor_ms": processor_ms}
                rows.append({"map": kind, "curve": curve, "at": label, **took, **errors(made, truth)._asdict()})
                progress.advance(task)
    ours.release()
    rows += [row for kind in kinds for row in equal_error([r for r in rows if r["map"] == kind])]
    note = f"{triangles(scene)} triangles, {size[0]} x {size[1]}, resolutions by power where not stated; bottom left is best."
    save(draw_time(rows), rows, out, "time", note)


def draw_time(rows: list[dict[str, Any]]) -> Any:
    """A line for each kind of map, a column for each measure."""
    kinds = list(dict.fromkeys(r["map"] for r in rows))
    figure, axes = plt.subplots(len(kinds), len(MEASURES), figsize=(17, 10), layout="constrained")
    leave_margin(figure, 0.1)
    for line, kind in zip(axes, kinds, strict=True):
        for axis, (measure, label) in zip(line, MEASURES.items(), strict=True):
            for k, curve in enumerate(dict.fromkeys(r["curve"] for r in rows if r["curve"] != EQUAL)):
                own = [r for r in rows if (r["map"], r["curve"]) == (kind, curve)]
                rival = curve.startswith(("Mitsuba", "Embree"))
                axis.loglog([r["processor_ms"] for r in own], [r[measure] for r in own], "s--" if rival else "o-", ms=4, color=f"C{k}",
                            label=f"{curve}: {own[0]['at']} ... {own[-1]['at']}")
            axis.set(title=kind, xlabel="ms of processor time a picture, all cores together", ylabel=label)
            axis.grid(alpha=0.3, which="both")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, bbox_to_anchor=(0.5, 0.02))
    return figure


EQUAL = "times as long for the RMSE of 72 lights"


def equal_error(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How much longer Mitsuba's sampling and Embree take for the error of 72 lights: interpolated on log-log lines."""

    def time_for(curve: str, error: float, what: str) -> float:
        own = sorted((r["rmse"], r[what]) for r in rows if r["curve"] == curve)
        return float(np.exp(np.interp(np.log(error), *np.log(own).T)))

    made = []
    drawn = list(dict.fromkeys(r["curve"] for r in rows))
    for curve in [c for c in drawn if c in ("lights, maps redrawn", "lights, maps cached", "lights, maps of 256 x 256")]:
        own = [(float(r["at"]), r["rmse"], r["ms"], r["processor_ms"]) for r in rows if r["curve"] == curve]
        count, *values = np.log(own).T
        error, *took = (float(np.exp(np.interp(np.log(72), count, value))) for value in values)
        for rival in [c for c in drawn if c.startswith(("Mitsuba", "Embree"))]:
            ratios = {what: time_for(rival, error, what) / own for what, own in zip(("ms", "processor_ms"), took, strict=True)}
            made.append({"map": rows[0]["map"], "curve": EQUAL, "at": f"{rival} / {curve}", **ratios, "rmse": error})
    return made


def triangles(scene: Scene) -> str:
    return f"{sum(len(mesh.geometry.triangles) for mesh in scene.meshes):,}"


def save(figure: Any, rows: list[dict[str, Any]], out: Path, name: str, note: str) -> None:
    import csv

    caption = f"{note}   python -m bench.renderer_accuracy {name}   {machine()}"
    figure.text(0.01, 0.004, caption, fontsize=7, color="0.35")
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
    parser.add_argument("charts", nargs="*", help="of figure6, time; none: both")
    parser.add_argument("--curves", nargs="+", help="of the chart time, those with one of these texts in their names")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "charts")
    asked = parser.parse_args()
    mitsuba_picture.start()
    with Progress() as progress:
        if not asked.charts or "figure6" in asked.charts:
            figure6(asked.out, progress)
        if not asked.charts or "time" in asked.charts:
            times(asked.out, progress, asked.curves)


if __name__ == "__main__":
    main()
