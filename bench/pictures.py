"""The renderer beside Mitsuba 3 and Embree on ten scenes under eight maps: error, FLIP and time, and the pictures side by side.

    VEMLIGHT_DATA=FOLDER python -m bench.pictures [--out FOLDER] [--scenes NAME ...] [--maps NAME ...] [--bounces 0 1] [--cores N]

A pair of scene and map is kept in OUT/pairs once it is done, so the command goes on where it was stopped, and a part may be run alone. Each
run ends with OUT/pictures.csv and OUT/index.html of all pairs that are there. Half of the scenes (ten_scenes.KEPT_ASIDE) and half of the
maps are kept aside while anything is tuned, and named so.

The truth is Mitsuba's, with so many paths that its own noise is below a fifth of the least error of the pair, or with MOST_PATHS, which is
said. Times are of the pictures whose errors they stand beside, with as many samples, of all cores together, lights moving in each frame.
Mitsuba renders by its own integrators in C++: direct light by samples of the map, of the surface, and of both (power heuristic), of which
the best counts; one bounce by its path tracer. Embree traces the same lights as here, with their extents. Needs the extra `bench` and a
libLLVM newer than 15.
"""

import argparse
import csv
import html
import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import drjit as dr  # pyright: ignore[reportMissingImports]
import numpy as np
from rich.progress import Progress

from bench import ten_scenes
from bench.accuracy.maps import KINDS, maps
from bench.evaluation import read_source
from bench.renderer_accuracy import Timed, errors, timed
from bench.rivals import mitsuba_picture
from vemlight.commands.chart import machine
from vemlight.files import written_whole
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.images import read_radiance, write_exr
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import latlong_directions, rotation_xyz
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.output.tonemap import adapt, tone_mapped
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import Scene
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Renderer as Settings
from vemlight.settings import Sampler

SAMPLES = 4  # of a pixel, as `vemlight render` has them; Embree, too
LIGHTS: dict[str, dict[str, Any]] = {
    "default": {},
    "16 soft": {"count": 16, "soft": True},
    "72 points": {"count": 72, "soft": False},
    "300 points": {"count": 300, "soft": False},
}
PATHS = (1, 4, 16, 64, 256)  # of a pixel, Mitsuba's
CHUNK_PATHS, MOST_PATHS = 256, 16_384  # of the truth: how many are added at a time, and at most
NOISE = 1 / 5  # of the least error: that of the truth changes it by 2 %
SETTLED = 8  # frames in which lights find their places on a still map
TURN_DEG = 0.5  # a frame: no map and no ray is kept
STEPS = 5  # frames of which the median time counts, after two that do not
PHOTOS_ASIDE = ("venice_sunset", "st_peters_square_night")


class Setup(NamedTuple):
    """How a pair is rendered; kept with it, and a pair of another setup is rendered anew."""

    width: int
    height: int
    bounces: int
    cores: int
    most_paths: int

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height


Triple = tuple[float, float, float]


def disc_map(lamps: list[tuple[Triple, float, Triple]], sky: Triple) -> np.ndarray:
    """A lat-long map (512, 1024, 3) float32 of discs (direction, degrees across, radiance) before a sky that brightens to the horizon."""
    directions = latlong_directions(512, 1024)
    image = np.array(sky) * (1.5 - np.abs(directions[..., 2:]))
    for direction, degrees, radiance in lamps:
        inside = directions @ (np.array(direction) / np.linalg.norm(direction)) > np.cos(np.radians(degrees / 2))
        image = np.where(inside[..., None], radiance, image)
    return image.astype(np.float32)


PROCEDURAL = {
    "low sun": lambda: disc_map([((-0.8, -0.5, 0.14), 0.9, (9e3, 6e3, 3e3))], (0.2, 0.25, 0.4)),
    "three lamps": lambda: disc_map(
        [((0.5, -0.7, 0.8), 12.0, (40, 36, 30)), ((-0.9, 0.1, 0.5), 7.0, (50, 55, 70)), ((0.1, 0.9, 0.3), 20.0, (6, 7, 8))],
        (0.01, 0.01, 0.01),
    ),
}


def the_maps(out: Path) -> dict[str, tuple[Path, bool]]:
    """The maps by name, each with whether it is kept aside: photographs of VEMLIGHT_DATA, and those made here in `out`."""
    found = {path.stem: path for path in maps()}
    chosen = {kind: (path, False) for name, kind in KINDS.items() for stem, path in found.items() if stem.startswith(name)}
    chosen |= {name: (path, True) for name in PHOTOS_ASIDE for stem, path in found.items() if stem.startswith(name)}
    for name, make in PROCEDURAL.items():
        path = out / "maps" / f"{name.replace(' ', '_')}.exr"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_exr(path, make())
        chosen[name] = path, True
    return chosen


def lights_of(path: Path, **settings: Any) -> tuple[LightSet, EnvironmentMap]:
    """What the sampler makes of a still map, and the map as gloss reflects it."""
    source, sampler = read_source(path), Sampler(filter="none", **settings)
    state, lights = initial_state(), LightSet.none()
    for k in range(SETTLED):
        state, lights, _ = step(sampler, state, SamplerInput(source.polar, "hemisphere", k / 25, source.bright_cells))
    return lights, EnvironmentMap(source.polar, "hemisphere", source.bright_cells)


def turned(lights: LightSet, degrees: float) -> LightSet:
    """The lights, with their extents, turned about z."""
    turn = rotation_xyz((0.0, 0.0, degrees))
    covariances = lights.covariances
    if covariances is not None:
        full = turn @ covariances.astype(np.float64)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]] @ turn.T
        covariances = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return LightSet.of(lights.ids, lights.directions @ turn.T, lights.irradiance, covariances)


def truth_of(world: Any, method: str, pictures: list[np.ndarray], most_paths: int) -> tuple[np.ndarray, float, int]:
    """Mitsuba's picture, its own noise (RMSE over the root mean square, of two halves), and its paths a pixel.

    pictures: that are to be compared with it; it is good enough where its noise is NOISE of the least of their errors.
    """
    halves, paths, noise, least = [np.zeros(0), np.zeros(0)], 0, np.inf, 0.0
    while not paths or (noise > NOISE * least and paths < most_paths):
        for k in (0, 1):
            made = mitsuba_picture.picture(world, CHUNK_PATHS // 2, seed=1000 + 2 * paths + k, method=method).astype(np.float64)
            halves[k] = halves[k] + made if paths else made
        paths += CHUNK_PATHS
        truth = (halves[0] + halves[1]) / (2 * paths / CHUNK_PATHS)
        noise = float(np.sqrt(np.mean((halves[0] - halves[1]) ** 2) / np.mean((halves[0] + halves[1]) ** 2)))
        least = min(float(np.sqrt(np.mean((picture - truth) ** 2) / np.mean(truth**2))) for picture in pictures)
    return truth.astype(np.float32), noise, paths


def frames_of(render: Any, lights: LightSet) -> Timed:
    """A picture whose lights turn in each frame and come to rest in the last."""
    work = lambda frame: render(turned(lights, TURN_DEG * (frame - STEPS + 1)), frame)  # noqa: E731
    return timed(work, STEPS)


def measured(scene: Scene, path: Path, setup: Setup) -> dict[str, Timed]:
    """Every picture of a pair with its time, by its name."""
    made: dict[str, Timed] = {}
    world = mitsuba_picture.mitsuba_scene(scene, setup.size, read_radiance(path)[0])
    settings = Settings(width=setup.width, height=setup.height, light_regions=0, bounces=setup.bounces)
    ours = FrameSequence(Renderer(scene, settings, SAMPLES))
    traced = mitsuba_picture.TracedLights(world, setup.size)
    for name, kind in LIGHTS.items():
        lights, environment = lights_of(path, **kind)
        made[f"vemlight, {name}"] = frames_of(lambda lit, _, around=environment: ours.render(lit, around)[..., :3].copy(), lights)
        if not setup.bounces:
            made[f"Embree, {name}"] = frames_of(lambda lit, frame: traced.picture(lit, SAMPLES, frame + 2), lights)
    ours.release()
    for method in ("path",) if setup.bounces else ("emitter", "bsdf", "mis"):
        for paths in PATHS:
            made[f"Mitsuba {method}, {paths}"] = timed(
                lambda frame, n=paths, m=method: mitsuba_picture.picture(world, n, frame + 2, method=m), STEPS if paths < 16 else 2
            )
    return made


def stem_of(scene_name: str, map_name: str, bounces: int) -> str:
    """The name of a pair's files."""
    return f"{scene_name}__{map_name.replace(' ', '_')}__{bounces}"


def pair(scene_name: str, map_name: str, path: Path, setup: Setup, out: Path) -> None:
    """Renders a pair and keeps its rows and its strip of pictures."""
    scene = (ten_scenes.TUNED | ten_scenes.KEPT_ASIDE)[scene_name]()
    made = measured(scene, path, setup)
    world = mitsuba_picture.mitsuba_scene(scene, setup.size, read_radiance(path)[0])
    pictures = [timing.picture for timing in made.values()]
    truth, noise, paths = truth_of(world, "path" if setup.bounces else "mis", pictures, setup.most_paths)
    rows = [
        {"picture": name, "ms": timing.ms, "processor_ms": timing.processor_ms, **errors(timing.picture, truth)._asdict()}
        for name, timing in made.items()
    ]
    stem = stem_of(scene_name, map_name, setup.bounces)
    (out / "pairs").mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out / "pairs" / f"{stem}.png"), strip(truth, made, rows)[..., ::-1])
    kept = {"setup": setup._asdict(), "scene": scene_name, "map": map_name, "noise": noise, "paths": paths, "rows": rows}
    with written_whole(out / "pairs" / f"{stem}.json") as part:
        part.write_text(json.dumps(kept))


def strip(truth: np.ndarray, made: dict[str, Timed], rows: list[dict[str, Any]]) -> np.ndarray:
    """The truth, ours, Embree's and the best of Mitsuba's that took no longer than ours, side by side, tone-mapped as the truth is."""
    own = next(row for row in rows if row["picture"] == "vemlight, default")
    rivals = [r for r in rows if r["picture"].startswith("Mitsuba") and r["processor_ms"] <= own["processor_ms"]]
    best = [min(rivals, key=lambda row: row["rmse"])["picture"]] if rivals else []
    shown = ["vemlight, default", "vemlight, 72 points", "Embree, default", *best]
    pictures = {"truth": truth} | {name: made[name].picture for name in shown if name in made}
    whole = {name: np.concatenate([picture, np.ones_like(picture[..., :1])], axis=-1) for name, picture in pictures.items()}
    eye, tiles = adapt(None, whole["truth"], 0.0), []
    for name, picture in whole.items():
        tile = np.ascontiguousarray(tone_mapped(picture.astype(np.float32), eye, 0.0)[..., :3])
        for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(tile, name, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, width, cv2.LINE_AA)
        tiles.append(tile)
    return np.hstack(tiles)


# --- what all pairs say ----------------------------------------------------------------------------------------------------------------


def time_for(rows: list[dict[str, Any]], error: float) -> float:
    """Processor ms in which a rival's rows reach an error: on log-log lines; inf beyond the last."""
    own = sorted((r["rmse"], r["processor_ms"]) for r in rows)
    if not own or error < own[0][0]:
        return float("inf")
    return float(np.exp(np.interp(np.log(error), *np.log(own).T)))


def summary(kept: dict[str, Any]) -> dict[str, Any]:
    """A pair in a line: errors of ours, the best Mitsuba and its time for our error over ours; more than 1: ours is faster."""
    rows, aside = kept["rows"], kept["scene"] in ten_scenes.KEPT_ASIDE
    own = {row["picture"].removeprefix("vemlight, "): row for row in rows if row["picture"].startswith("vemlight")}
    methods = {row["picture"].split(",")[0] for row in rows if row["picture"].startswith("Mitsuba")}
    line = {"scene": kept["scene"], "map": kept["map"], "bounces": kept["setup"]["bounces"], "scene kept aside": aside}
    for name, row in own.items():
        times = {m: time_for([r for r in rows if r["picture"].startswith(f"{m},")], row["rmse"]) for m in methods}
        best = min(times, key=lambda m: times[m])
        line |= {f"{name}: rmse": row["rmse"], f"{name}: flip": row["flip"], f"{name}: processor_ms": row["processor_ms"]}
        line |= {f"{name}: best rival": best, f"{name}: rival over ours": times[best] / row["processor_ms"]}
        embree = next((r for r in rows if r["picture"] == f"Embree, {name}"), None)
        line[f"{name}: Embree rmse"] = embree["rmse"] if embree else float("nan")
        line[f"{name}: Embree over ours"] = embree["processor_ms"] / row["processor_ms"] if embree else float("nan")
    enough = kept["noise"] <= NOISE * min(row["rmse"] for row in rows)
    return line | {"truth noise": kept["noise"], "truth paths": kept["paths"], "noise small enough": enough}


def page(out: Path, all_maps: dict[str, tuple[Path, bool]]) -> list[dict[str, Any]]:
    """Writes pictures.csv and index.html of all pairs that are there."""
    found = [json.loads(path.read_text()) | {"stem": path.stem} for path in sorted((out / "pairs").glob("*.json"))]
    lines = [summary(kept) | {"map kept aside": all_maps.get(kept["map"], (None, True))[1]} for kept in found]
    if not lines:
        return []
    with written_whole(out / "pictures.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(dict.fromkeys(key for line in lines for key in line)), restval="")
        table.writeheader()
        table.writerows({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in line.items()} for line in lines)
    body = [f"<h1>Pictures beside the truth</h1><p>{html.escape(machine())}; {SAMPLES} samples a pixel; processor time of all cores.</p>"]
    for kept, line in zip(found, lines, strict=True):
        aside = ", ".join(what for what in ("scene", "map") if line[f"{what} kept aside"])
        title = f"{kept['scene']}, {kept['map']}, {kept['setup']['bounces']} bounces{f' (kept aside: {aside})' if aside else ''}"
        rows = "".join(
            f"<tr><td>{html.escape(r['picture'])}</td><td>{r['rmse']:.4f}</td><td>{r['flip']:.4f}</td><td>{r['processor_ms']:.0f}</td></tr>"
            for r in kept["rows"]
        )
        enough = "" if line["noise small enough"] else ", too much for the least errors"
        noise = f"truth: {kept['paths']} paths, noise {kept['noise']:.4f}{enough}"
        body.append(f"<h2>{html.escape(title)}</h2><p>{noise}</p><img src='pairs/{kept['stem']}.png'>")
        body.append(f"<table><tr><th>picture</th><th>RMSE</th><th>FLIP</th><th>processor ms</th></tr>{rows}</table>")
    with written_whole(out / "index.html") as part:
        part.write_text(f"<!doctype html><meta charset=utf-8><title>Pictures</title><body>{''.join(body)}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    scenes = list(ten_scenes.TUNED | ten_scenes.KEPT_ASIDE)
    parser.add_argument("--scenes", nargs="+", choices=scenes, default=scenes)
    parser.add_argument("--maps", nargs="+", help="names, or parts of them; left out: all eight")
    parser.add_argument("--bounces", nargs="+", type=int, choices=(0, 1), default=[0, 1])
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--cores", type=int, default=len(os.sched_getaffinity(0)), help="for ours and for the others alike")
    parser.add_argument("--most-paths", type=int, default=MOST_PATHS)
    parser.add_argument("--out", type=Path, default=Path("pictures"))
    asked = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: asked.cores])  # before anything starts threads
    mitsuba_picture.start()
    dr.set_thread_count(asked.cores)
    every = the_maps(asked.out)
    chosen = {name: path for name, (path, _) in every.items() if not asked.maps or any(part in name for part in asked.maps)}
    width, height = asked.size
    setups = [Setup(width, height, bounces, asked.cores, asked.most_paths) for bounces in asked.bounces]
    todo = [(scene, name, path, setup) for scene in asked.scenes for name, path in chosen.items() for setup in setups]
    with Progress() as progress:
        task = progress.add_task("pairs", total=len(todo))
        for scene_name, map_name, path, setup in todo:
            stem = stem_of(scene_name, map_name, setup.bounces)
            kept = asked.out / "pairs" / f"{stem}.json"
            if not (kept.exists() and json.loads(kept.read_text())["setup"] == setup._asdict()):
                pair(scene_name, map_name, path, setup, asked.out)
            progress.advance(task)
    say(page(asked.out, every))


def say(lines: list[dict[str, Any]]) -> None:
    """Prints geometric means over all pairs, and how often ours is faster than the best of Mitsuba at the same error."""
    for bounces in sorted({line["bounces"] for line in lines}):
        own = [line for line in lines if line["bounces"] == bounces]
        for name in LIGHTS:
            rmse, flip = (np.exp(np.mean(np.log([line[f"{name}: {key}"] for line in own]))) for key in ("rmse", "flip"))
            ahead = sum(line[f"{name}: rival over ours"] > 1 for line in own)
            print(f"{bounces} bounces, {name}: RMSE {rmse:.4f}, FLIP {flip:.4f}; faster than Mitsuba in {ahead} of {len(own)} pairs")


if __name__ == "__main__":
    main()
