"""What polished surfaces reflect of the scene, pixel by pixel: rays on the processor, added to a picture here."""

import os
from concurrent.futures import ThreadPoolExecutor

import moderngl
import numpy as np

from vemlight.renderer.gl.constants import GLOSSY_KINDS, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.bounce.bounce import ground_albedo, light_of
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.gloss.lobe_albedo import SIZE, ggx_albedo
from vemlight.renderer.passes.near_lights.near_light_plan import LitBy
from vemlight.renderer.rays.mirror import Mirror
from vemlight.renderer.rays.reflecting import reflecting_meshes
from vemlight.renderer.rays.surfaces import Surfaces
from vemlight.renderer.rays.tracing import RayTracer
from vemlight.renderer.scene.scene import Scene

# Rays of a pixel and its sample, live and for files, and shadow rays of each of their ends. Twice as many leave a file as wrong as it is.
# With a quarter as many the shade that a mirror shows is grain.
LIVE_RAYS, STILL_RAYS, SHADOW_RAYS = 1, 4, 16


class Mirrors:
    """For pictures of `size` pixels (width, height) of a scene with these `kinds` of material. live: whether time counts.

    scene: a texture, of which each pixel has what its lobe sees of the scene and the fraction of the lobe that does.
    """

    def __init__(
        self,
        context: moderngl.Context,
        programs: Programs,
        scene: Scene,
        size: tuple[int, int],
        kinds: set[MaterialKind],
        tracer: RayTracer,
        live: bool,
    ) -> None:
        self._context, self._tracer, self._size = context, tracer, size
        self._threads = ThreadPoolExecutor(os.cpu_count(), "mirrors")
        rays = LIVE_RAYS if live else STILL_RAYS
        self._mirror = Mirror(tracer, reflecting_meshes(scene), self._threads, rays, SHADOW_RAYS)
        self._seen: Surfaces | None = None
        self._lit: LitBy | None = None
        constants = {f"HAS_{kind.name}": int(kind in kinds) for kind in GLOSSY_KINDS} | {"ALBEDO_SIZE": SIZE}
        self._find = context.vertex_array(programs.program("screen.vert", "lobes.frag"), [])
        self._add = context.vertex_array(programs.program("screen.vert", "mirrors.frag", **constants), [])
        self._lobes = context.texture(size, 1, dtype="f4")
        self._frame = context.framebuffer([self._lobes])
        self.scene = context.texture(size, 4, dtype="f4")
        self._albedo = context.texture((SIZE, SIZE), 2, ggx_albedo().tobytes(), dtype="f4") if MaterialKind.GGX in kinds else None
        for texture in (self._lobes, self.scene):
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        if self._albedo:
            self._albedo.filter = moderngl.LINEAR, moderngl.LINEAR

    def trace(self, g_buffer: GBuffer, number: int, lit_by: LitBy, catcher_normal: np.ndarray | None) -> None:
        """Finds what polished surfaces show under these lights. number: of the sample at which they were drawn. catcher_normal: (3,) of
        the catcher, if there is one."""
        if self._seen is not self._tracer.surfaces:
            self._seen, self._lit = self._tracer.surfaces, None
            g_buffer.bind(self._find.program)
            self._frame.use()
            self._context.enable_only(moderngl.NOTHING)
            self._find.render(moderngl.TRIANGLES, vertices=3)
            lobes = np.frombuffer(self._lobes.read(alignment=1), np.float32).reshape(self._size[::-1])
            self._mirror.see(lobes, g_buffer.rays.eye, number)
        if self._lit is None or any(before is not now for before, now in zip(self._lit, lit_by, strict=True)):
            self._lit, origin = lit_by, self._tracer.scene.origin
            self.scene.write(self._mirror.lit(light_of(lit_by, origin), ground_albedo(catcher_normal, lit_by.lights)).data)

    def add(self, g_buffer: GBuffer, frame: moderngl.Framebuffer, weight: float) -> None:
        """Adds what was found last, times `weight`, to the surfaces in `frame`."""
        program = self._add.program
        unit = g_buffer.bind(program)
        for number, (name, texture) in enumerate({"mirrored_scene": self.scene, "albedo": self._albedo}.items(), unit):
            if texture and name in program:
                texture.use(number)
                program[name] = number
        program["weight"] = weight
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._add.render(moderngl.TRIANGLES, vertices=3)

    def warm(self) -> None:
        """Compiles, or loads, what mirrors need; the tracer has seen surfaces."""
        self._mirror.warm()

    def release(self) -> None:
        """Frees what this holds."""
        self._threads.shutdown()
        for resource in (self._find, self._add, self._frame, self._lobes, self.scene, self._albedo):
            if resource:
                resource.release()
