"""One bounce of light, added to a picture: gathered by rays on the processor for blocks of pixels, brought to all pixels here."""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import moderngl
import numpy as np

from vemlight.light.extent import Extents, received
from vemlight.light.light_set import LightSet
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.coarse_surfaces import CoarseSurfaces
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.near_lights.near_light_plan import LitBy
from vemlight.renderer.rays.bounce import SAME_NORMAL, SAME_PLANE, Blocks, BlockSurfaces, Bounce, Light, block_pixels
from vemlight.renderer.rays.reflecting import reflecting_meshes
from vemlight.renderer.rays.surfaces import Surfaces
from vemlight.renderer.rays.tracing import RayTracer
from vemlight.renderer.scene.scene import Scene

RAYS = 64
LIVE_SHADOW_RAYS, STILL_SHADOW_RAYS = 4, 8  # live and for files


# Pixels on a side of a block: a bounce changes slowly but at contacts, where the direct light's shadows count more. Live there are about as
# many blocks as in 320 x 240 pixels, so that gathering takes the same time whatever the picture's size: 10 ms on two cores.
BLOCK, LIVE_BLOCKS = 4, 4800


def block_side(size: tuple[int, int], live: bool) -> int:
    """How many pixels a block has on a side in pictures of `size` (width, height)."""
    return max(BLOCK, round((size[0] * size[1] / LIVE_BLOCKS) ** 0.5)) if live else BLOCK


def ground_albedo(normal: np.ndarray | None, lights: LightSet) -> np.ndarray:
    """Albedo (3,) of the real ground that a catcher with this `normal` (3,) stands for: the light that comes up through its plane over that
    which falls on it, at most 1; 0 where no light comes up, or none falls.
    """
    if normal is None:
        return np.zeros(3)
    down, up = (received(side * lights.directions @ normal, Extents.of(lights)) @ lights.irradiance for side in (1, -1))
    return np.minimum(np.divide(up, down, out=np.zeros(3), where=down > 0), 1)


def light_of(lit_by: LitBy, origin: np.ndarray) -> Light:
    """Lights as they fall on where rays end: round, of the mean variance of their two axes. origin: (3,) of the ray scene."""
    lights, near = lit_by
    traces = np.zeros(len(lights.ids)) if lights.covariances is None else lights.covariances[:, [0, 3, 5]].sum(axis=1)
    return Light.of(lights.directions, lights.irradiance, np.sqrt(np.maximum(traces, 0) / 2), near, origin)


class BounceLight:
    """What surfaces send to each other in pictures of `size` pixels (width, height). sets: of rays, more than one where time counts."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int], tracer: RayTracer, sets: int
    ) -> None:
        self._context, self._tracer = context, tracer
        self._threads = ThreadPoolExecutor(os.cpu_count(), "bounce")
        live = sets > 1
        shadow_rays = LIVE_SHADOW_RAYS if live else STILL_SHADOW_RAYS
        self._bounce = Bounce(tracer.scene, reflecting_meshes(scene), tracer.reach_m, self._threads, RAYS, shadow_rays, sets)
        self._seen: Surfaces | None = None
        self._gathered: dict[int, LitBy] = {}
        self._block = block = block_side(size, live)
        blocks = -(-size[0] // block), -(-size[1] // block)
        self._textures = {f"block_{name}": context.texture(blocks, 4, dtype="f4") for name in Blocks._fields}
        for texture in self._textures.values():
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        variants = ({"CATCHERS": 0, "COARSE": 0}, {"CATCHERS": 1, "COARSE": 0}, {"CATCHERS": 0, "COARSE": 1})
        self._programs = [programs.program("screen.vert", "bounce.frag", **variant) for variant in variants]
        self._arrays = [context.vertex_array(program, []) for program in self._programs]

    def gather(self, gathered: Mapping[int, LitBy], catcher_normal: np.ndarray | None, eye: np.ndarray) -> None:
        """Gathers the light that the surfaces seen last send to each other: each set of rays under its lights, if it was not yet.

        catcher_normal: (3,) of the catcher, if there is one. eye: (3,), from where they were seen.
        """
        if self._seen is not self._tracer.surfaces:
            self._seen, self._gathered = self._tracer.surfaces, {}
            self._bounce.see(self._of_blocks(self._seen), eye)
        stale = {k: lights for k, lights in gathered.items() if self._gathered.get(k) is not lights}
        if not stale and self._gathered:
            return
        for k, lit_by in stale.items():
            self._bounce.gather(light_of(lit_by, self._tracer.scene.origin), ground_albedo(catcher_normal, lit_by.lights), k)
        self._gathered = dict(gathered)
        blocks = self._bounce.received()
        there = np.any(blocks.normals, axis=-1, keepdims=True)
        for texture, values in zip(self._textures.values(), blocks, strict=True):
            texture.write(np.concatenate([values, there], axis=-1, dtype=np.float32).tobytes())

    def _of_blocks(self, surfaces: Surfaces) -> BlockSurfaces:
        """The surfaces of the pixels that stand for blocks, with their normals for shading."""
        rows, columns = block_pixels(surfaces.smooth_normals, self._block)
        return BlockSurfaces(surfaces.places[rows, columns], surfaces.smooth_normals[rows, columns])

    def add(self, g_buffer: GBuffer, frame: moderngl.Framebuffer, scale: tuple[float, float, float], catchers: bool = False) -> None:
        """Adds what was gathered last, times `scale`, to the surfaces in `frame`; with `catchers`, the irradiance of shadow catchers."""
        self._add(int(catchers), g_buffer, frame, scale, 1)

    @property
    def coarse_program(self) -> moderngl.Program:
        """What `add_coarse` runs; its uniforms of weak_lights.glsl are to be set."""
        return self._programs[2]

    def add_coarse(self, surfaces: CoarseSurfaces, frame: moderngl.Framebuffer, step: int) -> None:
        """Adds irradiance to the first and what lobes reflect to the second texture of a frame of coarse pixels, so many pixels wide."""
        self._add(2, surfaces, frame, (1.0, 1.0, 1.0), step)

    def _add(
        self, which: int, surfaces: GBuffer | CoarseSurfaces, frame: moderngl.Framebuffer, scale: tuple[float, float, float], step: int
    ) -> None:
        program = self._programs[which]
        unit = surfaces.bind(program)
        for k, (name, texture) in enumerate(self._textures.items()):
            if name in program:
                texture.use(unit + k)
                program[name] = unit + k
        program["origin"], program["block"] = tuple(self._tracer.scene.origin.tolist()), self._block / step
        if "scale" in program:
            program["scale"] = scale
        program["same_normal"], program["same_plane"] = SAME_NORMAL, SAME_PLANE
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._arrays[which].render(moderngl.TRIANGLES, vertices=3)

    def warm(self) -> None:
        """Compiles, or loads, what a bounce needs."""
        self._bounce.warm()

    def release(self) -> None:
        """Frees what this holds."""
        self._threads.shutdown()
        for resource in (*self._arrays, *self._textures.values()):
            resource.release()
