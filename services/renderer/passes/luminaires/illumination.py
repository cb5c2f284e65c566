"""The light of a scene's luminaires, added to a picture after its surfaces: a draw call each, and shadow maps for those that moved."""

import moderngl
import numpy as np

from vemlight.errors import UserError
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.luminaire.photometry import FarField
from vemlight.renderer.passes.gbuffer.gbuffer import Surfaces
from vemlight.renderer.passes.luminaires.occluders import scene_occluders, traced_triangles
from vemlight.renderer.passes.luminaires.rasterised_luminaire import RasterisedLuminaire
from vemlight.renderer.passes.luminaires.traced_luminaire import TracedLuminaire
from vemlight.renderer.scene.luminaire_table import Vector
from vemlight.renderer.scene.meshes import box_corners
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose, world_from_object


class Illumination:
    """All luminaires of a scene."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        """Raises UserError for a luminaire beyond what this GL holds, or a far field with traced shadows."""
        self.luminaires: list[RasterisedLuminaire | TracedLuminaire] = []
        self._scene = scene
        self._occluders = occluders = scene_occluders(context, scene, scene_pose(scene, 0.0))
        for luminaire in scene.luminaires:
            if luminaire.table.shadows != "traced":
                self.luminaires.append(RasterisedLuminaire(context, programs, occluders, scene, luminaire))
            elif isinstance(luminaire.source, FarField):
                raise UserError(f"luminaire {luminaire.source.name}: a far field has shadows = \"maps\" or \"none\"; choose one")
            else:
                self.luminaires.append(TracedLuminaire(context, programs, occluders, luminaire, size))

    def place(self, now: ScenePose) -> None:
        """Moves the luminaires and what casts shadows in their light."""
        before = self._occluders.pose
        changed = [k for k in range(len(now.matrices)) if not np.array_equal(before.matrices[k], now.matrices[k])]
        if changed and self.luminaires:
            self._occluders = self._occluders._replace(pose=now, triangles=traced_triangles(self._scene, now))
            boxes = [(box_corners(self._scene.meshes[k].geometry), m[k]) for k in changed for m in (before.matrices, now.matrices)]
            corners = np.concatenate([box @ matrix[:3, :3].T + matrix[:3, 3] for box, matrix in boxes])
            for luminaire in self.luminaires:
                luminaire.place_occluders(self._occluders, corners)
        poses = [(was, pose) for was, pose in zip(before.objects, now.objects, strict=True) if pose.power is not None]
        for luminaire, (was, pose) in zip(self.luminaires, poses, strict=False):  # a scene made without a file names nothing
            if pose != was:
                luminaire.place(world_from_object(pose), pose.power or 0.0)
        self._occluders = self._occluders._replace(pose=now)

    def draw_maps(self) -> None:
        """Draws the shadow maps that are stale."""
        for luminaire in self.luminaires:
            luminaire.draw_maps()

    def add(self, surfaces: Surfaces, framebuffer: moderngl.Framebuffer, weight: Vector, catchers: bool = False) -> None:
        """Adds all luminaires' light on the surfaces, times `weight`, to a picture; with `catchers`, the irradiance of shadow catchers."""
        for luminaire in self.luminaires:
            luminaire.add(surfaces, framebuffer, weight, catchers)

    def release(self) -> None:
        """Frees what the luminaires hold on the GPU."""
        for resource in (*self.luminaires, self._occluders.positions, self._occluders.indices):
            resource.release()
