"""The time of a frame of tracked lights on every map: at rest, turning, and held by hand."""

import time
from itertools import islice
from pathlib import Path

import numpy as np
from rich.progress import Progress

from bench.accuracy.drawing import write_table
from bench.accuracy.maps import maps
from bench.sequences import FPS, Frame, World, hand_held, rotation, turned, world_from_latlong
from vemlight.light.images import read_radiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler

COUNTS = (64, 300)
FRAMES = 24
FIRST = 4  # frames that are not counted: lights are found in the first, with more Lloyd steps
RUNS = 5  # over the same frames: the shortest time of each frame counts, what is longer is other load on the machine


def frame_times(out: Path, progress: Progress) -> None:
    """Milliseconds a frame, median and slowest, of each sequence on each map."""
    rows, paths = [], maps()
    task = progress.add_task("frame times", total=len(paths))
    for path in paths:
        for name, frames in _sequences(world_from_latlong(read_radiance(path)[0])).items():
            for count in COUNTS:
                least = _least_ms(frames, count)
                times = {"ms": float(np.median(least)), "worst_ms": float(least.max())}
                rows.append({"map": path.stem, "sequence": name, "lights": count, **times})
        progress.advance(task)
    write_table(rows, out, "frame_times")


def _sequences(world: World) -> dict[str, list[Frame]]:
    source = turned(world, np.eye(3))
    return {
        "still": [Frame(k / FPS, source, source.polar) for k in range(FRAMES)],
        "rotation": [*islice(rotation(world), FRAMES)],
        "hand-held": [*islice(hand_held(world), FRAMES)],
    }


def _least_ms(frames: list[Frame], count: int) -> np.ndarray:
    """Processor time (FRAMES - FIRST,) of the whole step, in the quickest of RUNS for each frame."""
    wanted = Sampler(count=count)
    taken = np.empty((RUNS, len(frames)))
    for run in taken:
        state = initial_state()
        for k, frame in enumerate(frames):
            begin = time.process_time()
            state, _, _ = step(wanted, state, SamplerInput(frame.seen, "hemisphere", frame.time_s, frame.source.bright_cells))
            run[k] = 1e3 * (time.process_time() - begin)
    return taken.min(axis=0)[FIRST:]
