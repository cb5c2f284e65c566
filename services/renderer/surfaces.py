"""What each pixel sees: position, normals and material of the nearest surface, drawn before any light is summed."""

import moderngl

from services.renderer.geometry import Drawable
from services.renderer.programs import Programs
from services.renderer.scene import Scene
from services.renderer.view import clip_from_world

IMAGES = {"surface_positions": "f4", "surface_normals": "f4", "surface_diffuse": "f2", "surface_specular": "f4"}  # name and number format


class Surfaces:
    """The images of the nearest surfaces, each `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, drawable: Drawable, vertices: moderngl.Buffer,
                 indices: moderngl.Buffer, size: tuple[int, int]) -> None:
        self._context, self._scene, self._spans, self._size = context, scene, drawable.spans, size
        self.eye = scene.camera.position
        self._program = programs.program("surface.vert", "surface.frag")
        self._vao = context.vertex_array(self._program, [(vertices, "3f 3f", "position", "normal")], indices, index_element_size=4)
        self._images = [context.texture(size, 4, dtype=dtype) for dtype in IMAGES.values()]
        for image in self._images:
            image.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._depth = context.depth_renderbuffer(size)
        self._frame = context.framebuffer(self._images, self._depth)

    def draw(self, offset: tuple[float, float]) -> None:
        """Draws what the pixels see at `offset` in each."""
        matrix = clip_from_world(self._scene, self._size, offset)
        self._program["clip_from_world"] = tuple(matrix.T.reshape(-1))
        self._program["eye"] = self.eye
        self._frame.use()
        self._frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for mesh, span in zip(self._scene.meshes, self._spans, strict=True):
            self._program["diffuse"] = mesh.material.diffuse
            self._program["specular"] = mesh.material.specular
            self._program["exponent"] = mesh.material.exponent
            self._vao.render(vertices=span.count, first=span.first)

    def bind(self, program: moderngl.Program) -> int:
        """Gives a program the images it reads; the first texture unit that is still free."""
        for unit, (name, image) in enumerate(zip(IMAGES, self._images, strict=True)):
            if name in program:
                image.use(unit)
                program[name] = unit
        return len(IMAGES)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for thing in (self._vao, self._frame, self._depth, *self._images):
            thing.release()
