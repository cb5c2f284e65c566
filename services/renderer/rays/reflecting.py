"""What a surface that a ray meets reflects and emits: its material's colours at that place, as far as a bounce sees them.

A bounce gathers light over wide angles. So a texture is reduced to REDUCED texels a side, metallic maps to their mean, and what a surface
reflects in a lobe counts as if it left it evenly.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import subroutine
from vemlight.renderer.scene.materials import Ggx, Material, Phong, ShadowCatcher, SpecularGlossiness, Unlit
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.textures import Texture

REDUCED = 64  # texels: a ray of sixteen over a hemisphere stands for 36 degrees. Any value in 16 .. 256 does
NONE = -1  # in place of a texture's number


class ReflectingMeshes(NamedTuple):
    """All meshes of a scene, one after the other.

    first_triangle: (meshes + 1,) int64. triangles: (m, 3) int64, vertices. colour_uvs, emission_uvs: (n, 2) float32, where each vertex lies
    in its mesh's textures. vertex_colours: (n, 3) float32. colour, reflectance, emission: (meshes, 3) float32: reflects a fraction of
    r + (1 - r) (1 - metallic) c with r = reflectance (1 - metallic) + metallic c, of the colour c times those of texture and vertex.
    metallic: (meshes,) float32. unlit: (meshes,) bool: what it emits is times the vertices' colours. catcher: (meshes,) bool: reflects as
    the ground under it. colour_texture, emission_texture:
    (meshes,) int64, NONE for none.
    texels: (t, 3) float32, of all textures; textures: (k, 5) int64, first texel, rows, columns, and whether it repeats across and up.
    """

    first_triangle: np.ndarray
    triangles: np.ndarray
    colour_uvs: np.ndarray
    emission_uvs: np.ndarray
    vertex_colours: np.ndarray
    colour: np.ndarray
    reflectance: np.ndarray
    metallic: np.ndarray
    emission: np.ndarray
    unlit: np.ndarray
    catcher: np.ndarray
    colour_texture: np.ndarray
    emission_texture: np.ndarray
    texels: np.ndarray
    textures: np.ndarray


class _Reflection(NamedTuple):
    """A material as ReflectingMeshes has it, with its textures themselves."""

    colour: tuple[float, ...] = (0.0, 0.0, 0.0)
    reflectance: tuple[float, ...] = (0.0, 0.0, 0.0)
    metallic: float = 0.0
    emission: tuple[float, ...] = (0.0, 0.0, 0.0)
    colour_map: Texture | None = None
    emission_map: Texture | None = None


def reflecting_meshes(scene: Scene) -> ReflectingMeshes:
    """What each mesh of a scene reflects and emits, in the meshes' own order, which is that of RayScene."""
    parts = [(mesh.geometry, _reflection(mesh.material)) for mesh in scene.meshes]
    numbers: dict[int, int] = {}
    smaller: list[tuple[np.ndarray, tuple[bool, bool]]] = []
    for _, reflection in parts:
        for image in (reflection.colour_map, reflection.emission_map):
            if image is not None and id(image.texels) not in numbers:
                numbers[id(image.texels)] = len(smaller)
                smaller.append((reduced(image.texels), image.repeats))
    sizes = [texels.shape[0] * texels.shape[1] for texels, _ in smaller]
    firsts = np.cumsum([0, *sizes])
    rows = [(first, *texels.shape[:2], *repeats) for first, (texels, repeats) in zip(firsts.tolist(), smaller, strict=False)]
    vertices = np.cumsum([0, *(len(geometry.positions) for geometry, _ in parts)])

    def stacked(values: list[np.ndarray], width: int) -> np.ndarray:
        return np.ascontiguousarray(np.concatenate([np.zeros((0, width)), *values]), np.float32)

    return ReflectingMeshes(
        first_triangle=np.cumsum([0, *(len(geometry.triangles) for geometry, _ in parts)]),
        triangles=np.concatenate([part[0].triangles.astype(np.int64) + first for part, first in zip(parts, vertices, strict=False)]),
        colour_uvs=stacked([_uvs(geometry, reflection.colour_map) for geometry, reflection in parts], 2),
        emission_uvs=stacked([_uvs(geometry, reflection.emission_map) for geometry, reflection in parts], 2),
        vertex_colours=stacked([_vertex_colours(geometry) for geometry, _ in parts], 3),
        colour=np.array([reflection.colour for _, reflection in parts], np.float32),
        reflectance=np.array([reflection.reflectance for _, reflection in parts], np.float32),
        metallic=np.array([reflection.metallic for _, reflection in parts], np.float32),
        emission=np.array([reflection.emission for _, reflection in parts], np.float32),
        unlit=np.array([isinstance(mesh.material, Unlit) for mesh in scene.meshes]),
        catcher=np.array([isinstance(mesh.material, ShadowCatcher) for mesh in scene.meshes]),
        colour_texture=np.array([_number(numbers, reflection.colour_map) for _, reflection in parts]),
        emission_texture=np.array([_number(numbers, reflection.emission_map) for _, reflection in parts]),
        texels=stacked([texels.reshape(-1, 3) for texels, _ in smaller], 3),
        textures=np.array(rows, np.int64).reshape(-1, 5),
    )


def _reflection(material: Material) -> _Reflection:
    match material:
        case Phong():
            # diffuse + specular = r + (1 - r) c
            diffuse = np.asarray(material.diffuse) / np.maximum(1 - np.asarray(material.specular), 1e-6)
            return _Reflection(tuple(np.minimum(diffuse, 1)), material.specular, colour_map=material.colour_map)
        case Ggx():
            metallic = material.metallic
            if material.metallic_roughness_map is not None:
                metallic *= float(material.metallic_roughness_map.texels[..., 0].mean(dtype=np.float64))
            reflectance = (material.reflectance,) * 3
            return _Reflection(material.base_color, reflectance, metallic, material.emission, material.colour_map, material.emission_map)
        case SpecularGlossiness():
            specular = np.asarray(material.specular)
            if material.specular_glossiness_map is not None:
                specular = specular * material.specular_glossiness_map.texels[..., :3].mean(axis=(0, 1), dtype=np.float64)
            kept = (1 - specular.max()) / np.maximum(1 - specular, 1e-6)
            colour = tuple(np.asarray(material.diffuse) * kept)
            return _Reflection(colour, tuple(specular), 0.0, material.emission, material.colour_map, material.emission_map)
        case Unlit():
            return _Reflection(emission=material.base_color, emission_map=material.colour_map)
        case ShadowCatcher():
            return _Reflection()


def _number(numbers: dict[int, int], image: Texture | None) -> int:
    return NONE if image is None else numbers[id(image.texels)]


def _vertex_colours(geometry: Geometry) -> np.ndarray:
    return np.ones((len(geometry.positions), 3)) if geometry.colours is None else geometry.colours[:, :3]


def _uvs(geometry: Geometry, image: Texture | None) -> np.ndarray:
    """Where the vertices (n, 2) lie in an image; anywhere without one."""
    if image is None:
        return np.zeros((len(geometry.positions), 2))
    uvs = geometry.uvs if image.uv_set == 0 or geometry.second_uvs is None else geometry.second_uvs
    transform = np.eye(3)[:2] if image.uv_transform is None else image.uv_transform
    return uvs @ transform[:, :2].T + transform[:, 2]


def reduced(texels: np.ndarray) -> np.ndarray:
    """The first three channels of a texture (h, w, c) with at most REDUCED texels a side, float32: means of those they cover."""
    colours = texels[..., :3].astype(np.float32)
    for axis in (0, 1):
        length = colours.shape[axis]
        count = min(length, REDUCED)
        edges = np.arange(count) * length // count
        sums = np.add.reduceat(colours, edges, axis=axis)
        widths = np.diff(np.append(edges, length)).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        colours = sums / widths
    return colours


@subroutine
def texel_number(meshes, texture, s, t):
    """The number of the texel at (s, t) of a texture of ReflectingMeshes, NONE without one."""
    if texture < 0 or not (abs(s) < 1e9 and abs(t) < 1e9):
        return NONE
    first, rows, columns, across, up = meshes.textures[texture]
    column, row = int(np.floor(s * columns)), int(np.floor(t * rows))
    column = column % columns if across else min(max(column, 0), columns - 1)
    row = row % rows if up else min(max(row, 0), rows - 1)
    return first + row * columns + column
