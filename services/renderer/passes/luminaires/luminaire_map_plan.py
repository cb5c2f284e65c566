"""Which luminaires' shadow maps a frame draws again: values, without GL."""

from collections.abc import Sequence

import numpy as np

from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.scene.luminaire_table import Luminaire, Vector
from vemlight.renderer.scene.meshes import box_corners
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, world_from_object
from vemlight.runtime.poses import Pose


def placed_luminaires(scene: Scene, pose: ScenePose) -> tuple[Luminaire, ...]:
    """The scene's luminaires where a pose puts them, and with its power."""
    rests, poses = (_lamp_poses(objects) for objects in (scene.objects, pose.objects))
    return tuple(
        _coloured(_placed(luminaire, rests[k], poses[k]) if k < len(poses) else luminaire, pose.lamp_colours.get(k))  # some have no name
        for k, luminaire in enumerate(scene.luminaires)
    )


def _lamp_poses(objects: Sequence[Pose]) -> list[Pose]:
    return [pose for pose in objects if pose.power is not None]


def _coloured(luminaire: Luminaire, colour: Vector | None) -> Luminaire:
    return luminaire if colour is None else luminaire._replace(colour=colour)


def _placed(luminaire: Luminaire, rest: Pose, pose: Pose) -> Luminaire:
    unmoved = (pose.position, pose.rotation) == (rest.position, rest.rotation)
    matrix = luminaire.world_from_local if unmoved else world_from_object(pose)
    return luminaire._replace(world_from_local=matrix, power=luminaire.power if pose == rest else pose.power or 0.0)


def stale_luminaire_maps(scene: Scene, drawn: Sequence[ScenePose | None], pose: ScenePose) -> tuple[bool, ...]:
    """Whether each luminaire's maps, drawn for that pose of the scene, must be redrawn; False for luminaires without maps.

    They are if the luminaire moved, or a mesh that is not wholly behind it, before and after.
    """
    return tuple(
        luminaire.table.shadows == "maps" and (before is None or _is_stale(scene, k, before, luminaire, pose))
        for k, (luminaire, before) in enumerate(zip(placed_luminaires(scene, pose), drawn, strict=True))
    )


def _is_stale(scene: Scene, number: int, before: ScenePose, luminaire: Luminaire, pose: ScenePose) -> bool:
    if before is pose:
        return False
    if not np.array_equal(placed_luminaires(scene, before)[number].world_from_local, luminaire.world_from_local):
        return True
    changed = [k for k in range(len(pose.matrices)) if not np.array_equal(before.matrices[k], pose.matrices[k])]
    if not changed:
        return False
    if not isinstance(luminaire.source, LightField):
        return True
    boxes = [(box_corners(scene.meshes[k].geometry), at.matrices[k]) for k in changed for at in (before, pose)]
    corners = np.concatenate([box @ matrix[:3, :3].T + matrix[:3, 3] for box, matrix in boxes])
    local_from_world = np.linalg.inv(luminaire.world_from_local)
    return not np.all(corners @ local_from_world[2, :3] + local_from_world[2, 3] < 0)
