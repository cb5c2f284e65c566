"""What each pixel sees: place, normals and material of the nearest surface, drawn before any light is summed.

28 bytes a pixel: how far along its ray, float; two normals as octahedra, 16 bits a number (good to 3e-5 rad); colours as half floats.
16 more, as floats, where something in the scene emits.
"""

from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.scene.materials import (
    HASHED_ALPHA,
    Ggx,
    Material,
    Phong,
    SpecularGlossiness,
    Texture,
    Unlit,
    alpha_test_of,
    emits,
    material_kind,
)
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose
from vemlight.renderer.scene.vertex_buffers import VertexBuffers, vertex_buffers
from vemlight.renderer.scene.view import PixelSample, clip_from_world, ray_from_pixel

CODES = 32767  # of a normal's number to each side of 0: gbuffer.glsl
# Name, how many numbers a pixel, and their format.
IMAGES = {"surface_depths": (1, "f4"), "surface_normals": (4, "nu2"), "surface_diffuse": (4, "f2"), "surface_specular": (4, "f2")}
EMITTED = {"surface_emission": (4, "f4")}  # only where something emits
SLOTS = ("colour_image", "shape_image", "normal_image", "glow_image")  # of surface.frag
WHITE = Texture(np.ones((1, 1, 3), np.float16))


class GBufferTextures(NamedTuple):
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


class MaterialUniforms(NamedTuple):
    """A material as surface.frag has it: which variant of the program, its numbers, and the images in SLOTS."""

    constants: dict[str, str]
    numbers: dict[str, object]
    images: tuple[Texture | None, ...]


class DrawItem(NamedTuple):
    """A mesh ready to draw: its vertex array, uniforms with what they become, and textures by unit."""

    array: moderngl.VertexArray
    numbers: list[tuple[moderngl.Uniform, object]]
    textures: list[moderngl.Texture]


def material_uniforms(material: Material, emission: bool) -> MaterialUniforms:
    """How a material is drawn; emission: whether anything in the scene emits."""
    model, shine, images = 0, (0.0, 0.0, 0.0), (None, None, None, None)
    colour, shape = (0.0, 0.0, 0.0), 0.0
    numbers: dict[str, object] = {"glow": (0.0, 0.0, 0.0)}
    if isinstance(material, Phong):
        colour, shine, shape, images = material.diffuse, material.specular, material.exponent, (material.colour_map, None, None, None)
    elif isinstance(material, Ggx):
        colour, shine, shape = material.base_color, (material.metallic, 0.0, 0.0), material.roughness
        images = (material.colour_map, material.metallic_roughness_map, material.normal_map, material.emission_map)
        numbers = {"reflectance": material.reflectance, "glow": material.emission}
    elif isinstance(material, SpecularGlossiness):
        model, colour, shine, shape = 1, material.diffuse, material.specular, material.glossiness
        images = (material.colour_map, material.specular_glossiness_map, material.normal_map, material.emission_map)
        numbers = {"glow": material.emission}
    elif isinstance(material, Unlit):
        model, colour, images = 2, material.base_color, (material.colour_map, None, None, None)
    if holes := alpha_test_of(material):
        numbers |= {"opacity": holes.alpha, "cutoff": HASHED_ALPHA if holes.cutoff is None else holes.cutoff}
    placed = any(image is not None and image.uv_transform is not None for image in images)
    if placed:
        rows = np.stack([uv_transform_rows(image) for image in images])
        numbers |= {"across": rows[:, 0, :4], "along": rows[:, 1, :4], "shift": rows[:, :, 4]}
    numbers |= {"kind": float(material_kind(material)), "colour": colour, "shine": shine, "shape": shape}
    seen = {"IMAGES": any(image is not None for image in images), "PLACED": placed, "BUMPY": images[2] is not None}
    flags = {"MODEL": model, **seen, "CUT": holes is not None, "EMISSION": emission}
    return MaterialUniforms({name: str(int(flag)) for name, flag in flags.items()}, numbers, images)


def uv_transform_rows(image: Texture | None) -> np.ndarray:
    """An image's coordinates (2, 5) as weights of both sets of texture coordinates and of 1."""
    uv_transform = np.eye(3)[:2] if image is None or image.uv_transform is None else image.uv_transform
    first = 2 * image.uv_set if image else 0
    rows = np.zeros((2, 5), np.float32)
    rows[:, first : first + 2], rows[:, 4] = uv_transform[:, :2], uv_transform[:, 2]
    return rows


class Surfaces:
    """The images of the nearest surfaces, each `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        drawable = vertex_buffers(scene)
        self._context, self._programs, self._scene, self._mesh_ranges, self._size = context, programs, scene, drawable.mesh_ranges, size
        self.buffers = (context.buffer(drawable.vertices.tobytes()), context.buffer(drawable.indices.tobytes()))
        emission = any(emits(mesh.material) for mesh in scene.meshes)
        formats = IMAGES | (EMITTED if emission else {})
        self._images = {name: context.texture(size, numbers, dtype=dtype) for name, (numbers, dtype) in formats.items()}
        for image in self._images.values():
            image.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._textures: dict[tuple[object, ...], moderngl.Texture] = {}
        self._arrays: dict[tuple[str, ...], moderngl.VertexArray] = {}
        self._second: moderngl.Buffer | None = None
        self._dressed = [self._dress(material_uniforms(mesh.material, emission), drawable) for mesh in scene.meshes]
        self._depth = context.depth_renderbuffer(size)
        self._frame = context.framebuffer(list(self._images.values()), self._depth)
        self.place(scene_pose(scene, 0.0))

    def place(self, now: ScenePose) -> None:
        """Moves the meshes."""
        self._scene = self._scene._replace(centre=now.centre, half=now.half)
        a, b, c = np.moveaxis(now.matrices[:, :3, :3], 1, 0)  # rows; normals go by the cofactors, which a flat scale leaves finite
        normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        placed = zip(now.matrices, normals, strict=True)
        self._placed = [(tuple(matrix.T.reshape(-1)), tuple(normal.T.reshape(-1))) for matrix, normal in placed]

    def draw(self, offset: PixelSample) -> None:
        """Draws what the pixels see at `offset` in each.

        A surface of which a share is there is drawn where that is above a number made of its place and the offset's: the mean over offsets
        of successive numbers has as much of it.
        """
        matrix = tuple(clip_from_world(self._scene, self._size, offset).T.reshape(-1))
        self._ray_from_pixel = ray_from_pixel(self._scene.camera, self._size)
        self._ray_from_pixel[:, 2] += self._ray_from_pixel[:, :2] @ np.subtract(offset[:2], 0.5)
        for array in self._arrays.values():
            array.program["clip_from_world"] = matrix
            self._look(array.program)
            if "sampled" in array.program:
                array.program["sampled"] = offset.number
        self._frame.use()
        self._frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for dressed, span, (matrix, normal) in zip(self._dressed, self._mesh_ranges, self._placed, strict=True):
            for uniform, value in dressed.numbers:
                uniform.value = value
            for unit, texture in enumerate(dressed.textures):
                texture.use(unit)
            dressed.array.program["world_from_rest"], dressed.array.program["normal_from_rest"] = matrix, normal
            dressed.array.render(vertices=span.count, first=span.first)

    def _dress(self, look: MaterialUniforms, drawable: VertexBuffers) -> DrawItem:
        array = self._array(look.constants, drawable)
        numbers = look.numbers | {name: unit for unit, name in enumerate(SLOTS)}
        found = ((array.program.get(name, None), value) for name, value in numbers.items())  # compilers leave out what is not used
        uniforms = [(uniform, value) for uniform, value in found if isinstance(uniform, moderngl.Uniform)]
        return DrawItem(array, uniforms, [self._texture(image) for image in look.images])

    def _array(self, constants: dict[str, str], drawable: VertexBuffers) -> moderngl.VertexArray:
        """The vertices for a variant of the program, made when it is first worn."""
        key = tuple(constants.values())
        if key not in self._arrays:
            program = self._programs.program("surface.vert", "surface.frag", **constants)
            layout: list[tuple[object, ...]] = [(self.buffers[0], "3f 3f 2x4 4f2", "position", "normal", "vertex_colour")]
            if constants["IMAGES"] == "1":
                layout = [(self.buffers[0], "3f 3f 2f 4f2", "position", "normal", "uv", "vertex_colour")]
            if constants["PLACED"] == "1":
                self._second = self._second or self._context.buffer(drawable.second_uvs.tobytes())
                layout.append((self._second, "2f", "second_uv"))
            self._arrays[key] = self._context.vertex_array(program, layout, self.buffers[1], index_element_size=4)
        return self._arrays[key]

    def _texture(self, image: Texture | None) -> moderngl.Texture:
        """An image on the GPU; white where there is none."""
        image = image or WHITE
        key = (id(image.texels), image.repeats, image.filters)
        if key not in self._textures:
            height, width, components = image.texels.shape
            texture = self._context.texture((width, height), components, image.texels.tobytes(), alignment=1, dtype="f2")
            texture.build_mipmaps()
            texture.filter, (texture.repeat_x, texture.repeat_y) = image.filters, image.repeats
            self._textures[key] = texture
        return self._textures[key]

    def _look(self, program: moderngl.Program) -> None:
        """Gives a program the way from a pixel to what is seen there, as far as it uses that."""
        if "eye" in program:
            program["eye"] = self._scene.camera.position
        if "ray_from_pixel" in program:
            program["ray_from_pixel"] = tuple(self._ray_from_pixel.T.reshape(-1))

    def bind(self, program: moderngl.Program) -> int:
        """Gives a program what it reads of gbuffer.glsl and of the images; the first texture unit that is still free."""
        self._look(program)
        for unit, (name, image) in enumerate(self._images.items()):
            if name in program:
                image.use(unit)
                program[name] = unit
        return len(self._images)

    def read(self) -> GBufferTextures:
        """What was drawn last, row 0 on top."""
        width, height = self._size
        read = [self._frame.read(components=n, attachment=k, dtype="f4", alignment=1) for k, (n, _) in enumerate(IMAGES.values())]
        depths, normals, diffuse, specular = (np.frombuffer(data, np.float32).reshape(width * height, -1) for data in read)
        pixels = np.stack([*np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), np.ones((height, width))], axis=-1)
        rays = pixels.reshape(-1, 3) @ self._ray_from_pixel.T
        normals = (np.rint(normals * np.float32(2 * CODES + 1)) - (CODES + 1)) / CODES
        return GBufferTextures(depths[:, 0] > 0, self._scene.camera.position + depths * rays, rays, normals, diffuse, specular)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        things = (*self._arrays.values(), *self.buffers, self._second, self._frame, self._depth, *self._images.values())
        for thing in (*things, *self._textures.values()):
            if thing is not None:
                thing.release()
