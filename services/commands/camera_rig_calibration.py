"""`vemlight calibrate rig` of cameras: their poses from recordings of a small lamp that is carried where all see it, or of a board."""

import math
import re
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from vemlight.capture.calibration.boards import CalibrationBoard
from vemlight.commands.rig_recordings import recording_of
from vemlight.errors import UserError, of_setting
from vemlight.files import MAX_TOML_BYTES, notice, read_file, read_toml, written_whole
from vemlight.fixtures.rig_writing import free_name
from vemlight.fuse.board_poses import BoardFit
from vemlight.fuse.bundle_adjustment import MIN_PLACES, Adjusted, CalibrationError, Poses, ScaleBar, adjusted
from vemlight.fuse.compact_sources import LENS_RAD, compact_sources
from vemlight.fuse.rig_file import CameraRig, check_one_rate, read_camera_rig
from vemlight.fuse.wand import FrameSources, lamp_bearings, places
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.runtime.interrupt import interruption
from vemlight.runtime.progress import counted

MAX_METRES = 100.0
CAMERA_LINE = re.compile(rb"^[ \t]*\[\[[ \t]*camera[ \t]*\]\]", re.MULTILINE)


class Wand(NamedTuple):
    """The measured distance of two cameras, by their names."""

    first: str
    second: str
    metres: float


def wand_from_text(text: str) -> Wand:
    """A,B:METRES. Raises UserError for anything else."""
    names, _, number = text.partition(":")
    first, _, second = names.partition(",")
    try:
        metres = float(number)
    except ValueError:
        metres = math.nan
    if not (first and second and first != second and 0 < metres <= MAX_METRES):
        raise UserError(f"--wand {text[:40]}: is not two cameras and their distance in metres; write it as left,right:1.25")
    return Wand(first, second, metres)


def is_camera_rig(path: Path) -> bool:
    """Whether a rig file holds cameras, and not fixtures, by its tables. Raises UserError for a file that cannot be read."""
    return path.suffix.lower() == ".toml" and CAMERA_LINE.search(read_file(path, MAX_TOML_BYTES)) is not None


def calibrate_camera_rig(path: Path, wand: Wand, coverage: str) -> str:
    """Measures the poses and writes them into the rig file; the old file is kept beside it. Returns lines about them.

    Raises UserError for a rig or recordings that cannot be used, and for bearings from which no poses follow; nothing is written then.
    """
    rig = read_camera_rig(path)
    names = [camera.name for camera in rig.camera]
    for name in wand[:2]:
        if name not in names:
            raise UserError(f"--wand {wand.first},{wand.second}: {path} has no camera {name}; it has {', '.join(names)}")
    seen = places(_bearings(path, rig, coverage))
    if seen.shape[1] < MIN_PLACES:
        found = f"two cameras or more see the lamp at {seen.shape[1]} places, and {MIN_PLACES} are needed"
        raise UserError(f"{path}: {found}; carry a small bright lamp to about 30, in a dim room")
    scale = ScaleBar(names.index(wand.first), names.index(wand.second), wand.metres)
    try:
        found = adjusted(seen, _start(rig), scale, names)
    except CalibrationError as error:
        raise UserError(f"{path}: {error}") from error
    old = _write(path, found)
    in_all, used = np.isfinite(seen[..., 0]).sum(axis=1), found.used.sum(axis=1)
    return _report(path, old, rig, found, [f"{n} of {count} places" for n, count in zip(used, in_all, strict=True)])


def calibrate_camera_rig_by_board(path: Path, folder: Path, board: CalibrationBoard) -> str:
    """The same from photographs of a board in folder/NAME/ of each camera, the n-th of all taken at one moment."""
    from vemlight.commands.camera_rig_boards import poses_from_photographs  # here, since it loads OpenCV

    rig = read_camera_rig(path)
    found = poses_from_photographs(path, rig, _start(rig), folder, board)
    old = _write(path, found)
    return _report(path, old, rig, found, [f"{count} boards" for count in found.moments])


def _start(rig: CameraRig) -> Poses:
    """What the file says of the poses."""
    return Poses(np.array([camera.world_from_camera for camera in rig.camera]), rig.places)


def _bearings(path: Path, rig: CameraRig, coverage: str) -> np.ndarray:
    """Where each camera sees the lamp in each frame, (cameras, frames, 3)."""
    sources = [recording_of(path, camera, coverage) for camera in rig.camera]
    counts = [len(source) for source in sources]
    if min(counts) > 1:
        check_one_rate(path, rig, [source.fps for source in sources])
    if max(counts) > min(counts):
        notice(f"{path}: its recordings have {min(counts)} to {max(counts)} frames; the first {min(counts)} of each are used")
    found = []
    for camera, source in zip(rig.camera, sources, strict=True):
        seen = []
        for k in counted(range(min(counts)), f"frames of {camera.name}", min(counts)):
            interruption.check()
            with of_setting(f"{path}: camera {camera.name}"):
                frame = source.frame(k)
            lamps = compact_sources(EnvironmentMap(frame.radiance, frame.coverage, frame.bright_cells))
            seen.append(FrameSources(lamps.directions, luminance_from_rgb(lamps.flux)))
        found.append(lamp_bearings(seen))
    return np.stack(found)


def _write(path: Path, found: Adjusted | BoardFit) -> Path:
    """Puts the poses, and how well they are known, into the file, which is written anew. Where the old one is kept."""
    content, rig = read_file(path, MAX_TOML_BYTES), read_toml(path, CameraRig)
    cameras = tuple(
        msgspec.structs.replace(camera, at=_rounded(at, 5), turn=_rounded(Rotation.from_matrix(turn).as_quat(canonical=True), 7))
        for camera, turn, at in zip(rig.camera, found.poses.turns, found.poses.at, strict=True)
    )
    # Later bearings are as wrong as these were: what coarse pixels or a lens file do beyond what is taken of any lens.
    turn_rad = math.sqrt(float(found.turn_rad.max()) ** 2 + max(found.residual_rad**2 - LENS_RAD**2, 0.0))
    changed = msgspec.structs.replace(
        rig, camera=cameras, pose_deg=round(math.degrees(turn_rad), 4), pose_m=round(float(found.at_m.max()), 5)
    )
    text = msgspec.toml.encode(changed)
    old = free_name(path)
    for target, data in ((old, content), (path, text)):
        with written_whole(target) as part:
            part.write_bytes(data)
    return old


def _rounded(numbers: np.ndarray, digits: int) -> tuple[float, ...]:
    return tuple(round(float(number), digits) + 0.0 for number in numbers)


def _report(path: Path, old: Path, rig: CameraRig, found: Adjusted | BoardFit, seen: list[str]) -> str:
    lines = []
    for k, camera in enumerate(rig.camera):
        sigma = f"+- {1e3 * found.at_m[k]:.1f} mm, {math.degrees(found.turn_rad[k]):.3f} degrees" if k else "fixes the world"
        lines.append(f"{camera.name}: at {', '.join(f'{x:.4f}' for x in found.poses.at[k])} m, {sigma}; {seen[k]}")
    lines.append(f"{path}: bearings fit to {math.degrees(found.residual_rad):.3f} degrees; the old file is {old}")
    return "\n".join(lines)
