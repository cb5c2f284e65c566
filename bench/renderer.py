"""Cost of each pass of the renderer and how it grows; speed and error of cached shadow maps.

    python -m bench.renderer [--out docs/charts] [--frames 15]
    python -m bench.renderer --large            1920 x 1080, 100,000 triangles, 72 and 300 lights, maps of 512 x 512: for a GPU

Writes renderer_passes.csv and .png (cost over lights, triangles and pixels) and renderer_speed.csv (frames a second); --large prints only.
The scene has the size of Havran et al. 2005: 16,206 triangles, 72 lights, 72 maps of 256 x 256, 320 x 240 pixels. Times of passes are
medians and minima of the renderer's timer queries, times of frames of wall time.
"""

import argparse
import csv
import os
import platform
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.frame_plan import initial_state
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.meshes import Geometry, VertexAttributes, bounds, clean_geometry, shape_geometry
from vemlight.renderer.scene.scene import Mesh, Scene, ViewCamera
from vemlight.settings import Renderer as Settings

PASSES = ("shadow maps", "G-buffer", "classes", "lights", "read-back", "whole frame")
LIGHTS = 72


def tube_knot(steps: int, sides: int) -> Geometry:
    """A trefoil knot as a closed tube with 2 steps sides triangles, about 1 m wide."""
    t = np.arange(steps) * (2 * np.pi / steps)
    path = 0.2 * np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=-1)
    along = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    side = np.cross(along, np.array([0.0, 0.0, 1.0]))  # the path is never upright
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    a = np.arange(sides) * (2 * np.pi / sides)
    ring = np.cos(a)[None, :, None] * side[:, None] + np.sin(a)[None, :, None] * np.cross(along, side)[:, None]
    index = np.arange(steps * sides).reshape(steps, sides)
    right, up, both = np.roll(index, -1, 1), np.roll(index, -1, 0), np.roll(np.roll(index, -1, 0), -1, 1)
    quads = [np.stack([index, right, both], axis=-1), np.stack([index, both, up], axis=-1)]
    return clean_geometry(VertexAttributes((path[:, None] + 0.09 * ring).reshape(-1, 3)), np.concatenate([q.reshape(-1, 3) for q in quads]))


def paper_scene(knot: Geometry | None = None) -> Scene:
    """Ground, box, sphere and knot: 2 + 12 + 9,024 + 7,168 triangles unless another knot is given."""
    knot = knot or tube_knot(256, 14)
    specular = (0.1, 0.1, 0.1)
    parts = [
        Mesh("ground", shape_geometry("plane").moved(3 * np.eye(3), np.zeros(3)), Phong((0.6, 0.6, 0.6))),
        Mesh("box", shape_geometry("box").moved(0.4 * np.eye(3), np.array([-0.9, 0.2, 0.4])), Phong((0.2, 0.3, 0.5))),
        Mesh("sphere", shape_geometry("sphere").moved(0.45 * np.eye(3), np.array([0.9, -0.3, 0.45])), Phong((0.5, 0.2, 0.1), specular, 80)),
        Mesh("knot", knot.moved(np.eye(3), np.array([0.1, 0.9, 0.6])), Phong((0.6, 0.5, 0.2), specular, 40)),
    ]
    low, high = bounds([part.geometry for part in parts])
    return Scene(ViewCamera(position=(2.4, -4.0, 2.4), at=(0.0, 0.1, 0.45), fov_y=34.0), tuple(parts), (low + high) / 2, (high - low) / 2)


def sky(count: int, turn: float = 0.0, lowest: float = 0.0) -> LightSet:
    """Equal lights spread evenly over all directions with z above `lowest`, rotated about z by `turn` rad; so are any first of them."""
    k = np.argsort(np.arange(count) * (np.sqrt(5) - 1) / 2 % 1) + 0.5
    directions = direction_from_angles(np.arccos(1 - (1 - lowest) * k / count), k * np.pi * (3 - np.sqrt(5)) + turn)
    return LightSet.of(np.arange(count), directions, np.full((count, 3), np.pi / count))


def passes(scene: Scene, lights: LightSet, settings: Settings, frames: int) -> dict[str, tuple[float, float]]:
    """Cost of each pass when nothing is cached, ms: (median, minimum)."""
    renderer = FrameSequence(Renderer(scene, settings, timed=True))
    rows: dict[str, list[float]] = {name: [] for name in PASSES}
    for frame in range(frames + 2):
        renderer.state = initial_state(renderer.renderer.setup)  # so that the G-buffer is drawn again
        started_s = time.perf_counter()
        renderer.render(lights)
        took = {**renderer.timings.timers_ms, PASSES[-1]: (time.perf_counter() - started_s) * 1e3}
        for name in PASSES if frame >= 2 else ():
            rows[name].append(took[name])
    renderer.release()
    return {name: (float(np.median(times)), float(np.min(times))) for name, times in rows.items()}


def growth(frames: int) -> Iterator[tuple[str, int, str, float, float]]:
    """Rows (what grows, how much, pass, median ms, minimum ms)."""
    usual = Settings(width=320, height=240, shadow_map=256)
    for count in (8, 24, 72, 144, 288):
        for name, (median, least) in passes(paper_scene(), sky(count), usual, frames).items():
            yield "lights", count, name, median, least
    for steps in (24, 80, 256, 800, 1600):
        scene = paper_scene(tube_knot(steps, steps // 18 + 3))
        size = sum(len(mesh.geometry.triangles) for mesh in scene.meshes)
        for name, (median, least) in passes(scene, sky(LIGHTS), usual, max(frames // 3, 3)).items():
            yield "triangles", size, name, median, least
    for width in (80, 160, 320, 640):
        settings = Settings(width=width, height=width * 3 // 4, shadow_map=256)
        for name, (median, least) in passes(paper_scene(), sky(LIGHTS), settings, max(frames // 2, 3)).items():
            yield "pixels", width * width * 3 // 4, name, median, least
    for regions in (0, 12, 24, 48, 100):
        settings = Settings(width=320, height=240, shadow_map=256, light_regions=regions)
        for name, (median, least) in passes(paper_scene(), sky(LIGHTS, lowest=-1.0), settings, frames).items():
            yield "regions, lights from all sides", regions, name, median, least


def speed(frames: int) -> Iterator[tuple[float, float, float, float, int, int, float]]:
    """Rows (target ms or 0, degrees a frame, median ms, minimum ms, lights drawn, texels of a map, relative RMSE against all of them).

    In a sky of equal lights all maps have one resolution: 256 texels where it is given, 64 by the lights' power.
    """
    for texels in (256, None):
        yield from speed_with(texels, frames)


def speed_with(texels: int | None, frames: int) -> Iterator[tuple[float, float, float, float, int, int, float]]:
    """The rows of `speed` for one setting of `shadow_map`."""
    settings = Settings(width=320, height=240, shadow_map=texels, light_regions=0)
    exact = FrameSequence(Renderer(paper_scene(), settings))
    for target_ms in (0.0, 1e4, 40.0, 20.0):  # nothing cached, everything that changed, within the target
        for degrees in (0.0, 0.05, 0.5, 5.0):
            renderer = FrameSequence(Renderer(paper_scene(), msgspec.structs.replace(settings, frame_ms=target_ms)))
            times, errors = [], []
            for frame in range(2 * frames):
                lights = sky(LIGHTS, np.radians(degrees) * frame)
                started = time.perf_counter()
                picture = renderer.render(lights)
                times.append((time.perf_counter() - started) * 1e3)
                truth = exact.render(lights)
                errors.append(float(np.sqrt(np.mean((picture - truth) ** 2) / np.mean(truth**2))))
            drawn, sizes = len(renderer.plan.lights.ids), renderer.plan.resolutions
            renderer.release()
            half = float(np.median(times[frames:])), float(np.min(times[frames:]))
            yield target_ms, degrees, *half, drawn, int(np.median(sizes)), float(np.mean(errors[frames:]))
    exact.release()


def large(frames: int) -> None:
    """Prints frames a second of a scene for a GPU, from timer queries and from the clock."""
    scene = paper_scene(tube_knot(1312, 35))
    size = sum(len(mesh.geometry.triangles) for mesh in scene.meshes)
    for count in (LIGHTS, 300):
        for name, target_ms, degrees in (("all maps drawn", 0.0, 1.0), ("slow lights", 1e4, 0.02), ("still lights", 1e4, 0.0)):
            renderer = FrameSequence(Renderer(scene, Settings(width=1920, height=1080, shadow_map=512, frame_ms=target_ms), timed=True))
            drawn, whole = [], []
            for frame in range(frames + 5):
                lights = sky(count, np.radians(degrees) * frame)
                started_s = time.perf_counter()
                renderer.render(lights)
                whole.append((time.perf_counter() - started_s) * 1e3)
                spent_ms = renderer.timings.timers_ms
                drawn.append(sum(ms for what, ms in spent_ms.items() if what != "read-back"))
            drawn_ms, whole_ms = float(np.median(drawn[5:])), float(np.median(whole[5:]))
            what = f"{renderer.renderer.info}; {size:,} triangles, {count} lights, {name}"
            rates = f"drawn in {drawn_ms:.2f} ms, {1e3 / drawn_ms:.0f} a second; read back too {whole_ms:.2f} ms, {1e3 / whole_ms:.0f}"
            print(f"{what}: {rates}", flush=True)
            renderer.release()


def chart(rows: list[tuple[str, int, str, float, float]], caption: str, path: Path) -> None:
    """One chart for each quantity that grows, one line a pass."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    kinds = list(dict.fromkeys(row[0] for row in rows))
    figure, axes = pyplot.subplots(1, len(kinds), figsize=(4.2 * len(kinds), 4.2), sharey=True)
    for axis, kind in zip(axes, kinds, strict=True):
        for name in PASSES:
            points = [(size, least) for grows, size, what, _, least in rows if (grows, what) == (kind, name)]
            axis.plot(*zip(*points, strict=True), marker="o", markersize=3, label=name)
        axis.set(xlabel=kind, yscale="log", xscale="symlog" if kind.startswith("regions") else "log")
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("ms, least of the frames")
    axes[0].legend(fontsize=8)
    figure.suptitle(caption, fontsize=8, y=0.02)
    figure.tight_layout(rect=(0, 0.04, 1, 1))
    figure.savefig(path, dpi=110)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, default=Path("docs/charts"))
    options.add_argument("--frames", type=int, default=15)
    options.add_argument("--large", action="store_true")
    given = options.parse_args()
    if given.large:
        return large(given.frames)
    given.out.mkdir(parents=True, exist_ok=True)
    probe = Renderer(paper_scene(), Settings(width=8, height=8))
    machine = f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {probe.info}"
    probe.release()
    rows = []
    for row in growth(given.frames):
        rows.append(row)
        print(f"{row[0]:32} {row[1]:9d}  {row[2]:12} {row[3]:8.1f} ms (least {row[4]:.1f})", flush=True)
    with (given.out / "renderer_passes.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("grows", "size", "pass", "median_ms", "least_ms"), *rows])
    chart(rows, f"python -m bench.renderer; 16,206 triangles, 72 lights, maps of 256 x 256, 320 x 240 unless stated otherwise; {machine}",
          given.out / "renderer_passes.png")
    table = []
    for row in speed(given.frames):
        table.append(row)
        what = "target {:.0f} ms, {:.2f} degrees a frame: {:.1f} ms (least {:.1f}), {} lights, {} texels, error {:.4f}"
        print(what.format(*row), flush=True)
    with (given.out / "renderer_speed.csv").open("w", newline="") as file:
        header = ("target_ms", "degrees_a_frame", "median_ms", "least_ms", "lights", "texels", "relative_rmse")
        csv.writer(file).writerows([header, *table])


if __name__ == "__main__":
    main()
