"""`python -m vemlight.commands.precompile`: the kernels of the default settings into the cache of numba, so that no first start waits."""

import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from vemlight.settings import Capture, Settings


def _sampler() -> None:
    from vemlight.sampler.stage import warm

    warm(Settings().sampler)


def _capture() -> None:
    from vemlight.capture.source import open_source
    from vemlight.light.images import read_radiance

    open_source(Settings().capture).frame(0)
    with tempfile.TemporaryDirectory() as folder:
        # A lat-long of one colour, its pixels not run-length coded.
        file = Path(folder) / "map.hdr"
        file.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + np.full((4, 8, 4), 128, np.uint8).tobytes())
        read_radiance(file)
        open_source(Capture(source=str(file))).frame(0)


def _renderer() -> None:
    from vemlight.renderer.rays.embree import library
    from vemlight.renderer.scene.scene import load_scene

    if library() is not None:
        from vemlight.renderer.rays.bounce import Bounce
        from vemlight.renderer.rays.reflecting import reflecting_meshes
        from vemlight.renderer.rays.tracing import RayTracer

        scene = load_scene(None)
        tracer = RayTracer(scene, (8, 8))
        tracer.warm()
        with ThreadPoolExecutor(1) as threads:
            Bounce(tracer.scene, reflecting_meshes(scene), tracer.reach_m, threads, 16, 1).warm()


def precompile() -> None:
    """Compiles in a process for each service."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as processes:
        for done in [processes.submit(job) for job in (_sampler, _capture, _renderer)]:
            done.result()


if __name__ == "__main__":
    print("compiling the kernels: half a minute", file=sys.stderr)
    precompile()
