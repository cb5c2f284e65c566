"""The shadow maps of many lights in one depth texture, a grid of tiles, drawn by instancing: one draw call for a batch of lights."""

import math
from typing import NamedTuple

import moderngl
import numpy as np

from services.lights import Lights
from services.renderer.cache import no_maps, planned_maps
from services.renderer.casters import Casters, moved_by_m, placed_casters
from services.renderer.geometry import Piece
from services.renderer.programs import Programs
from services.renderer.regions import Regions, region_rows
from services.sphere import luminance

MAX_LIGHTS = 512  # of a batch: 48 kB of a uniform block; GL drivers in use allow 64 kB
FRAME_BYTES = 96  # LightFrame in light.glsl
ALIGNED = 8  # frames; 768 bytes, a multiple of the 256 at which GL drivers let a uniform block begin
GUTTER = 2  # texels at a tile's rim, as in light.glsl
MAX_ATLAS_SIDE = 8192  # texels; 256 MB of depth at 4 bytes, and no GL 4.3 driver refuses it
BOX = ("box_centre", "box_half")
BEYOND = (0x864F, *range(0x3000, 0x3004))  # GL_DEPTH_CLAMP, GL_CLIP_DISTANCE0 to 3, for which moderngl has no name


class Row(NamedTuple):
    """A run of light frames in the buffer."""

    first: int
    count: int


class Batch(NamedTuple):
    """Lights that share the atlas. entries: (m, 12) float32 as frames.comp reads them, row after row.

    rows: the lights of each light region. every: all of them in their order. unknown: one for each map that was drawn since lookups in it
    were kept. maps: those whose maps are drawn now, of which the first
    `above` are above the floor. off: how many lights needed theirs drawn.
    """

    entries: np.ndarray
    rows: tuple[Row, ...]
    every: Row
    unknown: Row
    maps: Row
    above: int
    off: int


class ShadowAtlas:
    """One depth texture with a tile of `tile_size` texels a side for each light of a batch."""

    def __init__(self, context: moderngl.Context, programs: Programs, casters: Casters, regions: Regions, tile_size: int) -> None:
        self._context, self._casters, self._regions = context, casters, regions
        self._set_size(tile_size)
        # The floor has a program of its own: it reaches beyond the box, and so beyond the tile and nearer to a light from below.
        self._programs = [programs.program("shadow.vert", "shadow.frag", MAX_LIGHTS=str(MAX_LIGHTS), BEYOND=beyond) for beyond in "01"]
        self._frames_program = programs.compute("frames.comp")
        self._buffers = (context.buffer(casters.positions.tobytes()), context.buffer(casters.indices.tobytes()))
        layout = [(self._buffers[0], "3f", "position")]
        self._arrays = [context.vertex_array(program, layout, self._buffers[1], index_element_size=4) for program in self._programs]
        self._drawn = no_maps(0)  # of the tiles, for `cached_batch`; empty while each batch draws all its maps
        self._stale = np.zeros(0)  # of the tiles, see planned_maps
        self._looked = np.zeros(0, bool)  # of the tiles: whether kept lookups are of the map that is in them
        self._given = context.buffer(reserve=48, dynamic=True)
        self._frames = context.buffer(reserve=MAX_LIGHTS * FRAME_BYTES)
        self.columns = 0
        self.texture: moderngl.Texture | None = None
        self._frame: moderngl.Framebuffer | None = None
        self._matrices = np.tile(np.eye(4), (1 + max(member.mesh for member in casters.members), 1, 1))
        self._placed = placed_casters(casters, self._matrices)
        self._fit_box()

    def _set_size(self, tile_size: int) -> None:
        self.tile_size = tile_size
        side = min(MAX_ATLAS_SIDE, self._context.info["GL_MAX_TEXTURE_SIZE"])
        self.capacity = min(max(side // tile_size, 1) ** 2, MAX_LIGHTS)

    def place(self, matrices: np.ndarray) -> None:
        """Moves the casters: world_from_rest (n, 4, 4) of the scene's meshes. Maps that are kept age by as much as the casters moved."""
        before = self._placed
        self._placed = placed_casters(self._casters, matrices, before)
        width_m = 2 * float(self._placed.box_half.max())
        self._stale += moved_by_m(self._casters, self._matrices, matrices) / width_m
        self._matrices = matrices
        if not all(np.array_equal(getattr(before, name), getattr(self._placed, name)) for name in (*BOX, "floor_normal")):
            self._drawn = no_maps(len(self._drawn))
            self._fit_box()

    def _fit_box(self) -> None:
        for name in BOX:
            self._frames_program[name] = tuple(getattr(self._placed, name).tolist())

    def batches(self, lights: Lights) -> list[Batch]:
        """The lights that carry power, cut into runs that fit the atlas, each with all its maps to draw; one empty run where none does."""
        lit = np.flatnonzero(np.any(lights.irradiance != 0, axis=1))
        self._drawn, self._looked = no_maps(0), np.zeros(0, bool)
        runs = [lit[first : first + self.capacity] for first in range(0, max(len(lit), 1), self.capacity)]
        return [self._batch(lights, run, np.arange(len(run)), lights.directions[run], np.arange(len(run))) for run in runs]

    def cached_batch(self, lights: Lights, budget: int) -> Batch | None:
        """The lights that carry power as one batch that draws at most `budget` maps, and the others as they were drawn.

        A light keeps its map while it moves less than a texel at the far end of a scene as deep as wide. None when the atlas cannot
        hold them.
        """
        lit = np.flatnonzero(np.any(lights.irradiance != 0, axis=1))
        budget = min(max(budget, 1), max(len(lit), 1))
        if len(lit) > self.capacity:
            return None
        if len(self._drawn) < max(len(lit), 1):
            self._fit(max(len(lit), 1))
            tiles = self.columns**2
            self._drawn, self._stale, self._looked = no_maps(tiles), np.zeros(tiles), np.zeros(tiles, bool)
        strength = luminance(lights.irradiance[lit])
        texel = 1 / (self.tile_size - 2 * GUTTER)
        plan = planned_maps(self._drawn, lights.directions[lit], strength, budget, texel, self._stale)
        self._drawn = plan.drawn
        self._stale[plan.renewed] = 0.0
        self._looked[plan.renewed] = False
        renewed = np.flatnonzero(np.isin(plan.tiles, plan.renewed))
        return self._batch(lights, lit, plan.tiles, plan.drawn[plan.tiles], renewed)._replace(off=plan.off)

    def _batch(self, lights: Lights, lit: np.ndarray, tiles: np.ndarray, map_directions: np.ndarray, renewed: np.ndarray) -> Batch:
        """The lights numbered `lit` with the tile that each reads, the direction of its map, and which of them draw it now."""
        below = map_directions @ self._placed.floor_normal < 0
        light = np.zeros((len(lit), 12), np.float32)
        light[:, 0:3] = lights.directions[lit]
        light[:, 3] = tiles
        light[:, 4:7] = lights.irradiance[lit]
        light[:, 8:11] = map_directions
        drawn = renewed[np.argsort(below[renewed], kind="stable")]
        unknown = np.unique(tiles, return_index=True)[1]
        unknown = unknown[~self._looked[tiles[unknown]]] if len(self._looked) else unknown[:0]
        runs = [*region_rows(self._regions, lights.directions[lit]), np.arange(len(lit)), unknown, drawn]
        rows, padded, first = [], [], 0
        for run in runs:
            rows.append(Row(first, len(run)))
            room = -(-len(run) // ALIGNED) * ALIGNED
            padded.append(np.resize(run, room))
            first += room
        entries = light[np.concatenate(padded).astype(np.int64)]
        every, unknown, maps = rows[-3:]
        return Batch(entries, tuple(rows[:-3]), every, unknown, maps, int(np.count_nonzero(~below[renewed])), len(renewed))

    def looked_up(self, batch: Batch) -> None:
        """Notes that lookups in the maps of `batch.unknown` are kept."""
        self._looked[batch.entries[batch.unknown.first : batch.unknown.first + batch.unknown.count, 3].astype(int)] = True

    def forget_lookups(self) -> None:
        """Notes that the surfaces have changed on which lookups are kept."""
        self._looked[:] = False

    def resize(self, tile_size: int) -> None:
        """Draws all maps anew, with `tile_size` texels a side."""
        self._drawn = no_maps(0)
        self._free()
        self.columns = 0
        self._set_size(tile_size)

    def draw(self, batch: Batch) -> None:
        """Uploads the batch and draws the maps that it renews."""
        count = batch.maps.count
        if len(self._drawn) == 0:
            self._fit(max(count, 1))
        assert self._frame is not None
        self._make_frames(batch)
        self._frame.use()
        self._clear(batch)
        if count == 0:
            return
        self.bind_row(batch.maps)
        self._context.depth_func = "<"
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._instances(0, self._placed.closed, 0, count)
        self._context.disable(moderngl.CULL_FACE)
        self._instances(0, self._placed.open, 0, count)
        for flag in BEYOND:
            self._context.enable_direct(flag)
        self._instances(1, self._placed.floor, batch.above, count - batch.above)
        for flag in BEYOND:
            self._context.disable_direct(flag)

    def _clear(self, batch: Batch) -> None:
        """Empties the tiles whose maps are drawn anew."""
        assert self._frame is not None
        if len(self._drawn) == 0:
            self._frame.clear(depth=1.0)
            return
        tiles = batch.entries[batch.maps.first : batch.maps.first + batch.maps.count, 3].astype(int)
        for tile in tiles.tolist():
            corner = (tile % self.columns * self.tile_size, tile // self.columns * self.tile_size)
            self._frame.clear(depth=1.0, viewport=(*corner, self.tile_size, self.tile_size))

    def _make_frames(self, batch: Batch) -> None:
        """Has the GPU rebuild the light frames of all rows from the lights' directions."""
        count = len(batch.entries)
        if self._given.size < batch.entries.nbytes:
            self._given.orphan(batch.entries.nbytes)
            self._frames.orphan((count + MAX_LIGHTS) * FRAME_BYTES)  # a whole uniform block lies behind the last row's beginning
        self._given.write(batch.entries.tobytes())
        self._given.bind_to_storage_buffer(1)
        self._frames.bind_to_storage_buffer(2)
        self._describe(self._frames_program)
        self._frames_program["light_count"] = count
        self._frames_program.run(group_x=(count + 63) // 64)
        self._context.memory_barrier()

    def bind_row(self, row: Row) -> None:
        """Makes a row of the batch drawn last the `Lights` of the programs that follow."""
        self._frames.bind_to_uniform_block(0, offset=row.first * FRAME_BYTES, size=MAX_LIGHTS * FRAME_BYTES)

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the atlas on a texture unit and the uniforms of light.glsl."""
        assert self.texture is not None
        self.texture.use(unit)
        program["atlas"] = unit
        self._describe(program)

    def _instances(self, beyond: int, pieces: tuple[Piece, ...], first_light: int, count: int) -> None:
        program = self._programs[beyond]
        self._describe(program)
        for piece in pieces if count else ():
            program["first_light"] = first_light
            program["world_from_rest"] = tuple(piece.world_from_rest.T.reshape(-1))
            self._arrays[beyond].render(vertices=piece.indices.count, first=piece.indices.first, instances=count)

    def _describe(self, program: moderngl.Program | moderngl.ComputeShader) -> None:
        side = self.tile_size * self.columns
        sizes = {"tile_size": float(self.tile_size), "tile_columns": float(self.columns), "atlas_texel": 1 / side}
        for name in sizes.keys() & set(program):  # compilers leave out what a shader does not use
            program[name] = sizes[name]

    def _fit(self, count: int) -> None:
        """Makes the texture hold `count` tiles and no row more: where a tile lies, and so how it rounds, follows from the lights alone."""
        columns = math.ceil(math.sqrt(count))
        if columns == self.columns:
            return
        self._free()
        self.columns = columns
        side = self.columns * self.tile_size
        self.texture = self._context.depth_texture((side, side))
        self.texture.compare_func = ""  # the shader compares: each of the four texels against its own depth
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.texture.repeat_x = self.texture.repeat_y = False
        self._frame = self._context.framebuffer(depth_attachment=self.texture)

    def _free(self) -> None:
        for thing in (self._frame, self.texture):
            if thing is not None:
                thing.release()
        self.texture = self._frame = None

    def release(self) -> None:
        """Frees what the atlas holds on the GPU."""
        self._free()
        for thing in (*self._arrays, *self._buffers, self._given, self._frames):
            thing.release()
