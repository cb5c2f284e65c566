"""Whether a rig of cameras can be used, found before anything is started; and what compiles before its first frame."""

from pathlib import Path

import numpy as np

from vemlight.errors import UserError
from vemlight.fuse.fusing import FuseState, fuse_step
from vemlight.fuse.gains import BLOCKS
from vemlight.fuse.matching import SOURCE_NUMBERS
from vemlight.fuse.rest import Layout, cells_in_world, fused_layout
from vemlight.fuse.rig_file import CameraRig, check_one_rate, read_camera_rig
from vemlight.fuse.triangulation import fits
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import Coverage, cell_from_direction

WARM_FRAMES = 4  # lights are published when they were located twice
WARM_ROWS, WARM_COLS = 45, 180  # cells of two degrees, in which a lamp is compact
LAMP_M = np.array([0.7, 0.4, 2.0])  # of the lamp that warms: from the rig's centre


def check_cameras(path: Path, fps: list[float], frames: list[int]) -> None:
    """Raises UserError for a file that is no rig, and where recordings of its cameras, in their order, do not go together.

    fps, frames: of each camera's files; empty where some are live.
    """
    rig = read_camera_rig(path)
    if not fps:
        return
    check_one_rate(path, rig, fps)
    for camera, count in zip(rig.camera, frames, strict=True):
        if count != frames[0]:
            found = f"camera {camera.name}: has {count} frames and {rig.camera[0].name} {frames[0]}"
            raise UserError(f"{path}: {found}, and frame k of all is one moment; set [capture] end = {min(frames)}")


def warm(rig: CameraRig, layout: Layout) -> None:
    """Does what can be done before the first frame, so that none waits for it: compiles, on small maps that see a lamp, and finds where the
    cells of maps of a layout lie in the world, half a second each.
    """
    for coverage in ("hemisphere", "sphere"):
        state = FuseState.start(rig)
        maps: list[EnvironmentMap | None] = [_map_of_lamp(rig, k, coverage) for k in range(len(rig.camera))]
        for _ in range(WARM_FRAMES):
            state, *_ = fuse_step(state, maps)
        fuse_step(state, [None, *maps[1:]])
    cameras, pose = len(rig.camera), np.array([np.radians(rig.pose_deg), rig.pose_m])
    fits(np.zeros((cameras, 1, SOURCE_NUMBERS)), np.zeros((0, cameras), np.int64), rig.centre - rig.places, pose)  # of sources left out
    turns = [camera.world_from_camera.tobytes() for camera in rig.camera]
    fused = fused_layout(tuple((layout, turn) for turn in turns))
    for goal in (fused, BLOCKS):
        for turn in turns:
            cells_in_world(layout, goal, turn)


def _map_of_lamp(rig: CameraRig, camera: int, coverage: Coverage) -> EnvironmentMap:
    """What a camera of the rig sees of a lamp in grey, in read-only arrays, as those off the wire are."""
    towards = rig.camera[camera].world_from_camera.T @ (rig.centre + LAMP_M - rig.places[camera])
    towards /= np.linalg.norm(towards)
    radiance = np.full((WARM_ROWS, WARM_COLS, 3), 0.1, np.float32)
    bright = NO_BRIGHT_CELLS
    if towards[2] > 0 or coverage == "sphere":
        row, col = (int(each[0]) for each in cell_from_direction(towards[None], WARM_ROWS, WARM_COLS, coverage))
        radiance[min(row, WARM_ROWS - 1), col % WARM_COLS] = 200
        cell = np.array([min(row, WARM_ROWS - 1) * WARM_COLS + col % WARM_COLS])
        bright = BrightCells(cell, towards[None].astype(np.float32), np.ones(1, np.float32))
    for array in (radiance, *bright):
        array.flags.writeable = False
    return EnvironmentMap(radiance, coverage, bright)
