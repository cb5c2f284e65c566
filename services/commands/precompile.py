"""`python -m vemlight.commands.precompile`: the kernels of the default settings into the cache of numba, so that no first start waits."""

import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from vemlight.settings import Capture, Settings


def _sampler() -> None:
    from vemlight.light.bright_cells import NO_BRIGHT_CELLS
    from vemlight.sampler.stage import warm
    from vemlight.sampler.tracking.split_merge import cheapest_pair
    from vemlight.sampler.tracking.tiles import tiles_from_map
    from vemlight.sampler.tracking.voronoi import cells_from_sites, lights_from_cells

    warm(Settings().sampler)
    # What few frames take: merging lights, and lights that are points.
    tiles, sites = tiles_from_map(np.ones((6, 24, 3), np.float32), "hemisphere", 3, NO_BRIGHT_CELLS), np.eye(3)
    cells = cells_from_sites(tiles, sites)
    cheapest_pair(sites, cells)
    lights_from_cells(tiles, cells.moment, cells.assignment, sites, np.zeros((3, 3)))


def _capture() -> None:
    from vemlight.capture.colour_coding import colour_coding
    from vemlight.capture.frames import FrameMaker
    from vemlight.capture.planes import planes_from_image
    from vemlight.capture.source import open_source
    from vemlight.light.colour_tags import ColourTags
    from vemlight.light.images import read_radiance

    open_source(Settings().capture).frame(0)
    with tempfile.TemporaryDirectory() as folder:
        # A lat-long of one colour, its pixels not run-length coded.
        file = Path(folder) / "map.hdr"
        file.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + np.full((4, 8, 4), 128, np.uint8).tobytes())
        read_radiance(file)
        open_source(Capture(source=str(file))).frame(0)
    # Films and stills, of 8 bits and of more.
    coding = colour_coding(Capture(), "", ColourTags("bt709", "bt709", "rgb", "full"))
    for dtype in (np.uint8, np.uint16):
        planes = planes_from_image(np.zeros((4, 8, 3), dtype), 8 * np.dtype(dtype).itemsize)
        FrameMaker(Capture(), Path()).frame_from_planes("", planes, coding, 0.0)


def _renderer() -> None:
    from vemlight.renderer.rays.embree import library
    from vemlight.renderer.scene.scene import load_scene

    if library() is not None:
        from vemlight.renderer.rays import edge_samples, near_tracing, sampled_tracing
        from vemlight.renderer.rays.bounce import Bounce
        from vemlight.renderer.rays.mirror import Mirror
        from vemlight.renderer.rays.reflecting import reflecting_meshes
        from vemlight.renderer.rays.tracing import RayTracer

        scene = load_scene(None)
        tracer = RayTracer(scene, (8, 32))  # rows for more than one thread, as all pictures have
        tracer.warm()
        sampled_tracing.warm(tracer)
        near_tracing.warm(tracer)
        edge_samples.warm(tracer.surfaces)
        with ThreadPoolExecutor(1) as threads:
            meshes = reflecting_meshes(scene)
            Bounce(tracer.scene, meshes, tracer.reach_m, threads, 16, 1).warm()
            Mirror(tracer, meshes, threads, 1, 1).warm()


def _fixtures() -> None:
    import msgspec

    from vemlight.commands.fixture_commands import BUNDLED, rig_path
    from vemlight.fixtures.rig_file import read_rig
    from vemlight.fixtures.stage import FixturesStage

    rig = read_rig(rig_path(Path(BUNDLED)))
    FixturesStage(msgspec.structs.replace(rig, fixture=(msgspec.structs.replace(rig.fixture[0], bits=8), *rig.fixture[1:])))


def _fuse() -> None:
    from vemlight.fuse.check import warm
    from vemlight.fuse.rig_file import CameraRig, RigCamera
    from vemlight.fuse.service import layout_of_settings
    from vemlight.settings import Settings

    cameras = (RigCamera(name="left", source="left", at=(-0.5, 0.0, 0.0)), RigCamera(name="right", source="right", at=(0.5, 0.0, 0.0)))
    warm(CameraRig(camera=cameras), layout_of_settings(Settings()))


JOBS = (_sampler, _capture, _renderer, _fixtures, _fuse)


def precompile() -> None:
    """Compiles in a process for each service."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as processes:
        for done in [processes.submit(job) for job in JOBS]:
            done.result()


if __name__ == "__main__":
    print("compiling the kernels: half a minute", file=sys.stderr)
    precompile()
