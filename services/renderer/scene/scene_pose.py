"""Where a scene's meshes and lamps are at a time: by the animations of their files and the poses that are asked for."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from vemlight.renderer.scene.meshes import box_corners
from vemlight.renderer.scene.scene import Scene, ViewCamera
from vemlight.runtime.poses import Pose, View


class ScenePose(NamedTuple):
    """Where a scene's meshes and objects are.

    matrices: (n, 4, 4) float64, for each mesh world_from_rest, rest being where the scene file places it; exactly 1 where nothing moves it.
    objects: the poses of the scene's objects and lamps. centre, half: (3,) float64, centre and half size of the box around all meshes,
    never smaller than at rest. camera: from where it is seen. lamp_colours: of luminaires, by their number, that have another colour than
    at rest.
    """

    matrices: np.ndarray
    objects: tuple[Pose, ...]
    centre: np.ndarray
    half: np.ndarray
    camera: ViewCamera
    lamp_colours: Mapping[int, tuple[float, float, float]] = {}


def world_from_object(pose: Pose) -> np.ndarray:
    """The transform (4, 4) from an object's own axes: scaled evenly, turned and moved."""
    from scipy.spatial.transform import Rotation  # here, since it takes a third of a second to load

    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.scale * Rotation.from_quat(pose.rotation).as_matrix(), pose.position
    return matrix


def world_place(pose: Pose) -> tuple[object, ...]:
    """All of a pose but its name and power."""
    return pose.position, pose.rotation, pose.scale


def scene_pose(scene: Scene, time_s: float, poses: Iterable[Pose] = (), view: View | None = None) -> ScenePose:
    """The scene at a time of its animations, with the objects that `poses` names moved there, seen from `view` or else by its own camera.

    Unknown names change nothing.
    """
    asked = {pose.name: pose for pose in poses}
    objects = tuple(_with_power(asked[rest.name], rest) if rest.name in asked else rest for rest in scene.objects)
    matrices = np.tile(np.eye(4), (len(scene.meshes), 1, 1))
    low, high = scene.centre - scene.half, scene.centre + scene.half
    for k, mesh in enumerate(scene.meshes):
        rest, now = (scene.objects[mesh.object_index], objects[mesh.object_index]) if mesh.object_index is not None else (None, None)
        if mesh.motion is not None:
            matrices[k] = mesh.motion.world_from_rest(time_s)
        if rest is not None and now is not None and world_place(rest) != world_place(now):
            matrices[k] = world_from_object(now) @ np.linalg.inv(world_from_object(rest)) @ matrices[k]
        if mesh.motion is not None or now is not rest:
            corners = box_corners(mesh.geometry) @ matrices[k, :3, :3].T + matrices[k, :3, 3]
            low, high = np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))
    camera = ViewCamera(position=view.eye, at=view.at, fov_y=view.fov_y) if view else scene.camera
    return ScenePose(matrices, objects, (low + high) / 2, (high - low) / 2, camera)


def _with_power(asked: Pose, rest: Pose) -> Pose:
    """A pose that is asked for, with the scene file's power where it names none; only lamps have power, and only objects a scale."""
    if rest.power is None:
        return Pose(name=rest.name, position=asked.position, rotation=asked.rotation, scale=asked.scale)
    power = rest.power if asked.power is None else asked.power
    return Pose(name=rest.name, position=asked.position, rotation=asked.rotation, power=power)


def same_places(a: ScenePose | None, b: ScenePose) -> bool:
    """Whether the meshes stand in the same places and are seen from the same."""
    return a is b or (a is not None and a.camera == b.camera and np.array_equal(a.matrices, b.matrices))
