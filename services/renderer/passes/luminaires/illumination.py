"""The light of a scene's luminaires, added to a picture after its surfaces: a draw call a lamp, and its shadow maps when it moved."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.errors import UserError
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS
from vemlight.renderer.luminaire.cells import MapViews, cell_views, cube_views
from vemlight.renderer.luminaire.estimator import Surfaces as Lit
from vemlight.renderer.luminaire.estimator import halton, interleaving, receivers, shade
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.occlusion import Hierarchy, hierarchy_of
from vemlight.renderer.luminaire.photometry import FarField, intensity
from vemlight.renderer.luminaire.shift_invariant import radiance_images
from vemlight.renderer.luminaire.tables import Tables, tables_of
from vemlight.renderer.passes.gbuffer.gbuffer import GBufferTextures, Surfaces
from vemlight.renderer.passes.shadow_maps.alpha_test import AlphaTestedMeshes
from vemlight.renderer.scene.luminaire_table import Luminaire, Vector
from vemlight.renderer.scene.materials import MaterialKind, alpha_test_of
from vemlight.renderer.scene.meshes import box_corners
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose, world_from_object
from vemlight.renderer.scene.vertex_buffers import IndexRange, draw_ranges

MAX_ATLAS_SIDE = 8192  # texels; no GL 4.3 driver refuses it
MAX_CELLS = 2048  # of a lamp: 64 kB of a uniform block
FAR_ROWS, FAR_COLS = 181, 361  # a degree apart, as the finest photometry files have it


class Casters(NamedTuple):
    """The scene as the maps draw it. positions: (n, 3) float32 a vertex. mesh_ranges: each mesh's indices. now: where the meshes stand.
    triangles: for traced shadows, empty where no luminaire asks for them."""

    positions: moderngl.Buffer
    indices: moderngl.Buffer
    mesh_ranges: tuple[IndexRange, ...]
    now: ScenePose
    triangles: Hierarchy


def casters_of(context: moderngl.Context, scene: Scene, now: ScenePose) -> Casters:
    """The scene's triangles on the GPU, and for rays where a luminaire traces its shadows."""
    meshes = [mesh.geometry for mesh in scene.meshes]
    first = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    indices = np.concatenate([mesh.triangles.reshape(-1) + np.uint32(start) for mesh, start in zip(meshes, first[:-1], strict=True)])
    positions = np.concatenate([mesh.positions for mesh in meshes]).astype(np.float32)
    ends = np.cumsum([0, *(mesh.triangles.size for mesh in meshes)]).tolist()
    whole = [alpha_test_of(mesh.material) is None for mesh in scene.meshes]  # the others are drawn by cut.py
    ranges = (IndexRange(start, mesh.triangles.size * solid) for mesh, start, solid in zip(meshes, ends[:-1], whole, strict=True))
    mesh_ranges = tuple(ranges)
    buffers = context.buffer(positions.tobytes()), context.buffer(indices.astype(np.uint32).tobytes())
    return Casters(*buffers, mesh_ranges, now, traced_triangles(scene, now))


def traced_triangles(scene: Scene, now: ScenePose) -> Hierarchy:
    """The scene's triangles in the world, for rays; none where no luminaire traces its shadows."""
    if all(luminaire.table.shadows != "traced" for luminaire in scene.luminaires):
        return hierarchy_of(np.zeros((0, 3, 3)))
    placed = [
        (mesh.geometry.positions @ matrix[:3, :3].T + matrix[:3, 3])[mesh.geometry.triangles]
        for mesh, matrix in zip(scene.meshes, now.matrices, strict=True)
    ]
    return hierarchy_of(np.concatenate(placed))


class MapAtlas:
    """The shadow maps of one lamp, a tile for each view, drawn in one call."""

    def __init__(self, context: moderngl.Context, programs: Programs, casters: Casters, scene: Scene, count: int, size: int) -> None:
        self._context, self._count = context, count
        self._cut = AlphaTestedMeshes(context, programs, scene, "luminaire_map.vert", MAX_MAPS=str(count))
        side = min(MAX_ATLAS_SIDE, context.info["GL_MAX_TEXTURE_SIZE"])
        self._columns = math.ceil(math.sqrt(count))
        self._size = min(size, side // self._columns)
        self._program = programs.program("luminaire_map.vert", "shadow.frag", MAX_MAPS=str(count))
        layout = (casters.positions, "3f", "position")
        self._vao = context.vertex_array(self._program, [layout], casters.indices, index_element_size=4)
        self._buffer = context.buffer(reserve=32 * count, dynamic=True)
        self._texture = context.depth_texture((self._columns * self._size, self._columns * self._size))
        self._texture.compare_func = ""
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._frame = context.framebuffer(depth_attachment=self._texture)
        self._range = (0.0, 0.0)

    def draw(self, views: MapViews, local_from_world: np.ndarray, casters: Casters) -> None:
        self._range = (1 / views.near_m, 1 / views.far_m)
        self._buffer.write(views.rows.tobytes())
        self._buffer.bind_to_uniform_block(0)
        self._describe(self._program)
        self._frame.use()
        self._frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for plane in range(4):
            self._context.enable_direct(0x3000 + plane)  # GL_CLIP_DISTANCE0
        for draw_range in draw_ranges(casters.mesh_ranges, casters.now.matrices):
            self._program["local_from_rest"] = tuple((local_from_world @ draw_range.world_from_rest).T.reshape(-1))
            if draw_range.indices.count:
                self._vao.render(vertices=draw_range.indices.count, first=draw_range.indices.first, instances=self._count)
        if self._cut.program:
            self._describe(self._cut.program)
            self._cut.draw("local_from_rest", local_from_world, casters.now.matrices, self._count)
        for plane in range(4):
            self._context.disable_direct(0x3000 + plane)

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the maps, in texture unit `unit`."""
        self._buffer.bind_to_uniform_block(0)
        self._texture.use(unit)
        program["shadow_maps"] = unit
        self._describe(program)

    def _describe(self, program: moderngl.Program) -> None:
        for name, value in (("map_size", float(self._size)), ("map_columns", float(self._columns)), ("map_range", self._range)):
            if name in program:
                program[name] = value

    def release(self) -> None:
        for thing in (self._vao, self._frame, self._texture, self._buffer, self._cut):
            thing.release()


class Recipe(NamedTuple):
    """What the fragment shader of a kind of lamp reads."""

    shader: str
    constants: dict[str, str]
    textures: Mapping[str, moderngl.Texture | moderngl.TextureArray]
    uniforms: dict[str, object]


class Lamp:
    """One luminaire on the GPU."""

    def __init__(self, context: moderngl.Context, programs: Programs, casters: Casters, scene: Scene, luminaire: Luminaire) -> None:
        self._context, self._casters = context, casters
        self.luminaire = luminaire
        source, table = luminaire.source, luminaire.table
        count = 6 if isinstance(source, FarField) else math.prod(n + SUPPORT_CELLS[source.kind] - 1 for n in source.images.shape[:2])
        if count > MAX_CELLS:
            raise UserError(f"luminaire {source.name}: its {count} cells are more than {MAX_CELLS}; measure it with fewer basis functions")
        recipe = _far_recipe(context, source) if isinstance(source, FarField) else _field_recipe(context, luminaire, source)
        self._textures = recipe.textures
        self._atlas = MapAtlas(context, programs, casters, scene, count, table.shadow_map) if table.shadows == "maps" else None
        self._blank = context.depth_texture((1, 1))
        self._program = programs.program("screen.vert", recipe.shader, MAX_MAPS=str(count), **recipe.constants)
        for name, value in recipe.uniforms.items():
            if name in self._program:
                self._program[name] = value
        self._array = context.vertex_array(self._program, [])
        self._moved = True

    def place(self, world_from_local: np.ndarray, power: float) -> None:
        """Moves, turns and dims the lamp; its maps are drawn anew before the next picture."""
        self._moved = self._moved or not np.array_equal(world_from_local, self.luminaire.world_from_local)
        self.luminaire = self.luminaire._replace(world_from_local=world_from_local, power=power)

    def place_casters(self, casters: Casters, corners: np.ndarray) -> None:
        """Moves what casts shadows; corners (n, 3) of boxes around what moved, before and after: maps that they do not touch are kept."""
        self._casters = casters
        local_from_world = np.linalg.inv(self.luminaire.world_from_local)
        behind = isinstance(self.luminaire.source, LightField) and np.all(corners @ local_from_world[2, :3] + local_from_world[2, 3] < 0)
        self._moved = self._moved or not behind

    def draw_maps(self) -> None:
        """Draws the shadow maps if the lamp, or what casts shadows in its light, moved since they were drawn."""
        if self._atlas is None or not self._moved:
            return
        local_from_world, now = np.linalg.inv(self.luminaire.world_from_local), self._casters.now
        off = local_from_world[:3, :3] @ now.centre + local_from_world[:3, 3]
        far_m = float(np.linalg.norm(off) + np.linalg.norm(now.half)) * 1.01
        source = self.luminaire.source
        views = cube_views(far_m) if isinstance(source, FarField) else cell_views(source, far_m)
        self._atlas.draw(views, local_from_world, self._casters)
        self._moved = False

    def add(self, surfaces: Surfaces, frame: moderngl.Framebuffer, weight: Vector, catching: bool) -> None:
        """Adds the lamp's light on the surfaces, or its irradiance of catchers, to a picture."""
        unit = surfaces.bind(self._program)
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
        self._program["scale"] = tuple(self.luminaire.power * part for part in weight)
        self._program["catching"] = catching
        begin_adding(self._context, frame)
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        for thing in (self._array, self._blank, *self._textures.values(), *([self._atlas] if self._atlas else [])):
            thing.release()


def begin_adding(context: moderngl.Context, frame: moderngl.Framebuffer) -> None:
    frame.use()
    context.enable_only(moderngl.BLEND)
    context.blend_func = moderngl.ONE, moderngl.ONE


def _layers(context: moderngl.Context, images: np.ndarray, dtype: str) -> moderngl.TextureArray:
    n, height, width, components = images.shape
    limit = context.info["GL_MAX_ARRAY_TEXTURE_LAYERS"]
    if n > limit or max(width, height) > context.info["GL_MAX_TEXTURE_SIZE"]:
        raise UserError(f"a luminaire of {n} images of {width} x {height} is beyond this GL ({limit} layers); measure it smaller")
    texture = context.texture_array((width, height, n), components, np.ascontiguousarray(images).tobytes(), alignment=1, dtype=dtype)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture


def _field_recipe(context: moderngl.Context, luminaire: Luminaire, field: LightField) -> Recipe:
    rows, cols, height, width, _ = field.images.shape
    table = luminaire.table
    uniforms: dict[str, object] = {
        "first_m": field.first_m, "grid": (cols, rows), "window": (*field.window_m[:2], *field.pixel_m), "plane_distance": field.distance_m,
        "spacing": field.spacing_m, "samples": table.samples, "most": table.most or table.samples + 1,
    }
    constants = {"SUPPORT_CELLS": str(SUPPORT_CELLS[field.kind]), "IMAGES": str(rows * cols)}
    if luminaire.shift_invariant:
        pixels = radiance_images(field).reshape(-1, height, width, 3)
        sums = np.zeros((rows * cols, height + 1, width + 1, 3))
        sums[:, 1:, 1:] = pixels.cumsum(axis=1, dtype=np.float64).cumsum(axis=2)
        textures = {"images": _layers(context, pixels, "f4"), "colour_sums": _layers(context, sums.astype(np.float32), "f4")}
        return Recipe("luminaire_spots.frag", constants, textures, uniforms)
    tables = tables_of(field)
    words = tables.sums[..., None].view(np.uint32)  # low and high word of each double, as packDouble2x32 takes them
    points = halton(min(table.samples + 2, context.info["GL_MAX_TEXTURE_SIZE"])).astype(np.float32)
    sequence = context.texture((len(points), 1), 2, points.tobytes(), dtype="f4")
    tile = np.indices((table.interleave, table.interleave)).reshape(2, -1)
    shifts = interleaving(tile[0], tile[1], table.interleave).astype(np.float32)
    shift_texture = context.texture((table.interleave, table.interleave), 3, shifts.tobytes(), alignment=1, dtype="f4")
    textures = {"images": _layers(context, tables.pixels, "f4"), "sums": _layers(context, words, "u4"), "sequence": sequence,
                "shifts": shift_texture}
    return Recipe("luminaire_sampled.frag", constants, textures, uniforms)


def _far_recipe(context: moderngl.Context, far: FarField) -> Recipe:
    gamma, c = np.radians(np.arange(FAR_ROWS)), np.radians(np.arange(FAR_COLS))
    # 359.999: the last column is the turn's end, which the direction alone cannot tell from its beginning
    table = intensity(far, direction_from_angles(gamma[:, None], np.minimum(c, np.radians(359.999))[None, :])).astype(np.float32)
    texture = context.texture((FAR_COLS, FAR_ROWS), 1, np.ascontiguousarray(table).tobytes(), alignment=1, dtype="f4")
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = False
    return Recipe("luminaire_far.frag", {}, {"candela": texture}, {})


class TracedLamp:
    """A light field whose shadows are rays, on the CPU: estimator.shade on the surfaces that the GPU saw. Slow; the truth for the maps."""

    def __init__(self, context: moderngl.Context, programs: Programs, casters: Casters, luminaire: Luminaire,
                 size: tuple[int, int]) -> None:
        assert isinstance(luminaire.source, LightField)
        self._context, self._casters, self._size = context, casters, size
        self._tables: Tables = tables_of(luminaire.source)
        self.luminaire = luminaire
        self._program = programs.program("screen.vert", "luminaire_added.frag")
        self._array = context.vertex_array(self._program, [])
        self._texture = context.texture(size, 3, dtype="f4")
        rows, columns = np.indices((size[1], size[0])).reshape(2, -1)
        self._shifts = interleaving(rows, columns, luminaire.table.interleave)

    def place(self, world_from_local: np.ndarray, power: float) -> None:
        self.luminaire = self.luminaire._replace(world_from_local=world_from_local, power=power)

    def place_casters(self, casters: Casters, corners: np.ndarray) -> None:
        """Moves what casts shadows."""
        del corners  # a ray needs no map
        self._casters = casters

    def draw_maps(self) -> None:
        """There are none."""

    def add(self, surfaces: Surfaces, frame: moderngl.Framebuffer, weight: Vector, catching: bool) -> None:
        """Adds the lamp's light on the surfaces, or its irradiance of catchers, to a picture."""
        table, matrix = self.luminaire.table, self.luminaire.world_from_local
        seen = surfaces.read()
        chosen = seen.there & ((seen.diffuse[:, 3] == MaterialKind.SHADOW_CATCHER) == catching)
        lit = _lit(seen, chosen, np.linalg.inv(matrix))
        if catching:
            lit = receivers(lit.positions, lit.normals)._replace(flat_normals=lit.flat_normals)
        picture = np.zeros((len(chosen), 3), np.float32)
        picture[chosen] = shade(self._tables, lit, self._shifts[chosen], table.samples, table.most, self._casters.triangles, matrix)
        self._texture.write(picture.tobytes(), alignment=1)
        self._texture.use(0)
        self._program["computed"] = 0
        self._program["scale"] = tuple(self.luminaire.power * part for part in weight)
        begin_adding(self._context, frame)
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        for thing in (self._array, self._texture):
            thing.release()


def _lit(seen: GBufferTextures, chosen: np.ndarray, local_from_world: np.ndarray) -> Lit:
    """The chosen surfaces in the luminaire's frame, as luminaire_surface.glsl brings them there."""
    turn = local_from_world[:3, :3].T
    normal, flat = (direction_from_octahedron(seen.normals[chosen, k : k + 2]) for k in (0, 2))
    view = seen.rays[chosen]
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    mirrored = view - 2 * np.sum(view * normal, axis=1, keepdims=True) * normal
    diffuse, specular = seen.diffuse[chosen], seen.specular[chosen]
    position = seen.positions[chosen] @ turn + local_from_world[:3, 3]
    return Lit(position, normal @ turn, flat @ turn, mirrored @ turn, diffuse[:, :3], specular[:, :3], specular[:, 3], diffuse[:, 3])


def direction_from_octahedron(p: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) of the octahedron map (n, 2): the function of normals.glsl."""
    z = 1 - np.abs(p).sum(axis=1)
    xy = p - np.copysign(np.maximum(-z, 0)[:, None], p)
    d = np.concatenate([xy, z[:, None]], axis=1)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


class Illumination:
    """All luminaires of a scene."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        """Raises UserError for a luminaire beyond what this GL holds, or a far field with traced shadows."""
        self.lamps: list[Lamp | TracedLamp] = []
        self._scene = scene
        self._casters = casters = casters_of(context, scene, scene_pose(scene, 0.0))
        for luminaire in scene.luminaires:
            if luminaire.table.shadows != "traced":
                self.lamps.append(Lamp(context, programs, casters, scene, luminaire))
            elif isinstance(luminaire.source, FarField):
                raise UserError(f"luminaire {luminaire.source.name}: a far field has shadows = \"maps\" or \"none\"; choose one")
            else:
                self.lamps.append(TracedLamp(context, programs, casters, luminaire, size))

    def place(self, now: ScenePose) -> None:
        """Moves the lamps and what casts shadows in their light."""
        before = self._casters.now
        changed = [k for k in range(len(now.matrices)) if not np.array_equal(before.matrices[k], now.matrices[k])]
        if changed and self.lamps:
            self._casters = self._casters._replace(now=now, triangles=traced_triangles(self._scene, now))
            boxes = [(box_corners(self._scene.meshes[k].geometry), m[k]) for k in changed for m in (before.matrices, now.matrices)]
            corners = np.concatenate([box @ matrix[:3, :3].T + matrix[:3, 3] for box, matrix in boxes])
            for lamp in self.lamps:
                lamp.place_casters(self._casters, corners)
        poses = [(was, pose) for was, pose in zip(before.objects, now.objects, strict=True) if pose.power is not None]
        for lamp, (was, pose) in zip(self.lamps, poses, strict=False):  # a scene made without a file names nothing
            if pose != was:
                lamp.place(world_from_object(pose), pose.power or 0.0)
        self._casters = self._casters._replace(now=now)

    def draw_maps(self) -> None:
        """Draws what shadow maps are out of date."""
        for lamp in self.lamps:
            lamp.draw_maps()

    def add(self, surfaces: Surfaces, frame: moderngl.Framebuffer, weight: Vector, catching: bool = False) -> None:
        """Adds all lamps' light on the surfaces, times `weight`, to a picture; when `catching`, the irradiance of catchers."""
        for lamp in self.lamps:
            lamp.add(surfaces, frame, weight, catching)

    def release(self) -> None:
        """Frees what the lamps hold on the GPU."""
        for thing in (*self.lamps, self._casters.positions, self._casters.indices):
            thing.release()
