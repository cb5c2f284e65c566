"""What near lights cost in pictures of the bundled scene, and what a picture loses that has no time for all.

    python -m bench.near_light_costs [--counts 1,16,64,256] [--shadows rays|maps] [--size 640x480] [--pictures FOLDER]
    python -m bench.near_light_costs --fewer

For each count of lamps the processor's time for a picture of a file (4 samples a pixel, one bounce), for a live frame when nothing is
cached and for one when all is, without a limit: of all cores together, which a busy machine changes least. Then live frames of 100 ms,
whose lamps turn about the table by TURN_RAD each: their time by the clock, how many lamps they draw, and of the last one the median
relative error, the relative RMSE and the light against all lamps. Medians; the load average says how busy the machine was. --pictures
writes the file's picture, the live one of all lamps and the one in time, side by side.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from vemlight.light.images import write_png
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.frame_budget import MIN_LIGHTS
from vemlight.renderer.frame_plan import initial_state
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.output.tonemap import adapt, tone_mapped
from vemlight.renderer.passes.near_lights.near_light_plan import near_of, strongest_first, with_joined
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

TURN_RAD = 0.005  # a frame: 1 cm at 2 m, which is beyond what layers are kept for
TARGET_MS = 100.0
FRAMES = 12


def lamps(count: int, turn_rad: float = 0.0) -> NearLightSet:
    """Balls of 3 to 10 cm about the table, 1 to 3 m away and up to 3 m high, of like strength within a factor of 4; together 10 W/sr."""
    rng = np.random.default_rng(count)
    turn, away, height = rng.uniform(0, 2 * np.pi, count) + turn_rad, rng.uniform(1, 3, count), rng.uniform(1, 3, count)
    at = np.stack([away * np.cos(turn), away * np.sin(turn), height], axis=-1)
    intensity = rng.uniform(0.5, 2.0, (count, 1)) * rng.uniform(0.7, 1.0, (count, 3))
    return NearLightSet.of(np.arange(count), at, 10 * intensity / intensity.sum(axis=0), rng.uniform(0.03, 0.1, count), np.zeros(count))


def settings_of(options: argparse.Namespace, frame_ms: float) -> Settings:
    return Settings(width=options.size[0], height=options.size[1], shadows=options.shadows, frame_ms=frame_ms)


def still(options: argparse.Namespace, near: NearLightSet) -> tuple[float, np.ndarray]:
    """Seconds of the processor that a picture of a file takes once its shaders are compiled, and the picture."""
    sequence = FrameSequence(Renderer(load_scene(None), settings_of(options, 0.0), 4))
    sequence.render(LightSet.none(), near=lamps(1))
    began_s = time.process_time()
    picture = sequence.render(LightSet.none(), near=near)
    took_s = time.process_time() - began_s
    sequence.release()
    return took_s, picture


def live(options: argparse.Namespace, near: NearLightSet) -> tuple[float, float, np.ndarray]:
    """Milliseconds of the processor for a live frame without a limit when nothing is cached, when all is, and the last picture."""
    sequence = FrameSequence(Renderer(load_scene(None), settings_of(options, 1e6)))
    times: dict[bool, list[float]] = {False: [], True: []}
    for frame in range(2 * 4):
        cached = frame % 2 == 1
        if not cached:
            sequence.state = initial_state(sequence.renderer.setup)
        began_s = time.process_time()
        picture = sequence.render(LightSet.none(), near=near)
        times[cached].append((time.process_time() - began_s) * 1e3)
    sequence.release()
    return float(np.median(times[False][1:])), float(np.median(times[True][1:])), picture


def in_time(options: argparse.Namespace, count: int) -> tuple[float, int, np.ndarray]:
    """Milliseconds of live frames of TARGET_MS under lamps that turn, how many are drawn at the end, and the last picture."""
    sequence = FrameSequence(Renderer(load_scene(None), settings_of(options, TARGET_MS)))
    times = []
    for frame in range(2 * FRAMES):
        near = lamps(count, TURN_RAD * (frame - 2 * FRAMES + 1))
        began_s = time.perf_counter()
        picture = sequence.render(LightSet.none(), near=near)
        times.append((time.perf_counter() - began_s) * 1e3)
    drawn = len(sequence.plan.lit_by.near.ids)
    sequence.release()
    return float(np.median(times[FRAMES:])), drawn, picture


def errors(picture: np.ndarray, wanted: np.ndarray) -> str:
    """Median relative error of the pixels that are lit, relative RMSE and light of a picture over those of another."""
    a, b = (each[..., :3].astype(np.float64).mean(axis=-1) for each in (picture, wanted))
    lit = b > 0
    median, rmse = np.median(np.abs(a - b)[lit] / b[lit]), np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2))
    return f"{median:6.3f} {rmse:5.2f} {a.mean() / b.mean():6.2f}"


def fewer(options: argparse.Namespace, count: int) -> None:
    """Prints what MIN_LIGHTS of the lamps err by, with the others' light and without, where there is no bounce."""
    settings = Settings(width=options.size[0], height=options.size[1], shadows=options.shadows, bounces=0)
    sequence = FrameSequence(Renderer(load_scene(None), settings))
    near, placed = strongest_first(lamps(count), sequence.state.placed), sequence.state.placed
    whole = sequence.render(LightSet.none(), near=near)
    for words, few in (
        ("with the others' light", with_joined(near, MIN_LIGHTS, placed)),
        ("without it", near_of(near, np.arange(MIN_LIGHTS))),
    ):
        print(f"{MIN_LIGHTS} of {count:3}: {errors(sequence.render(LightSet.none(), near=few), whole)} {words}", flush=True)
    sequence.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", type=lambda text: [int(part) for part in text.split(",")], default=[1, 16, 64, 256])
    parser.add_argument("--shadows", choices=("rays", "maps"), default="rays")
    parser.add_argument("--size", type=lambda text: [int(part) for part in text.split("x")], default=[640, 480])
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--fewer", action="store_true", help="only what the fewest lamps err by, with the others' light and without")
    options = parser.parse_args()
    if options.fewer:
        print("lamps       error  RMSE  light")
        for count in options.counts:
            fewer(options, count)
        return
    print("lamps  file s  live anew ms  cached ms  in 100 ms: ms  drawn  error  RMSE  light  load")
    for count in options.counts:
        near = lamps(count)
        took_s, exact = still(options, near)
        anew_ms, cached_ms, whole = live(options, near)
        frame_ms, drawn, picture = in_time(options, count)
        costs = f"{count:5} {took_s:7.2f} {anew_ms:13.0f} {cached_ms:10.0f} {frame_ms:14.0f} {drawn:6}"
        print(f"{costs} {errors(picture, whole)} {os.getloadavg()[0]:5.1f}", flush=True)
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
            eye = adapt(None, exact, 0.0)
            beside = np.concatenate([tone_mapped(each, eye, 0.0)[..., :3] for each in (exact, whole, picture)], axis=1)
            write_png(options.pictures / f"{options.shadows}_{count}.png", beside)


if __name__ == "__main__":
    main()
