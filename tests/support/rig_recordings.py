"""Recordings of a rig of cameras on disk: polar maps of analytic rooms, and the file that names them."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from vemlight.capture.frames import Frame
from vemlight.capture.recording_attributes import map_attributes
from vemlight.fuse.rig_file import CameraRig
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.images import write_exr


def write_rig(folder: Path, rig: CameraRig, moments: Sequence[Sequence[EnvironmentMap]]) -> Path:
    """A folder of maps for each camera, one a moment, and the path of RIG.toml, which names them."""
    cameras = []
    for n, camera in enumerate(rig.camera):
        own = folder / camera.name
        own.mkdir(parents=True)
        for k, maps in enumerate(moments):
            seen = maps[n]
            frame = Frame(seen.radiance, seen.coverage, k / 25.0, None, 0, 0, seen.bright_cells)
            write_exr(own / f"map_{k:04d}.exr", seen.radiance, map_attributes(frame, 25.0))
        cameras.append(msgspec.structs.replace(camera, source=camera.name))
    path = folder / "rig.toml"
    path.write_bytes(msgspec.toml.encode(msgspec.structs.replace(rig, camera=tuple(cameras))))
    return path
