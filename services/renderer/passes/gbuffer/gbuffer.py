"""The G-buffer: place, normals and material of the nearest surface in each pixel, drawn before any light is summed.

28 bytes a pixel: the depth along its ray, float; two normals as octahedra, 16 bits a number; colours as half floats. 16 more, as floats,
where something in the scene emits.
"""

from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import (
    SCENE_VERTEX,
    SECOND_UV,
    SURFACE_DEPTH,
    SURFACE_DIFFUSE,
    SURFACE_EMISSION,
    SURFACE_NORMALS,
    SURFACE_SPECULAR,
)
from vemlight.renderer.gl.constants import MaterialTexture
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.material_uniforms import MaterialUniforms, material_uniforms
from vemlight.renderer.passes.gbuffer.normals import direction_from_octahedron, octahedron_from_code
from vemlight.renderer.scene.materials import emits
from vemlight.renderer.scene.meshes import box_corners
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose
from vemlight.renderer.scene.textures import Texture
from vemlight.renderer.scene.vertex_buffers import VertexBuffers, vertex_buffers
from vemlight.renderer.scene.view import PixelSample, clip_from_world, nearest_distance, ray_from_pixel

# Of each texture, in the order of surface.frag's outputs: what a texel holds, and moderngl's name of its format.
TEXTURES = {
    "surface_depth": (SURFACE_DEPTH, "f4"), "surface_normals": (SURFACE_NORMALS, "nu2"), "surface_diffuse": (SURFACE_DIFFUSE, "f2"),
    "surface_specular": (SURFACE_SPECULAR, "f2"),
}  # fmt: skip
EMISSION_TEXTURE = {"surface_emission": (SURFACE_EMISSION, "f4")}  # only where something emits
WHITE = Texture(np.ones((1, 1, 3), np.float16))


class GBufferPixels(NamedTuple):
    """A G-buffer read back, a row for each of n pixels.

    there: (n,) bool, where a surface is. positions: (n, 3) float64, in the world; rays: (n, 3) float64, towards them, of any length.
    smooth_normals, flat_normals: (n, 3) float64, unit, on the viewer's side. diffuse, specular: (n,) SURFACE_DIFFUSE, SURFACE_SPECULAR.
    """

    there: np.ndarray
    positions: np.ndarray
    rays: np.ndarray
    smooth_normals: np.ndarray
    flat_normals: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray


class PixelRays(NamedTuple):
    """ray_from_pixel: (3, 3) float64, of pixel coordinates and 1; eye: (3,) float64, in the world."""

    ray_from_pixel: np.ndarray
    eye: np.ndarray


class VisibleSurfaces(NamedTuple):
    """depth: (height, width) float32 in lengths of the pixel's ray, 0 where there is no surface; row 0 on top. normal_codes: (height,
    width, 4) uint16, of the octahedra of both normals, the flat one last. ray_from_pixel: (3, 3), eye: (3,) float64."""

    depth: np.ndarray
    normal_codes: np.ndarray
    ray_from_pixel: np.ndarray
    eye: np.ndarray


def visible_surfaces(depth: moderngl.Texture, normals: moderngl.Texture, rays: PixelRays) -> VisibleSurfaces:
    """What two textures of a G-buffer hold."""
    width, height = depth.size
    depths = np.frombuffer(depth.read(alignment=1), np.float32).reshape(height, width)
    codes = np.frombuffer(normals.read(alignment=1), np.uint16).reshape(height, width, 4)
    return VisibleSurfaces(depths, codes, *rays)


class DrawItem(NamedTuple):
    """A mesh ready to draw: its vertex array, its MATERIAL, and its textures by unit."""

    array: moderngl.VertexArray
    material: moderngl.Buffer
    textures: list[moderngl.Texture]


class MeshMatrices(NamedTuple):
    """Where a mesh stands, as uniforms: world_from_rest (4, 4) and normal_from_rest (3, 3), column by column."""

    world_from_rest: tuple[float, ...]
    normal_from_rest: tuple[float, ...]


class GBuffer:
    """The textures of the nearest surfaces, each `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, size: tuple[int, int]) -> None:
        buffers = vertex_buffers(scene)
        self._context, self._programs, self._scene, self._size = context, programs, scene, size
        self._mesh_ranges = buffers.mesh_ranges
        self._buffers = (context.buffer(buffers.vertices.tobytes()), context.buffer(buffers.indices.tobytes()))
        emission = any(emits(mesh.material) for mesh in scene.meshes)
        formats = TEXTURES | (EMISSION_TEXTURE if emission else {})
        self._targets = {name: context.texture(size, record.components, dtype=dtype) for name, (record, dtype) in formats.items()}
        for target in self._targets.values():
            target.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._textures: dict[tuple[object, ...], moderngl.Texture] = {}
        self._arrays: dict[tuple[object, ...], moderngl.VertexArray] = {}
        self._second_uvs: moderngl.Buffer | None = None
        self._items = [self._item(material_uniforms(mesh.material, emission), buffers) for mesh in scene.meshes]
        self._corners = np.array([box_corners(mesh.geometry) for mesh in scene.meshes]).reshape(-1, 8, 3)  # of the meshes' boxes at rest
        self._depth = context.depth_renderbuffer(size)
        self._frame = context.framebuffer(list(self._targets.values()), self._depth)
        self._beside: moderngl.Framebuffer | None = None  # the first two textures, for another sample
        self.place(scene_pose(scene, 0.0))

    def place(self, now: ScenePose) -> None:
        """Moves the meshes and the camera."""
        self._scene = self._scene._replace(centre=now.centre, half=now.half, camera=now.camera)
        a, b, c = np.moveaxis(now.matrices[:, :3, :3], 1, 0)  # rows; normals go by the cofactors, which a flat scale leaves finite
        corners = np.einsum("nij,ncj->nci", now.matrices[:, :3, :3], self._corners) + now.matrices[:, None, :3, 3]
        self._nearest_m = nearest_distance(self._scene.camera, np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1))
        normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        placed = zip(now.matrices, normals, strict=True)
        self._placed = [MeshMatrices(tuple(matrix.T.reshape(-1)), tuple(normal.T.reshape(-1))) for matrix, normal in placed]

    def draw(self, sample: PixelSample) -> None:
        """Draws what the pixels see at `sample` in each.

        A surface of partial coverage is drawn where that exceeds a threshold made of its place and the sample's number: the mean over
        successive samples has as much of it.
        """
        self._ray_from_pixel = self._draw(sample, self._frame)

    def read_beside(self, sample: PixelSample) -> VisibleSurfaces:
        """Where the surfaces are at another sample; what was drawn last stays."""
        if self._beside is None:
            targets = [self._context.texture(self._size, record.components, dtype=dtype) for record, dtype in (*TEXTURES.values(),)[:2]]
            self._beside = self._context.framebuffer(targets, self._depth)
        rays = self.rays._replace(ray_from_pixel=self._draw(sample, self._beside))
        depth, normals = self._beside.color_attachments
        return visible_surfaces(depth, normals, rays)  # type: ignore[arg-type]

    def _draw(self, sample: PixelSample, frame: moderngl.Framebuffer) -> np.ndarray:
        """Draws what the pixels see at a sample; returns their rays (3, 3)."""
        matrix = tuple(clip_from_world(self._scene, self._size, sample, self._nearest_m).T.reshape(-1))
        rays = ray_from_pixel(self._scene.camera, self._size)
        rays[:, 2] += rays[:, :2] @ np.subtract(sample[:2], 0.5)
        for array in self._arrays.values():
            array.program["clip_from_world"] = matrix
            self._set_rays(array.program, rays)
            if "sample_number" in array.program:
                array.program["sample_number"] = sample.number
        frame.use()
        frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for item, drawn, placed in zip(self._items, self._mesh_ranges, self._placed, strict=True):
            item.material.bind_to_uniform_block(0)
            for unit, texture in enumerate(item.textures):
                texture.use(unit)
            item.array.program["world_from_rest"], item.array.program["normal_from_rest"] = placed
            item.array.render(vertices=drawn.count, first=drawn.first)
        return rays

    def _item(self, uniforms: MaterialUniforms, buffers: VertexBuffers) -> DrawItem:
        array = self._array(uniforms.variant, buffers)
        textures = [self._texture(image) for image in uniforms.textures]
        return DrawItem(array, self._context.buffer(uniforms.row.tobytes()), textures)

    def _array(self, variant: dict[str, str | int], buffers: VertexBuffers) -> moderngl.VertexArray:
        """The vertices for a variant of the program, made when it is first wanted."""
        key = tuple(variant.values())
        if key not in self._arrays:
            program = self._programs.program("surface.vert", "surface.frag", **variant)
            for slot in MaterialTexture:
                if (sampler := f"{slot.name.lower()}_texture") in program:  # compilers leave out what a variant does not use
                    program[sampler] = slot
            content = [SCENE_VERTEX.content(self._buffers[0], program)]
            if variant["UV_TRANSFORM"]:
                self._second_uvs = self._second_uvs or self._context.buffer(buffers.second_uvs.tobytes())
                content.append(SECOND_UV.content(self._second_uvs, program))
            self._arrays[key] = self._context.vertex_array(program, content, self._buffers[1], index_element_size=4)
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

    def _set_rays(self, program: moderngl.Program, rays: np.ndarray) -> None:
        """Gives a program the eye and the rays through the pixels, as far as it uses them."""
        if "eye" in program:
            program["eye"] = self._scene.camera.position
        if "ray_from_pixel" in program:
            program["ray_from_pixel"] = tuple(rays.T.reshape(-1))

    def bind(self, program: moderngl.Program) -> int:
        """Gives a program what it reads of gbuffer.glsl and surface_texels.glsl; returns the first texture unit that is still free."""
        self._set_rays(program, self._ray_from_pixel)
        for unit, (name, target) in enumerate(self._targets.items()):
            if name in program:
                target.use(unit)
                program[name] = unit
        return len(self._targets)

    @property
    def rays(self) -> PixelRays:
        """Where the pixels' rays go."""
        return PixelRays(self._ray_from_pixel, np.array(self._scene.camera.position, np.float64))

    def read_surfaces(self) -> VisibleSurfaces:
        """Where the surfaces are that were drawn last."""
        return visible_surfaces(self._targets["surface_depth"], self._targets["surface_normals"], self.rays)

    def read(self) -> GBufferPixels:
        """What was drawn last, row 0 on top."""
        width, height = self._size
        data = {
            name: np.frombuffer(self._frame.read(components=record.components, attachment=k, dtype="f4", alignment=1), record.dtype)
            for k, (name, (record, _)) in enumerate(TEXTURES.items())
        }
        pixels = np.stack([*np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), np.ones((height, width))], axis=-1)
        rays = pixels.reshape(-1, 3) @ self._ray_from_pixel.T
        depth, normals = data["surface_depth"]["depth"], data["surface_normals"]
        smooth, flat = (direction_from_octahedron(octahedron_from_code(normals[name])) for name in ("smooth_octahedron", "flat_octahedron"))
        positions = self._scene.camera.position + depth[:, None] * rays
        return GBufferPixels(depth > 0, positions, rays, smooth, flat, data["surface_diffuse"], data["surface_specular"])

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        made = (*self._arrays.values(), *self._buffers, self._second_uvs, self._frame, self._depth, *self._targets.values())
        beside = (*self._beside.color_attachments, self._beside) if self._beside else ()
        for resource in (*made, *beside, *(item.material for item in self._items), *self._textures.values()):
            if resource is not None:
                resource.release()
