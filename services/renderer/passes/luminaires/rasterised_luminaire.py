"""A luminaire drawn by the GPU: its tables as textures, its shadow maps, and one draw call that adds its light to a picture."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.errors import UserError
from vemlight.light.far_field import FarField, intensity
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS
from vemlight.renderer.luminaire.estimator import halton, interleaved_shifts
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.shadow_views import cell_views, cube_views
from vemlight.renderer.luminaire.shift_invariant import radiance_images
from vemlight.renderer.luminaire.tables import summed_area_tables
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.luminaires.depth_range import depth_range
from vemlight.renderer.passes.luminaires.luminaire_atlas import LuminaireAtlas
from vemlight.renderer.passes.luminaires.occluders import SceneOccluders
from vemlight.renderer.scene.luminaire_table import Luminaire, Vector
from vemlight.renderer.scene.scene import Scene

MAX_CELLS = 2048  # of a luminaire: 64 kB of a uniform block, the most that common drivers take; any value in 512..2048 does
FAR_ROWS, FAR_COLS = 181, 361  # a degree apart, as the finest photometry files have it; finer does no harm


class ShaderInputs(NamedTuple):
    """What the fragment shader of a kind of luminaire reads."""

    shader: str
    constants: dict[str, str]
    textures: Mapping[str, moderngl.Texture | moderngl.TextureArray]
    uniforms: dict[str, object]


class RasterisedLuminaire:
    """One luminaire on the GPU, with shadow maps or without shadows."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, occluders: SceneOccluders, scene: Scene, luminaire: Luminaire
    ) -> None:
        """Raises UserError for a luminaire beyond what this GL holds."""
        self._context, self._occluders = context, occluders
        self.luminaire = luminaire
        source, table = luminaire.source, luminaire.table
        count = 6 if isinstance(source, FarField) else math.prod(n + SUPPORT_CELLS[source.basis_kind] - 1 for n in source.images.shape[:2])
        if count > MAX_CELLS:
            raise UserError(f"luminaire {source.name}: its {count} cells are more than {MAX_CELLS}; measure it with fewer basis functions")
        inputs = far_inputs(context, source) if isinstance(source, FarField) else field_inputs(context, luminaire, source)
        self._textures = inputs.textures
        self._atlas = LuminaireAtlas(context, programs, occluders, scene, count, table.shadow_map) if table.shadows == "maps" else None
        self._blank = context.depth_texture((1, 1))
        self._program = programs.program("screen.vert", inputs.shader, MAX_MAPS=str(count), **inputs.constants)
        for name, value in inputs.uniforms.items():
            if name in self._program:
                self._program[name] = value
        self._array = context.vertex_array(self._program, [])

    def place(self, luminaire: Luminaire, occluders: SceneOccluders) -> None:
        """Moves, turns and dims the luminaire, and moves what casts shadows in its light."""
        self.luminaire, self._occluders = luminaire, occluders

    def draw_maps(self) -> None:
        """Draws the shadow maps."""
        if self._atlas is None:
            return
        world_from_local, source = self.luminaire.world_from_local, self.luminaire.source
        depths = depth_range(world_from_local[:3, 3], self._occluders.corners_in(self._occluders.pose))
        views = cube_views(*depths) if isinstance(source, FarField) else cell_views(source, *depths)
        self._atlas.draw(views, np.linalg.inv(world_from_local), self._occluders)

    def add(self, g_buffer: GBuffer, framebuffer: moderngl.Framebuffer, weight: Vector, catchers: bool) -> None:
        """Adds its light on the surfaces, or its irradiance of shadow catchers, to a picture."""
        unit = g_buffer.bind(self._program)
        for number, (name, texture) in enumerate(self._textures.items(), unit + 1):
            texture.use(number)
            if name in self._program:
                self._program[name] = number
        if self._atlas:
            self._atlas.bind(self._program, unit)
        else:
            self._blank.use(unit)
            self._program["shadow_maps"] = unit
        self._program["shadows"] = float(self._atlas is not None)
        self._program["local_from_world"] = tuple(np.linalg.inv(self.luminaire.world_from_local).T.reshape(-1))
        shown = zip(weight, self.luminaire.colour, strict=True)
        self._program["scale"] = tuple(self.luminaire.power * channel * colour for channel, colour in shown)
        self._program["catchers"] = catchers
        begin_adding(self._context, framebuffer)
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what the luminaire holds on the GPU."""
        for resource in (self._array, self._blank, *self._textures.values(), *([self._atlas] if self._atlas else [])):
            resource.release()


def begin_adding(context: moderngl.Context, framebuffer: moderngl.Framebuffer) -> None:
    """Lets draw calls add to a framebuffer."""
    framebuffer.use()
    context.enable_only(moderngl.BLEND)
    context.blend_func = moderngl.ONE, moderngl.ONE


def field_inputs(context: moderngl.Context, luminaire: Luminaire, field: LightField) -> ShaderInputs:
    """What the shader of a light field reads."""
    rows, cols = field.images.shape[:2]
    samples = luminaire.drawn.samples
    uniforms: dict[str, object] = {
        "first_m": field.first_m, "grid": (cols, rows), "window": (*field.window_m[:2], *field.pixel_m), "plane_distance": field.distance_m,
        "spacing": field.spacing_m, "samples": samples, "max_per_image": luminaire.table.max_per_image or samples + 1,
    }
    constants = {"SUPPORT_CELLS": str(SUPPORT_CELLS[field.basis_kind]), "IMAGES": str(rows * cols)}
    if luminaire.drawn.shift_invariant:
        return ShaderInputs("luminaire_spots.frag", constants, spot_textures(context, field), uniforms)
    textures = sampling_textures(context, field, samples, luminaire.table.interleave)
    return ShaderInputs("luminaire_sampled.frag", constants, textures, uniforms)


def spot_textures(context: moderngl.Context, field: LightField) -> dict[str, moderngl.TextureArray]:
    """E' of each image, and its summed-area table per channel."""
    rows, cols, height, width, _ = field.images.shape
    pixels = radiance_images(field).reshape(-1, height, width, 3)
    sums = np.zeros((rows * cols, height + 1, width + 1, 3))
    sums[:, 1:, 1:] = pixels.cumsum(axis=1, dtype=np.float64).cumsum(axis=2)
    return {"images": _layers(context, pixels, "f4"), "colour_sums": _layers(context, sums.astype(np.float32), "f4")}


def sampling_textures(
    context: moderngl.Context, field: LightField, samples: int, interleave: int
) -> dict[str, moderngl.Texture | moderngl.TextureArray]:
    """The images, their summed-area tables as doubles, the sequence, and its shifts over a tile of pixels."""
    tables = summed_area_tables(field)
    words = tables.sums[..., None].view(np.uint32)  # low and high word of each double, as packDouble2x32 takes them
    points = halton(min(samples + 2, context.info["GL_MAX_TEXTURE_SIZE"])).astype(np.float32)
    sequence = context.texture((len(points), 1), 2, points.tobytes(), dtype="f4")
    tile = np.indices((interleave, interleave)).reshape(2, -1)
    shifts = interleaved_shifts(tile[0], tile[1], interleave).astype(np.float32)
    shift_texture = context.texture((interleave, interleave), 3, shifts.tobytes(), alignment=1, dtype="f4")
    images, sums = _layers(context, tables.pixels, "f4"), _layers(context, words, "u4")
    return {"images": images, "sums": sums, "sequence": sequence, "shifts": shift_texture}


def far_inputs(context: moderngl.Context, far: FarField) -> ShaderInputs:
    """What the shader of a far field reads: candela, C along x and gamma along y, both ends on texel centres."""
    gamma, c = np.radians(np.arange(FAR_ROWS)), np.radians(np.arange(FAR_COLS))
    # 359.999: the last column is the end of the circle, which a direction alone cannot distinguish from its beginning
    table = intensity(far, direction_from_angles(gamma[:, None], np.minimum(c, np.radians(359.999))[None, :])).astype(np.float32)
    texture = context.texture((FAR_COLS, FAR_ROWS), 1, np.ascontiguousarray(table).tobytes(), alignment=1, dtype="f4")
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = False
    return ShaderInputs("luminaire_far.frag", {}, {"candela": texture}, {})


def _layers(context: moderngl.Context, images: np.ndarray, dtype: str) -> moderngl.TextureArray:
    """An array texture of images (n, height, width, components), unfiltered."""
    n, height, width, components = images.shape
    limit = context.info["GL_MAX_ARRAY_TEXTURE_LAYERS"]
    if n > limit or max(width, height) > context.info["GL_MAX_TEXTURE_SIZE"]:
        raise UserError(f"a luminaire of {n} images of {width} x {height} is beyond this GL ({limit} layers); measure it smaller")
    texture = context.texture_array((width, height, n), components, np.ascontiguousarray(images).tobytes(), alignment=1, dtype=dtype)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
