"""What an export takes beside writing the same lights as JSON, in processor time and memory.

`python -m bench.exports [--frames 10000] [--lights 72]`. Lights wander, and each tenth frame one is born anew, as points and with extents.
An export is the whole command, with its start and the reading, which is nearly all of glTF of the last frame; without that: what is
left of the others. Of RUNS of each, in turn with writing the JSON, the shortest counts.
"""

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vemlight.light.light_set import LightSet, lights_json, lights_row

RUNS = 3
UNMEASURED: tuple[float, int] = np.inf, 0  # seconds, MB
FPS = 30
OUTPUTS = {"usda": ["--usd"], "usdc": ["--usd"], "mcap": ["--mcap"], "gltf": ["--frame", "{last}", "--gltf"]}


def wandering(frames: int, count: int, soft: bool) -> Iterator[LightSet]:
    random = np.random.default_rng(1)
    directions, born = random.normal(size=(count, 3)), count
    ids, irradiance = np.arange(count), random.random((count, 3)) * 10.0 ** random.integers(-2, 2, (count, 1))
    for k in range(frames):
        directions = directions + 0.003 * random.normal(size=(count, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        irradiance = irradiance * np.exp(0.01 * random.normal(size=(count, 3)))
        if k % 10 == 9:
            ids[random.integers(count)], born = born, born + 1
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        spread = (across * random.uniform(0, 0.05, (count, 1, 1)))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        yield LightSet.of(ids.copy(), directions, irradiance, spread if soft else None)


def written(path: Path, frames: int, count: int, soft: bool) -> float:
    """Processor time of writing the file, s."""
    sets = list(wandering(frames, count, soft))
    began_s = time.process_time()
    with open(path, "wb") as file:
        for k, lights in enumerate(sets):
            file.write(lights_json(lights_row(lights, k, k / FPS, "sphere")) + b"\n")
    return time.process_time() - began_s


def exported(path: Path, options: list[str], out: Path) -> tuple[float, int]:
    """Processor time, s, and the most memory, MB, of the command."""
    process = subprocess.Popen([sys.executable, "-m", "vemlight", "export", str(path), *options, str(out)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"vemlight export ended with {process.returncode}")
    return usage.ru_utime + usage.ru_stime, round(usage.ru_maxrss * 1024 / 1e6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--lights", type=int, default=72)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "lights.jsonl"
        for soft in (False, True):
            json_s, best = np.inf, dict.fromkeys(OUTPUTS, UNMEASURED)
            for _ in range(RUNS):
                # In a process of its own, since a command's memory begins with that of whoever starts it.
                with multiprocessing.get_context("spawn").Pool(1) as pool:
                    json_s = min(json_s, pool.apply(written, (path, given.frames, given.lights, soft)))
                for suffix, template in OUTPUTS.items():
                    options = [option.format(last=given.frames - 1) for option in template]
                    best[suffix] = min(best[suffix], exported(path, options, Path(name) / f"out.{suffix}"))
            print(f"{given.frames} frames of {given.lights} {'soft lights' if soft else 'points'}, load {os.getloadavg()[0]:.1f}:")
            print(f"  JSON: {json_s:.2f} s, {path.stat().st_size / 1e6:.0f} MB")
            for suffix, (cpu_s, memory_mb) in best.items():
                size_mb = (Path(name) / f"out.{suffix}").stat().st_size / 1e6
                written_s = cpu_s - best["gltf"][0]
                times = f"{cpu_s / json_s:.2f} x JSON, {written_s / json_s:.2f} without start and reading"
                print(f"  {suffix}: {cpu_s:.2f} s, {times}, {size_mb:.0f} MB, memory {memory_mb} MB")


if __name__ == "__main__":
    main()
