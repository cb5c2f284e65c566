"""Lit pictures: surfaces first, then for each visible pixel the sum over all lights with their shadow maps."""

import moderngl
import numpy as np

from services import settings
from services.files import BadInput
from services.lights import Lights
from services.renderer.geometry import drawable_scene
from services.renderer.programs import Programs, context_info, headless_context
from services.renderer.scene import Camera, Scene
from services.renderer.shadows import MAX_LIGHTS, ShadowAtlas
from services.renderer.tonemap import Adaptation, tone_curve

SURFACE = {"surface_positions": "f4", "surface_normals": "f4", "surface_diffuse": "f2", "surface_specular": "f4"}
ATLAS_UNIT = len(SURFACE)


class Renderer:
    """Draws one scene under any directional lights, headless.

    samples: places in each pixel at which it is drawn; the pixel is their mean, so 4 or more give the average over its area.
    Raises BadInput when there is no GL 4.3 or the picture is larger than it allows.
    """

    def __init__(self, scene: Scene, settings: settings.Renderer, samples: int = 1) -> None:
        self._size = (settings.width, settings.height)
        self._context = headless_context()
        self.info = context_info(self._context)
        limit = self._context.info["GL_MAX_TEXTURE_SIZE"]
        if max(self._size) > limit:
            size = f"{self._size[0]} x {self._size[1]}"
            raise BadInput(f"[renderer] width, height: {size} is beyond the {limit} pixels of this GL; make them smaller")
        self._scene = scene
        self._offsets = pixel_offsets(samples)
        self._programs = Programs(self._context)
        self._build(settings.shadow_map)

    def _build(self, shadow_map: int) -> None:
        context = self._context
        drawable = drawable_scene(self._scene)
        self._spans = drawable.spans
        self._vertices = context.buffer(drawable.vertices.tobytes())
        self._indices = context.buffer(drawable.indices.tobytes())
        self._atlas = ShadowAtlas(context, self._programs, drawable, self._vertices, self._indices, shadow_map)
        self._surface = self._programs.program("surface.vert", "surface.frag")
        self._surface_vao = context.vertex_array(
            self._surface, [(self._vertices, "3f 3f", "position", "normal")], self._indices, index_element_size=4
        )
        self._surfaces = [context.texture(self._size, 4, dtype=dtype) for dtype in SURFACE.values()]
        for texture in self._surfaces:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._depth = context.depth_renderbuffer(self._size)
        self._surface_frame = context.framebuffer(self._surfaces, self._depth)
        self._shade = self._programs.program("screen.vert", "shade.frag", MAX_LIGHTS=str(MAX_LIGHTS))
        self._shade_vao = context.vertex_array(self._shade, [])
        self._picture = context.texture(self._size, 4, dtype="f4")
        self._frame = context.framebuffer([self._picture])
        self._tonemap = self._programs.program("screen.vert", "tonemap.frag")
        self._tonemap_vao = context.vertex_array(self._tonemap, [])
        self._screen = context.framebuffer([context.renderbuffer(self._size, 4)])

    def render(self, lights: Lights) -> np.ndarray:
        """The picture under `lights`, (height, width, 4) float32, linear, row 0 on top.

        RGB is radiance times alpha (the average over the pixel's area), alpha the share of the area where rays meet a surface.
        """
        self._frame.clear()
        batches = self._atlas.batches(lights)
        for number, batch in enumerate(batches):
            self._atlas.draw(batch)
            for offset in self._offsets:
                self._draw_surfaces(offset)
                self._sum_lights(batch.count, number == 0)
        if not batches:
            for offset in self._offsets:
                self._draw_surfaces(offset)
                self._sum_lights(0, True)
        data = self._frame.read(components=4, dtype="f4", alignment=1)
        return np.frombuffer(data, np.float32).reshape(self._size[1], self._size[0], 4)

    def tone_mapped(self, adaptation: Adaptation, exposure_stops: float) -> np.ndarray:
        """The picture that `render` made last, for a screen: (height, width, 4) uint8, as `tonemap.tone_mapped` gives it."""
        curve = tone_curve(adaptation, exposure_stops)
        self._picture.use(0)
        self._tonemap["picture"] = 0
        self._tonemap["scale"] = curve.scale
        self._tonemap["white"] = curve.white
        self._screen.use()
        self._context.enable_only(moderngl.NOTHING)
        self._tonemap_vao.render(moderngl.TRIANGLES, vertices=3)
        return np.frombuffer(self._screen.read(components=4, alignment=1), np.uint8).reshape(self._size[1], self._size[0], 4)

    def _draw_surfaces(self, offset: tuple[float, float]) -> None:
        """Draws what the pixels see at `offset` in each."""
        matrix = clip_from_world(self._scene, self._size, offset)
        self._surface["clip_from_world"] = tuple(matrix.T.reshape(-1))
        self._surface["eye"] = self._scene.camera.position
        self._surface_frame.use()
        self._surface_frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        for mesh, span in zip(self._scene.meshes, self._spans, strict=True):
            self._surface["diffuse"] = mesh.material.diffuse
            self._surface["specular"] = mesh.material.specular
            self._surface["exponent"] = mesh.material.exponent
            self._surface_vao.render(vertices=span.count, first=span.first)

    def _sum_lights(self, count: int, first: bool) -> None:
        """Adds a batch of lights, whose maps are in the atlas, to the picture."""
        for unit, (name, texture) in enumerate(zip(SURFACE, self._surfaces, strict=True)):
            texture.use(unit)
            self._shade[name] = unit
        if count and self._atlas.texture is not None:
            self._atlas.texture.use(ATLAS_UNIT)
            self._shade["atlas"] = ATLAS_UNIT
        self._atlas.buffer.bind_to_uniform_block(0)
        self._atlas.describe(self._shade)
        self._shade["eye"] = self._scene.camera.position
        self._shade["light_count"] = count
        self._shade["weight"] = 1 / len(self._offsets)
        self._shade["first_batch"] = float(first)
        self._frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._shade_vao.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees everything on the GPU and the context."""
        self._atlas.release()
        arrays = [self._surface_vao, self._shade_vao, self._tonemap_vao]
        frames = [self._surface_frame, self._frame, self._screen]
        images = [*self._surfaces, self._depth, self._picture, *self._screen.color_attachments]
        for thing in [*arrays, *frames, *images, self._vertices, self._indices]:
            thing.release()
        self._programs.release()
        self._context.release()


def pixel_offsets(samples: int) -> list[tuple[float, float]]:
    """`samples` places in the unit pixel, evenly spread (Hammersley points, moved by half a step so that one lies in the middle)."""
    places = []
    for k in range(samples):
        mirrored, bit, rest = 0.0, 0.5, k
        while rest:
            mirrored, bit, rest = mirrored + bit * (rest & 1), bit / 2, rest >> 1
        places.append(((k + 0.5) / samples, (mirrored + 0.5 / samples) % 1.0))
    return places


def view_from_world(camera: Camera) -> np.ndarray:
    """Rigid transform (4, 4): x right, y down, z along the view; a camera that looks straight up or down has +Y of the world on top."""
    forward = np.subtract(camera.at, camera.position)
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0] if abs(forward[2]) < 1 - 1e-9 else [0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(forward, right), forward
    view[:3, 3] = -view[:3, :3] @ np.array(camera.position)
    return view


def clip_from_world(scene: Scene, size: tuple[int, int], offset: tuple[float, float] = (0.5, 0.5)) -> np.ndarray:
    """Projection (4, 4) whose picture has row 0 on top in memory (y down) and is sampled at `offset` in each pixel of `size`.

    Near and far lie around the scene's box, near at least at 1/1000 of far so that 24 bits of depth stay fine enough.
    """
    view = view_from_world(scene.camera)
    corners = scene.centre + scene.half * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    depth = corners @ view[2, :3] + view[2, 3]
    far = max(float(depth.max()) * 1.01, 1e-6)
    near = max(float(depth.min()) * 0.99, far / 1000)
    tall = 1 / np.tan(np.radians(scene.camera.fov_y) / 2)
    wide = tall * size[1] / size[0]
    a, b = (far + near) / (far - near), -2 * far * near / (far - near)
    shift_x, shift_y = (1 - 2 * offset[0]) / size[0], (1 - 2 * offset[1]) / size[1]
    return np.array([[wide, 0, shift_x, 0], [0, tall, shift_y, 0], [0, 0, a, b], [0, 0, 1, 0]]) @ view
