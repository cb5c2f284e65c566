"""What each pixel sees: place, normals and material of the nearest surface, drawn before any light is summed.

28 bytes a pixel: how far along its ray, float; two normals as octahedra, 16 bits a number (good to 3e-5 rad); colours as half floats.
"""

from typing import NamedTuple

import moderngl
import numpy as np

from services.renderer.geometry import drawable_scene
from services.renderer.materials import Catcher, Material, Phong, kind_of
from services.renderer.programs import Programs
from services.renderer.scene import Scene
from services.renderer.standing import Standing, standing
from services.renderer.view import clip_from_world, ray_from_pixel

CODES = 32767  # of a normal's number to each side of 0: seen.glsl
# Name, how many numbers a pixel, and their format.
IMAGES = {"surface_depths": (1, "f4"), "surface_normals": (4, "nu2"), "surface_diffuse": (4, "f2"), "surface_specular": (4, "f2")}


class Seen(NamedTuple):
    """The images as numbers, a row for each of n pixels.

    there: (n,) bool, where a surface is; positions: (n, 3) float64, in the world; rays: (n, 3) float64, towards them; normals: (n, 4)
    float64, octahedra of shading's and the triangle's; diffuse, specular: (n, 4) float32, with kind and shape of the material behind them.
    """

    there: np.ndarray
    positions: np.ndarray
    rays: np.ndarray
    normals: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray


class Surfaces:
    """The images of the nearest surfaces, each `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        drawable = drawable_scene(scene)
        self._context, self._scene, self._spans, self._size = context, scene, drawable.spans, size
        self.buffers = (context.buffer(drawable.vertices.tobytes()), context.buffer(drawable.indices.tobytes()))
        self._program = programs.program("surface.vert", "surface.frag")
        layout = [(self.buffers[0], "3f 3f 2f 4f2", "position", "normal", "uv", "vertex_colour")]
        self._vao = context.vertex_array(self._program, layout, self.buffers[1], index_element_size=4)
        self._images = [context.texture(size, numbers, dtype=dtype) for numbers, dtype in IMAGES.values()]
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
        self._ray_from_pixel = ray_from_pixel(self._scene.camera, self._size)
        self._ray_from_pixel[:, 2] += self._ray_from_pixel[:, :2] @ np.subtract(offset, 0.5)
        self._look(self._program)
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

    def _look(self, program: moderngl.Program) -> None:
        """Gives a program the way from a pixel to what is seen there, as far as it uses that."""
        if "eye" in program:
            program["eye"] = self._scene.camera.position
        if "ray_from_pixel" in program:
            program["ray_from_pixel"] = tuple(self._ray_from_pixel.T.reshape(-1))

    def bind(self, program: moderngl.Program) -> int:
        """Gives a program what it reads of seen.glsl and of the images; the first texture unit that is still free."""
        self._look(program)
        for unit, (name, image) in enumerate(zip(IMAGES, self._images, strict=True)):
            if name in program:
                image.use(unit)
                program[name] = unit
        return len(IMAGES)

    def read(self) -> Seen:
        """What was drawn last, row 0 on top."""
        width, height = self._size
        read = [self._frame.read(components=n, attachment=k, dtype="f4", alignment=1) for k, (n, _) in enumerate(IMAGES.values())]
        depths, normals, diffuse, specular = (np.frombuffer(data, np.float32).reshape(width * height, -1) for data in read)
        pixels = np.stack([*np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), np.ones((height, width))], axis=-1)
        rays = pixels.reshape(-1, 3) @ self._ray_from_pixel.T
        normals = (np.rint(normals * np.float32(2 * CODES + 1)) - (CODES + 1)) / CODES
        return Seen(depths[:, 0] > 0, self._scene.camera.position + depths * rays, rays, normals, diffuse, specular)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for thing in (self._vao, *self.buffers, self._frame, self._depth, *self._images, *self._textures.values()):
            thing.release()
