"""A light field whose shadows are traced rays, on the CPU: slow, and the truth that shadow maps are compared with."""

import moderngl
import numpy as np

from vemlight.renderer.gl.constants import MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.luminaire.estimator import Occluders, Receivers, interleaved_shifts, irradiance_receivers, shade
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.tables import summed_area_tables
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer, GBufferPixels
from vemlight.renderer.passes.luminaires.occluders import SceneOccluders
from vemlight.renderer.passes.luminaires.rasterised_luminaire import begin_adding
from vemlight.renderer.scene.luminaire_table import Luminaire, Vector


class TracedLuminaire:
    """`estimator.shade` on the surfaces of the G-buffer, whose result is added to a picture of `size` pixels (width, height)."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, occluders: SceneOccluders, luminaire: Luminaire, size: tuple[int, int]
    ) -> None:
        assert isinstance(luminaire.source, LightField)
        self._context, self._occluders, self._size = context, occluders, size
        self._tables = summed_area_tables(luminaire.source)
        self.luminaire = luminaire
        self._program = programs.program("screen.vert", "luminaire_added.frag")
        self._array = context.vertex_array(self._program, [])
        self._texture = context.texture(size, 3, dtype="f4")
        rows, columns = np.indices((size[1], size[0])).reshape(2, -1)
        self._shifts = interleaved_shifts(rows, columns, luminaire.table.interleave)

    def place(self, luminaire: Luminaire, occluders: SceneOccluders) -> None:
        """Moves, turns and dims the luminaire, and moves what casts shadows in its light."""
        self.luminaire, self._occluders = luminaire, occluders

    def draw_maps(self) -> None:
        """Does nothing: there are no maps."""

    def add(self, g_buffer: GBuffer, framebuffer: moderngl.Framebuffer, weight: Vector, catchers: bool) -> None:
        """Adds its light on the surfaces, or its irradiance of shadow catchers, to a picture."""
        table, samples, matrix = self.luminaire.table, self.luminaire.drawn.samples, self.luminaire.world_from_local
        gbuffer = g_buffer.read()
        chosen = gbuffer.there & ((gbuffer.diffuse["kind"] == MaterialKind.SHADOW_CATCHER) == catchers)
        receivers = receivers_from_gbuffer(gbuffer, chosen, np.linalg.inv(matrix))
        if catchers:
            receivers = irradiance_receivers(receivers.positions, receivers.normals)._replace(flat_normals=receivers.flat_normals)
        picture = np.zeros((len(chosen), 3), np.float32)
        assert self._occluders.triangles is not None
        occluders = Occluders(self._occluders.triangles, matrix)
        picture[chosen] = shade(self._tables, receivers, self._shifts[chosen], samples, table.max_per_image, occluders)
        self._texture.write(picture.tobytes(), alignment=1)
        self._texture.use(0)
        self._program["computed"] = 0
        shown = zip(weight, self.luminaire.colour, strict=True)
        self._program["scale"] = tuple(self.luminaire.power * channel * colour for channel, colour in shown)
        begin_adding(self._context, framebuffer)
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what the luminaire holds on the GPU."""
        for resource in (self._array, self._texture):
            resource.release()


def receivers_from_gbuffer(gbuffer: GBufferPixels, chosen: np.ndarray, local_from_world: np.ndarray) -> Receivers:
    """The chosen pixels' surfaces in the luminaire's frame: surface_at of luminaire_surface.glsl."""
    rotation = local_from_world[:3, :3].T
    normal, flat = gbuffer.smooth_normals[chosen], gbuffer.flat_normals[chosen]
    view = gbuffer.rays[chosen]
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    mirrored = view - 2 * np.sum(view * normal, axis=1, keepdims=True) * normal
    diffuse, specular = gbuffer.diffuse[chosen], gbuffer.specular[chosen]
    position = gbuffer.positions[chosen] @ rotation + local_from_world[:3, 3]
    return Receivers(position, normal @ rotation, flat @ rotation, mirrored @ rotation, diffuse["albedo"], specular["reflectance"],
                     specular["lobe"], diffuse["kind"] == MaterialKind.GGX)
