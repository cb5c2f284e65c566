"""Recordings of a lamp that is carried past a rig of cameras, by the virtual camera, and the file that names them with rough poses."""

from pathlib import Path

import msgspec
import numpy as np

from vemlight.capture.lens import Lens
from vemlight.capture.simulation.environment import Environment, SunDisc
from vemlight.capture.simulation.optics import fisheye_radiance
from vemlight.capture.simulation.sensor import SequenceWriter, VirtualCamera, exposed
from vemlight.fuse.rig_file import CameraRig, RigCamera

LENS = Lens(size=(200, 200), f=(62.5, 62.5), c=(99.5, 99.5), k1=-0.01, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)
LAMP_M = 0.02  # radius
LAMP, STANDING = 40.0, 90.0  # irradiance of the lamp at 1 m, and of one that stands in the room: the brighter one is not it


def write_wand(folder: Path, turns: np.ndarray, at: np.ndarray, lamp: np.ndarray, rough: CameraRig) -> Path:
    """A folder of fisheye frames for each camera of true pose (turns (n, 3, 3), at (n, 3)), one for each place of the lamp (frames, 3).

    rough: what the rig file says of the poses. Returns its path.
    """
    cameras = []
    for camera, turn, own in zip(rough.camera, turns, at, strict=True):
        writer = SequenceWriter(folder / camera.name, "lamp", VirtualCamera(lens=LENS))
        for k, place in enumerate(lamp):
            discs = [_disc(turn, own, place, LAMP), _disc(turn, own, np.array([3.0, 2.0, 5.0]), STANDING)]
            image = np.full((16, 32, 3), 0.02)
            radiance = fisheye_radiance(Environment(image, discs), np.eye(3), LENS)
            writer.write(k, k / 25, exposed(radiance, VirtualCamera(lens=LENS), np.zeros(1), (0, k)))
        writer.close()
        cameras.append(msgspec.structs.replace(camera, source=camera.name))
    path = folder / "rig.toml"
    path.write_bytes(msgspec.toml.encode(msgspec.structs.replace(rough, camera=tuple(cameras))))
    return path


def _disc(turn: np.ndarray, at: np.ndarray, place: np.ndarray, strength: float) -> SunDisc:
    towards = turn.T @ (place - at)
    distance = float(np.linalg.norm(towards))
    return SunDisc(towards / distance, LAMP_M / distance, np.full(3, strength / distance**2))


def rough_rig(names: str, at: np.ndarray) -> CameraRig:
    """Cameras of these names, that look up."""
    return CameraRig(camera=tuple(RigCamera(name=name, source=name, at=tuple(own.tolist())) for name, own in zip(names, at, strict=True)))
