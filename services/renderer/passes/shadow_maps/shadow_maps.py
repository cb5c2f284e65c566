"""The shadow maps of many lights in one depth texture, each as large as its light deserves, drawn by instancing: a call for each size."""

from collections.abc import Callable
from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.renderer.frame_budget import map_work
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.lights.light_regions import Regions, region_rows
from vemlight.renderer.passes.shadow_maps.alpha_test import AlphaTestedMeshes
from vemlight.renderer.passes.shadow_maps.casters import Casters, moved_by_m, placed_casters
from vemlight.renderer.passes.shadow_maps.shadow_map_cache import Needs, Slots, map_needs, planned_maps
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import Packing, Sizing, map_steps, packed
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.vertex_buffers import DrawRange

MAX_LIGHTS = 512  # of a batch: 56 kB of a uniform block; GL drivers in use allow 64 kB
FRAME_BYTES = 112  # LightFrame in light.glsl
ALIGNED = 16  # frames; 1792 bytes, a multiple of the 256 at which GL drivers let a uniform block begin
MAX_ATLAS_SIDE = 8192  # texels; 256 MB of depth at 4 bytes, and no GL 4.3 driver refuses it
SLACK = 1 / 8  # of the slots of a size: more than its lights need, for lights that come
BOX = ("box_centre", "box_half")
BEYOND = (0x864F, *range(0x3000, 0x3004))  # GL_DEPTH_CLAMP, GL_CLIP_DISTANCE0 to 3, for which moderngl has no name


class Row(NamedTuple):
    """A run of light frames in the buffer."""

    first: int
    count: int


class Run(NamedTuple):
    """Maps that are drawn together: of which level of the casters, from which frame on, how many, and of how many the floor casts too."""

    level: int
    first: int
    count: int
    below: int


class Batch(NamedTuple):
    """LightSet that share the atlas. entries: (m, 16) float32 as frames.comp reads them, row after row.

    rows: the lights of each light region. every: all of them in their order. unknown: one for each map that was drawn since lookups in it
    were kept. maps: those whose maps are drawn now; runs: the same by the size of map. off: how many lights needed theirs drawn; work and
    off_work: what the drawn and the needed ones cost, as pace.map_work counts. packing: where the tiles lie.
    """

    entries: np.ndarray
    rows: tuple[Row, ...]
    every: Row
    unknown: Row
    maps: Row
    runs: tuple[Run, ...]
    off: int
    work: float
    off_work: float
    packing: Packing

    @property
    def texels(self) -> np.ndarray:
        """On a side of each light's map, (n,) int64."""
        return self.entries[self.every.first : self.every.first + self.every.count, 14].astype(np.int64)


class ShadowAtlas:
    """One depth texture with a tile for each light of a batch, of the size that `sizing` gives it."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, scene: Scene, casters: Casters, regions: Regions, sizing: Sizing
    ) -> None:
        self._context, self._casters, self._regions, self._sizing = context, casters, regions, sizing
        self._most = min(MAX_ATLAS_SIDE, 1 << (context.info["GL_MAX_TEXTURE_SIZE"].bit_length() - 1))
        # The floor has a program of its own: it reaches beyond the box, and so beyond the tile and nearer to a light from below.
        self._programs = [programs.program("shadow.vert", "shadow.frag", MAX_LIGHTS=str(MAX_LIGHTS), BEYOND=beyond) for beyond in "01"]
        self._cut = AlphaTestedMeshes(context, programs, scene, "shadow.vert", MAX_LIGHTS=str(MAX_LIGHTS), BEYOND="0")
        self._frames_program = programs.compute("frames.comp")
        self._buffers = (context.buffer(casters.positions.tobytes()), context.buffer(casters.indices.tobytes() or bytes(4)))
        layout = [(self._buffers[0], "3f", "position")]
        self._arrays = [context.vertex_array(program, layout, self._buffers[1], index_element_size=4) for program in self._programs]
        self._slots: Slots | None = None  # for `cached_batch`; None while each batch draws all its maps
        self._looked = np.zeros(0, bool)  # of the slots: whether kept lookups are of the map that is in them
        self._steps: dict[int, int] = {}  # of the lights, by their ids, in the last cached batch
        self._given = context.buffer(reserve=64, dynamic=True)
        self._frames = context.buffer(reserve=MAX_LIGHTS * FRAME_BYTES)
        self._packing = Packing(np.zeros((0, 2), np.int64), 0, 0)
        self.texture: moderngl.Texture | None = None
        self._frame: moderngl.Framebuffer | None = None
        self._matrices = np.tile(np.eye(4), (1 + max(member.mesh for member in casters.every), 1, 1))
        self._placed = placed_casters(casters, self._matrices)
        self._fit_box()

    @property
    def layers(self) -> int:
        """How many maps there is room for."""
        return len(self._packing.corners)

    def place(self, matrices: np.ndarray) -> None:
        """Moves the casters: world_from_rest (n, 4, 4) of the scene's meshes. Maps that are kept age by as much as the casters moved."""
        before = self._placed
        self._placed = placed_casters(self._casters, matrices, before)
        width_m = 2 * float(self._placed.box_half.max())
        if self._slots:
            self._slots = self._slots._replace(stale=self._slots.stale + moved_by_m(self._casters, self._matrices, matrices) / width_m)
        self._matrices = matrices
        if not all(np.array_equal(getattr(before, name), getattr(self._placed, name)) for name in (*BOX, "floor_normal")):
            self._slots = None
            self._fit_box()

    def _fit_box(self) -> None:
        for name in BOX:
            self._frames_program[name] = tuple(getattr(self._placed, name).tolist())

    def batches(self, lights: LightSet, texels: int | None = None) -> list[Batch]:
        """The lights that carry power, cut into runs that fit the atlas, each with all its maps to draw; one empty run where none does.

        texels: of each map, in place of what the lights deserve.
        """
        lit, power = _lit(lights)
        self._slots, self._looked = None, np.zeros(0, bool)
        sizes = np.full(len(lit), texels) if texels else self._sizing.largest >> map_steps(self._sizing, lights.directions[lit], power)
        made, first = [], 0
        while first < len(lit) or not made:
            packing = self._first_that_fit(sizes[first : first + MAX_LIGHTS])
            count = len(packing.corners)
            run = lit[first : first + count]
            slots = Slots(sizes[first : first + count], lights.directions[run], np.zeros(count))
            made.append(self._batch(lights, run, np.arange(count), slots, np.arange(count), packing))
            first += count
        return made

    def _first_that_fit(self, sizes: np.ndarray) -> Packing:
        """As many of the first tiles as the largest atlas holds; one always fits."""
        if whole := packed(sizes, self._most):
            return whole
        low, high = 1, len(sizes) - 1
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if packed(sizes[:middle], self._most) else (low, middle - 1)
        fitting = packed(sizes[:low], self._most)
        assert fitting
        return fitting

    def cached_batch(self, lights: LightSet, halved: int, affordable: Callable[[np.ndarray], int]) -> Batch | None:
        """The lights that carry power as one batch that draws the maps for which there is time, and the others as they were drawn.

        A light keeps its map while it moves less than a texel of it at the far end of a scene as deep as wide. halved: by how many steps
        maps are smaller than the lights deserve. affordable: how many maps are drawn, of those that must be, by the work (k,) that each
        costs, the worst first. None when the atlas cannot hold them all.
        """
        lit, power = _lit(lights)
        ids = lights.ids[lit].tolist()
        directions, before = lights.directions[lit], np.array([self._steps.get(i, -1) for i in ids], np.int64)
        steps = map_steps(self._sizing, directions, power, halved, before)
        self._steps = dict(zip(ids, steps.tolist(), strict=True))
        sizes = self._sizing.largest >> steps
        if len(lit) > MAX_LIGHTS or not self._make_room(steps):
            return None
        assert self._slots is not None
        fresh = bool(np.isnan(self._slots.drawn).all())
        needs = map_needs(self._slots, directions, power, sizes) if not fresh else Needs(np.zeros(len(lit), np.int64), np.arange(len(lit)))
        work = map_work(sizes[needs.off])
        plan = planned_maps(self._slots, needs, directions, sizes, len(lit) if fresh else max(affordable(work), 1))
        self._slots = plan.slots
        self._looked[plan.renewed] = False
        renewed = np.flatnonzero(np.isin(plan.tiles, plan.renewed))
        batch = self._batch(lights, lit, plan.tiles, plan.slots, renewed, self._packing)
        return batch._replace(off=len(work), off_work=float(work.sum()))

    def _make_room(self, steps: np.ndarray) -> bool:
        """Whether there is a slot of its size for each light; where some are missing all slots are made anew, and empty."""
        sizes = np.array(self._sizing.sizes)
        need = np.bincount(steps, minlength=len(sizes))
        have = np.count_nonzero(self._slots.sizes == sizes[:, None], axis=1) if self._slots else np.zeros_like(need)
        if self._slots and np.all(have >= need):
            return True
        roomy = need + np.ceil(SLACK * need).astype(np.int64)
        grown = np.maximum(roomy, have)
        for counts in (grown if grown.sum() <= 2 * roomy.sum() else roomy, need):
            wanted = np.repeat(sizes, counts)
            if packing := packed(wanted, self._most):
                self._fit(packing)
                self._slots, self._looked = Slots.empty(wanted), np.zeros(len(wanted), bool)
                return True
        return False

    def _batch(
        self, lights: LightSet, lit: np.ndarray, tiles: np.ndarray, slots: Slots, renewed: np.ndarray, packing: Packing
    ) -> Batch:
        """The lights numbered `lit` with the slot that each reads and which of them draw it now."""
        directions, sizes = slots.drawn[tiles], slots.sizes[tiles]
        below = directions @ self._placed.floor_normal < 0
        light = np.zeros((len(lit), 16), np.float32)
        light[:, 0:3] = lights.directions[lit]
        light[:, 4:7] = lights.irradiance[lit]
        light[:, 8:11] = directions
        light[:, 12:14], light[:, 14], light[:, 15] = packing.corners[tiles], sizes, tiles
        level = np.array(self._casters.levels)[np.searchsorted(-np.array(self._sizing.sizes), -sizes).clip(0, self._sizing.steps)]
        drawn = renewed[np.lexsort((below[renewed], level[renewed]))]
        unknown = np.unique(tiles, return_index=True)[1]
        unknown = unknown[~self._looked[tiles[unknown]]] if len(self._looked) else unknown[:0]
        parts = [*region_rows(self._regions, lights.directions[lit]), np.arange(len(lit)), unknown, drawn]
        rows, padded, first = [], [], 0
        for part in parts:
            rows.append(Row(first, len(part)))
            room = -(-len(part) // ALIGNED) * ALIGNED
            padded.append(np.resize(part, room))
            first += room
        entries = light[np.concatenate(padded).astype(np.int64)]
        every, unknown, maps = rows[-3:]
        runs = []
        for own in np.unique(level[drawn]).tolist():
            members = np.flatnonzero(level[drawn] == own)
            runs.append(Run(own, int(members[0]), len(members), int(np.count_nonzero(below[drawn[members]]))))
        work = float(map_work(sizes[renewed]).sum())
        return Batch(entries, tuple(rows[:-3]), every, unknown, maps, tuple(runs), len(renewed), work, work, packing)

    def looked_up(self, batch: Batch) -> None:
        """Notes that lookups in the maps of `batch.unknown` are kept."""
        self._looked[batch.entries[batch.unknown.first : batch.unknown.first + batch.unknown.count, 15].astype(int)] = True

    def forget_lookups(self) -> None:
        """Notes that the surfaces have changed on which lookups are kept."""
        self._looked[:] = False

    def draw(self, batch: Batch) -> None:
        """Uploads the batch and draws the maps that it renews."""
        self._fit(batch.packing)
        assert self._frame is not None
        self._make_frames(batch)
        self._frame.use()
        self._clear(batch)
        if batch.maps.count == 0:
            return
        self.bind_row(batch.maps)
        self._context.depth_func = "<"
        for run in batch.runs:
            level = self._placed.levels[run.level]
            self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._instances(0, level.closed, run.first, run.count)
            self._context.disable(moderngl.CULL_FACE)
            self._instances(0, level.open, run.first, run.count)
            self._draw_cut(run.first, run.count)
            for flag in BEYOND:
                self._context.enable_direct(flag)
            self._instances(1, self._placed.floor, run.first + run.count - run.below, run.below)
            for flag in BEYOND:
                self._context.disable_direct(flag)

    def _clear(self, batch: Batch) -> None:
        """Empties the tiles whose maps are drawn anew."""
        assert self._frame is not None
        if self._slots is None or batch.maps.count == self.layers:
            self._frame.clear(depth=1.0)
            return
        tiles = batch.entries[batch.maps.first : batch.maps.first + batch.maps.count, 12:15].astype(int)
        for x, y, size in tiles.tolist():
            self._frame.clear(depth=1.0, viewport=(x, y, size, size))

    def _make_frames(self, batch: Batch) -> None:
        """Has the GPU rebuild the light frames of all rows from the lights' directions."""
        count = len(batch.entries)
        if self._given.size < batch.entries.nbytes:
            self._given.orphan(batch.entries.nbytes)
            self._frames.orphan((count + MAX_LIGHTS) * FRAME_BYTES)  # a whole uniform block lies behind the last row's beginning
        self._given.write(batch.entries.tobytes())
        self._given.bind_to_storage_buffer(1)
        self._frames.bind_to_storage_buffer(2)
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

    def _instances(self, beyond: int, draw_ranges: tuple[DrawRange, ...], first_light: int, count: int) -> None:
        program = self._programs[beyond]
        self._describe(program)
        for draw_range in draw_ranges if count else ():
            program["first_light"] = first_light
            program["world_from_rest"] = tuple(draw_range.world_from_rest.T.reshape(-1))
            if draw_range.indices.count:
                self._arrays[beyond].render(vertices=draw_range.indices.count, first=draw_range.indices.first, instances=count)

    def _draw_cut(self, first_light: int, count: int) -> None:
        if self._cut.program:
            self._describe(self._cut.program)
            self._cut.program["first_light"] = first_light
            self._cut.draw("world_from_rest", np.eye(4), self._matrices, count)

    def _describe(self, program: moderngl.Program) -> None:
        program["atlas_texel"] = (1 / self._packing.width, 1 / self._packing.height)

    def _fit(self, packing: Packing) -> None:
        """Makes the texture as large as the tiles need: how they lie, and so how they round, follows from the lights alone."""
        before, self._packing = self._packing, packing
        if self.texture is not None and (before.width, before.height) == (packing.width, packing.height):
            return
        self._free()
        self.texture = self._context.depth_texture((packing.width, packing.height))
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
        for thing in (*self._arrays, *self._buffers, self._given, self._frames, self._cut):
            thing.release()


def _lit(lights: LightSet) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the lights that carry power, and that power, luminance."""
    lit = np.flatnonzero(np.any(lights.irradiance != 0, axis=1))
    return lit, luminance_from_rgb(lights.irradiance[lit].astype(np.float64))
