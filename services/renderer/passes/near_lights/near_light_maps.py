"""Shadow maps of near lights: a depth texture with six tiles for each, of which those are drawn in which a receiver lies."""

import math

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import CASTER_VERTEX, NEAR_SHADOW_VIEW
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.luminaires.occluders import SceneOccluders
from vemlight.renderer.passes.near_lights.near_light_plan import NearBatch
from vemlight.renderer.passes.near_lights.near_light_views import FACES, map_resolution, receiver_boxes, shadow_views
from vemlight.renderer.passes.shadow_maps.alpha_test import AlphaTestedMeshes
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose
from vemlight.renderer.scene.vertex_buffers import draw_ranges

GL_CLIP_DISTANCE0 = 0x3000
CLIP_PLANES = 4  # the sides of a tile


class NearLightMaps:
    """For a scene's near lights. shadow_map: texels a side of each map; None: as many as their number allows."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, scene: Scene, occluders: SceneOccluders, shadow_map: int | None
    ) -> None:
        self._context, self._occluders, self._shadow_map = context, occluders, shadow_map
        self._alpha_tested = AlphaTestedMeshes(context, programs, scene, "near_light_map.vert", NEAR_LIGHT=1)
        self._program = programs.program("near_light_map.vert", "near_light_map.frag", ALPHA_TEST=0)
        layout = CASTER_VERTEX.content(occluders.positions, self._program)
        self._array = context.vertex_array(self._program, [layout], occluders.indices, index_element_size=4)
        self._drawn, self._views = (context.buffer(reserve=NEAR_SHADOW_VIEW.dtype.itemsize, dynamic=True) for _ in range(2))
        self._every = np.zeros((0, FACES), NEAR_SHADOW_VIEW.dtype)  # of all slots
        self._resolution = self._columns = 0
        self._texture: moderngl.Texture | None = None
        self._frame: moderngl.Framebuffer | None = None

    def draw(self, batch: NearBatch, pose: ScenePose) -> None:
        """Draws the maps of those lights of a batch that are traced anew, of a scene that stands so."""
        self._fit(batch.slots)
        assert self._frame
        if not len(batch.traced):
            return
        own, slots = batch.traced, batch.layers[batch.traced]
        boxes = receiver_boxes(self._occluders.corners_in(pose))
        views = shadow_views(batch.lights.at[own], batch.lights.radius[own], slots, boxes, self._resolution, self._columns)
        self._every[slots] = views
        self._views.orphan(max(self._every.nbytes, 16))
        self._views.write(self._every.tobytes())
        self._frame.use()
        for x, y in views["corner"].reshape(-1, 2).astype(int).tolist():
            self._frame.clear(depth=1.0, viewport=(x, y, self._resolution, self._resolution))
        seen = views.reshape(-1)[np.all(views["high"] > views["low"], axis=-1).reshape(-1)]
        if len(seen):
            self._drawn.orphan(seen.nbytes)
            self._drawn.write(seen.tobytes())
            self._draw_casters(len(seen), pose)

    def _draw_casters(self, count: int, pose: ScenePose) -> None:
        self._drawn.bind_to_storage_buffer(3)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for plane in range(CLIP_PLANES):
            self._context.enable_direct(GL_CLIP_DISTANCE0 + plane)
        self._set_uniforms(self._program)
        for draw_range in draw_ranges(self._occluders.mesh_ranges, pose.matrices):
            self._program["world_from_rest"] = tuple(draw_range.world_from_rest.T.reshape(-1))
            if draw_range.indices.count:
                self._array.render(vertices=draw_range.indices.count, first=draw_range.indices.first, instances=count)
        if self._alpha_tested.program:
            self._set_uniforms(self._alpha_tested.program)
            self._alpha_tested.draw("world_from_rest", np.eye(4), pose.matrices, count)
        for plane in range(CLIP_PLANES):
            self._context.disable_direct(GL_CLIP_DISTANCE0 + plane)

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the maps, on a texture unit."""
        assert self._texture
        self._views.bind_to_storage_buffer(4)
        self._texture.use(unit)
        program["near_maps"] = unit
        program["map_size"] = float(self._resolution)

    def _set_uniforms(self, program: moderngl.Program) -> None:
        assert self._texture
        program["map_size"] = float(self._resolution)
        program["atlas_size"] = tuple(map(float, self._texture.size))

    def _fit(self, slots: int) -> None:
        """Has room for the maps of so many slots; where there was another number, nothing in them is read again."""
        if len(self._every) == slots and self._texture:
            return
        self._free()
        self._every = np.zeros((slots, FACES), NEAR_SHADOW_VIEW.dtype)
        self._resolution = map_resolution(slots, self._shadow_map)
        self._columns = math.ceil(math.sqrt(FACES * slots))
        rows = math.ceil(FACES * slots / self._columns)
        self._texture = self._context.depth_texture((self._columns * self._resolution, rows * self._resolution))
        self._texture.compare_func = ""
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._frame = self._context.framebuffer(depth_attachment=self._texture)

    def _free(self) -> None:
        for resource in (self._frame, self._texture):
            if resource is not None:
                resource.release()
        self._texture = self._frame = None

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        self._free()
        for resource in (self._array, self._drawn, self._views, self._alpha_tested):
            resource.release()
