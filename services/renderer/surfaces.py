"""What each pixel sees: position, normals and material of the nearest surface, drawn before any light is summed."""

import moderngl
import numpy as np

from services.renderer.geometry import drawable_scene
from services.renderer.materials import Catcher, Material, Phong, kind_of
from services.renderer.programs import Programs
from services.renderer.scene import Scene
from services.renderer.standing import Standing, standing
from services.renderer.view import clip_from_world

IMAGES = {"surface_positions": "f4", "surface_normals": "f4", "surface_diffuse": "f2", "surface_specular": "f4"}  # name and number format


class Surfaces:
    """The images of the nearest surfaces, each `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        drawable = drawable_scene(scene)
        self._context, self._scene, self._spans, self._size = context, scene, drawable.spans, size
        self.buffers = (context.buffer(drawable.vertices.tobytes()), context.buffer(drawable.indices.tobytes()))
        self.eye = scene.camera.position
        self._program = programs.program("surface.vert", "surface.frag")
        layout = [(self.buffers[0], "3f 3f 2f 4f2", "position", "normal", "uv", "vertex_colour")]
        self._vao = context.vertex_array(self._program, layout, self.buffers[1], index_element_size=4)
        self._images = [context.texture(size, 4, dtype=dtype) for dtype in IMAGES.values()]
        for image in self._images:
            image.filter = (moderngl.NEAREST, moderngl.NEAREST)
        images = [None, *(image for mesh in scene.meshes for image in mesh.material if isinstance(image, np.ndarray))]
        self._textures = {id(image): self._texture(image) for image in images}
        self._depth = context.depth_renderbuffer(size)
        self._frame = context.framebuffer(self._images, self._depth)
        self.place(standing(scene, 0.0))

    def place(self, now: Standing) -> None:
        """Moves the meshes."""
        self._scene = self._scene._replace(centre=now.centre, half=now.half)
        a, b, c = np.moveaxis(now.matrices[:, :3, :3], 1, 0)  # rows; normals go by the cofactors, which a flat scale leaves finite
        normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        placed = zip(now.matrices, normals, strict=True)
        self._drawn_at: tuple[float, float] | None = None
        self._placed = [(tuple(matrix.T.reshape(-1)), tuple(normal.T.reshape(-1))) for matrix, normal in placed]

    def draw(self, offset: tuple[float, float]) -> bool:
        """Draws what the pixels see at `offset` in each; False, and nothing done, where that is what was drawn last."""
        if offset == self._drawn_at:
            return False
        self._drawn_at = offset
        matrix = clip_from_world(self._scene, self._size, offset)
        self._program["clip_from_world"] = tuple(matrix.T.reshape(-1))
        self._program["eye"] = self.eye
        self._frame.use()
        self._frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for mesh, span, (matrix, normal) in zip(self._scene.meshes, self._spans, self._placed, strict=True):
            self._wear(mesh.material)
            self._program["world_from_rest"], self._program["normal_from_rest"] = matrix, normal
            self._vao.render(vertices=span.count, first=span.first)
        return True

    def _wear(self, material: Material) -> None:
        """Sets a material's numbers and images."""
        if isinstance(material, Phong):
            numbers = (material.diffuse, material.specular, material.exponent)
            images = (material.image, None, None)
        elif isinstance(material, Catcher):
            numbers, images = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0), (None, None, None)
        else:
            numbers = (material.base_color, (material.metallic, 0.0, 0.0), material.roughness)
            images = (material.image, material.metal_rough, material.bumps)
        self._program["kind"] = float(kind_of(material))
        for name, value in zip(("colour", "shine", "shape"), numbers, strict=True):
            self._program[name] = value
        self._program["bumpy"] = images[2] is not None
        for unit, (name, image) in enumerate(zip(("colour_image", "shape_image", "normal_image"), images, strict=True)):
            self._textures[id(image)].use(unit)
            self._program[name] = unit

    def _texture(self, image: np.ndarray | None) -> moderngl.Texture:
        """An image on the GPU; white where there is none."""
        texels = np.ones((1, 1, 3), np.float16) if image is None else image
        texture = self._context.texture((texels.shape[1], texels.shape[0]), texels.shape[2], texels.tobytes(), alignment=1, dtype="f2")
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return texture

    def bind(self, program: moderngl.Program) -> int:
        """Gives a program the images it reads; the first texture unit that is still free."""
        for unit, (name, image) in enumerate(zip(IMAGES, self._images, strict=True)):
            if name in program:
                image.use(unit)
                program[name] = unit
        return len(IMAGES)

    def read(self) -> dict[str, np.ndarray]:
        """The images by name, (height * width, 4) float32 each, row 0 on top."""
        data = {name: self._frame.read(components=4, attachment=k, dtype="f4", alignment=1) for k, name in enumerate(IMAGES)}
        return {name: np.frombuffer(image, np.float32).reshape(-1, 4) for name, image in data.items()}

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for thing in (self._vao, *self.buffers, self._frame, self._depth, *self._images, *self._textures.values()):
            thing.release()
