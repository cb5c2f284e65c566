"""The light of a scene's luminaires, added to a picture after its surfaces: a draw call each, and shadow maps for those that moved."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.errors import UserError
from vemlight.light.far_field import FarField
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.luminaires.luminaire_map_plan import placed_luminaires
from vemlight.renderer.passes.luminaires.occluders import SceneOccluders, scene_occluders, traced_triangles
from vemlight.renderer.scene.luminaire_table import Luminaire, Vector
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose

if TYPE_CHECKING:
    from vemlight.renderer.passes.luminaires.rasterised_luminaire import RasterisedLuminaire
    from vemlight.renderer.passes.luminaires.traced_luminaire import TracedLuminaire


class Illumination:
    """All luminaires of a scene."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        """Raises UserError for a luminaire beyond what this GL holds, or a far field with traced shadows."""
        self._scene = scene
        self._occluders = scene_occluders(context, scene, scene_pose(scene, 0.0))
        drawn = (_drawn(context, programs, self._occluders, scene, luminaire, size) for luminaire in scene.luminaires)
        self.luminaires: list[RasterisedLuminaire | TracedLuminaire] = list(drawn)

    @property
    def occluders(self) -> SceneOccluders:
        """What casts shadows in their light, and in that of near lights."""
        return self._occluders

    def place(self, now: ScenePose) -> None:
        """Moves the luminaires and what casts shadows in their light."""
        moved = not np.array_equal(now.matrices, self._occluders.pose.matrices)
        triangles = traced_triangles(self._scene, now) if moved and self.luminaires else self._occluders.triangles
        self._occluders = self._occluders._replace(pose=now, triangles=triangles)
        for drawn, luminaire in zip(self.luminaires, placed_luminaires(self._scene, now), strict=True):
            drawn.place(luminaire, self._occluders)

    def draw_maps(self, number: int) -> None:
        """Draws the shadow maps of a luminaire where it stands."""
        self.luminaires[number].draw_maps()

    def add(self, g_buffer: GBuffer, framebuffer: moderngl.Framebuffer, weight: Vector, catchers: bool = False) -> None:
        """Adds all luminaires' light on the surfaces, times `weight`, to a picture; with `catchers`, the irradiance of shadow catchers."""
        for luminaire in self.luminaires:
            if luminaire.luminaire.power * max(luminaire.luminaire.colour) > 0:
                luminaire.add(g_buffer, framebuffer, weight, catchers)

    def release(self) -> None:
        """Frees what the luminaires hold on the GPU."""
        for resource in (*self.luminaires, self._occluders.positions, self._occluders.indices):
            resource.release()


def _drawn(
    context: moderngl.Context, programs: Programs, occluders: SceneOccluders, scene: Scene, luminaire: Luminaire, size: tuple[int, int]
) -> "RasterisedLuminaire | TracedLuminaire":
    # Imported here, since most scenes have no luminaires and these load numba.
    from vemlight.renderer.passes.luminaires.rasterised_luminaire import RasterisedLuminaire
    from vemlight.renderer.passes.luminaires.traced_luminaire import TracedLuminaire

    if luminaire.table.shadows != "traced":
        return RasterisedLuminaire(context, programs, occluders, scene, luminaire)
    if isinstance(luminaire.source, FarField):
        raise UserError(f"luminaire {luminaire.source.name}: a far field has shadows = \"maps\" or \"none\"; choose one")
    return TracedLuminaire(context, programs, occluders, luminaire, size)
