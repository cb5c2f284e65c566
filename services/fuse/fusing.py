"""The step of the fuse service: one moment's maps of all cameras in, one map and the near lights out. A pure function of its state."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vemlight.fuse.rest import CameraView, FusedMap, fused, fused_layout, layout_of
from vemlight.fuse.rig_file import CameraRig
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.near_lights import NearLightSet
from vemlight.light.sphere import map_irradiance

MIN_SUBJECT_M = 0.05  # a camera nearer to the subject counts as if it were so far, so that it does not count alone


class FuseState(NamedTuple):
    """What fusing remembers between frames.

    rig: the cameras. weights: (cameras,) of each map in the mean, sum 1. gains: (cameras, 3), which bring the cameras to one radiance unit.
    """

    rig: CameraRig
    weights: np.ndarray
    gains: np.ndarray

    @staticmethod
    def start(rig: CameraRig, subject: tuple[float, float, float] | None = None) -> "FuseState":
        """Before the first frame. subject: place, m, whose light is wanted: cameras count by 1 / distance^2 from it; None: all alike."""
        weights = np.ones(len(rig.camera))
        if subject is not None:
            weights = 1 / np.maximum(np.linalg.norm(rig.places - np.asarray(subject), axis=1), MIN_SUBJECT_M) ** 2
        gains = np.array([camera.gain or (1.0, 1.0, 1.0) for camera in rig.camera], np.float64)
        return FuseState(rig, weights / weights.sum(), gains)


class FuseReport(NamedTuple):
    """What is published beside map and near lights.

    irradiance: (3,) float64, integral at the rig's centre of the fused map and the near lights together. sources: compact sources seen,
    of all cameras. located: near lights. hidden: of them, not located in this frame. unexplained: sources that two cameras should see and
    that no place explains, as when a pose is wrong by more than the rig file says. silent: names of cameras without a map. gains:
    (cameras, 3), in use. uncovered: fraction of the fused map that no camera sees.
    """

    irradiance: np.ndarray
    sources: int
    located: int
    hidden: int
    unexplained: int
    silent: tuple[str, ...]
    gains: np.ndarray
    uncovered: float


def fuse_step(
    state: FuseState, maps: Sequence[EnvironmentMap | None], saturated: Sequence[bool] = ()
) -> tuple[FuseState, EnvironmentMap, NearLightSet, FuseReport]:
    """The fused map, in the world's axes and true at the rig's centre, without the near lights, and these.

    maps: one of each camera in the rig's order, in its own axes; None where it is silent. saturated: of each camera, whether its map has
    pixels at the sensor's highest code; left out: none has. Raises ValueError when all are silent.
    """
    if all(each is None for each in maps):
        raise ValueError("all cameras are silent")
    rest = _rest(state, maps)
    points = NearLightSet.empty()
    silent = tuple(camera.name for camera, each in zip(state.rig.camera, maps, strict=True) if each is None)
    irradiance = map_irradiance(rest.map.radiance, rest.map.coverage)
    return state, rest.map, points, FuseReport(irradiance, 0, 0, 0, 0, silent, state.gains, rest.uncovered)


def _rest(state: FuseState, maps: Sequence[EnvironmentMap | None]) -> FusedMap:
    """The mean of the maps."""
    views = [
        CameraView(each, camera.world_from_camera, gain, float(weight))
        for each, camera, gain, weight in zip(maps, state.rig.camera, state.gains, state.weights, strict=True)
        if each is not None
    ]
    layouts = [layout_of(each.radiance, each.coverage) if each else None for each in maps]
    first = next(layout for layout in layouts if layout)  # of a camera that is silent the layout is taken to be the others'
    cameras = zip(layouts, state.rig.camera, strict=True)
    return fused(views, fused_layout([(layout or first, camera.world_from_camera) for layout, camera in cameras]))
