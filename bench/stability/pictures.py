"""The same sequences as pictures: how far each method's clip of a rendered scene is from that under the map itself, by judges of others.

    python -m bench.stability.pictures [--frames 24] [--methods NAME ...] [--out docs/charts]

Writes stability_pictures.csv, a row for each method and clip, and prints a table: relative RMSE, mean HDR-FLIP (Andersson et al. 2021), RMS
change of the difference from frame to frame, and, where the package cvvdp is installed, the quality of the clip in JOD by ColorVideoVDP
(Mantiuk et al. 2024; 10 is no difference, 1 less is what three of four people see). Every set of lights is drawn by the same renderer with
direct light alone. The truth is the map's brightest pixels and cells themselves, each a light. Needs the extra `bench`. A run that was
cut off goes on with the next clip when the same command is given again.
"""

import argparse
import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import flip_evaluator  # pyright: ignore[reportMissingImports]
import numpy as np

from bench.evaluation import Source, points_of
from bench.sequences import Frame, world_from_latlong
from bench.stability.__main__ import NAMES, OUT, inputs, lights_of
from bench.stability.jod import jod
from bench.stability.moving import MOVING
from bench.stability.progress import Unfinished, show_table
from bench.stability.recipes import RECIPES
from tests.support.scenes import SHAPES
from vemlight.files import written_whole
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.settings import Renderer as Settings

CLIPS = (("clear sky", "day"), ("clear sky", "clouds"), ("room", "hand-held"), ("night", "rotation"))
SIZE, SAMPLES, COUNT = (160, 120), 1, 64  # the same place in each pixel for all: what differs is the light
TRUTH_LIGHTS = 1500  # the strongest points of the map; all others join the nearest cell of a coarse grid
COARSE = (24, 48)  # rows and columns of that grid: 4 degrees, for what is hardly brighter than what is around it


def lights_of_source(source: Source) -> LightSet:
    """The map as lights: its strongest points one by one, the rest by cells of a coarse grid, each at its flux's direction."""
    points = points_of(source)
    power = luminance_from_rgb(points.irradiance)
    order = np.argsort(-power, kind="stable")
    single, rest = order[:TRUTH_LIGHTS], order[TRUTH_LIGHTS:]
    d = points.directions[rest]
    row = np.minimum((np.arccos(np.clip(d[:, 2], 0, 1)) / (np.pi / 2) * COARSE[0]).astype(int), COARSE[0] - 1)
    column = ((np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) % 1.0) * COARSE[1]).astype(int) % COARSE[1]
    cell = row * COARSE[1] + column
    cells = COARSE[0] * COARSE[1]
    flux = np.stack([np.bincount(cell, points.irradiance[rest, c], cells) for c in range(3)], axis=-1)
    middle = np.stack([np.bincount(cell, power[rest] * d[:, c], cells) for c in range(3)], axis=-1)
    lit = flux.any(axis=1)
    directions = np.concatenate([points.directions[single], middle[lit] / np.linalg.norm(middle[lit], axis=1, keepdims=True)])
    irradiance = np.concatenate([points.irradiance[single], flux[lit]])
    return LightSet.of(np.arange(len(directions)), directions, irradiance)


def clip_of(scene: Scene, lights: Sequence[LightSet]) -> np.ndarray:
    """The scene under each of the lights in turn, (frames, height, width, 3) float32."""
    sequence = FrameSequence(Renderer(scene, Settings(width=SIZE[0], height=SIZE[1], frame_ms=0.0, bounces=0), SAMPLES))
    pictures = [sequence.render(each)[..., :3].copy() for each in lights]
    sequence.release()
    return np.stack(pictures)


def judged(clip: np.ndarray, truth: np.ndarray, fps: float) -> dict[str, float]:
    """How far a clip is from the true one."""
    mean = float(truth.mean())
    flip = [float(flip_evaluator.evaluate(t / mean / 5, c / mean / 5, "HDR")[1]) for c, t in zip(clip, truth, strict=True)]
    change = np.diff(clip - truth, axis=0)
    return {
        "rmse": float(np.sqrt(np.mean((clip - truth) ** 2) / np.mean(truth**2))),
        "flip": float(np.mean(flip)),
        "change": float(np.sqrt(np.mean(change**2)) / np.sqrt(np.mean(truth**2))),
        "jod": jod(clip / mean, truth / mean, fps),
    }


def rows_of(map_name: str, sequence: str, count: int, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """One row for each method of these names."""
    frames: list[Frame] = [*MOVING[sequence](world_from_latlong(RECIPES[map_name]()))][:count]
    scene = load_scene(SHAPES)
    truth = clip_of(scene, [lights_of_source(frame.source) for frame in frames])
    for name in names:
        lights, _ = lights_of(name, COUNT, inputs(frames))
        yield {"method": name, "map": map_name, "sequence": sequence} | judged(clip_of(scene, lights), truth, 25.0)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The mean over the clips of each method, as Markdown."""
    keys = ("rmse", "flip", "change", "jod")
    lines = [["", "relative RMSE", "HDR-FLIP", "change a frame", "JOD"]]
    for name in dict.fromkeys(row["method"] for row in rows):
        means = [float(np.mean([float(row[key]) for row in rows if row["method"] == name])) for key in keys]
        lines.append([name, *("" if math.isnan(value) else f"{value:.3g}" for value in means)])
    head, *rest = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([head, "|" + "---|" * len(lines[0]), *rest])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--methods", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--out", type=Path, default=OUT)
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    path = chosen.out / "stability_pictures.csv"
    unfinished = Unfinished(chosen.out / "stability_pictures_unfinished.json", [chosen.frames, chosen.methods])
    rows: list[dict[str, Any]] = []
    if unfinished.done:
        with open(path, newline="") as file:
            rows = [{**row} for row in csv.DictReader(file)]
    for clip in unfinished.left(CLIPS):
        for row in rows_of(*clip, chosen.frames, chosen.methods):
            rows.append(row)
            print(*(f"{value:.3f}" if isinstance(value, float) else value for value in row.values()), flush=True)
        with written_whole(path) as part, open(part, "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
        unfinished.add(clip)
    text = table(rows)
    print(text)
    if chosen.out == OUT:
        show_table("pictures", text)
    unfinished.finish()


if __name__ == "__main__":
    main()
