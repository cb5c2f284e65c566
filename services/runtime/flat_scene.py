"""A scene as it travels to a browser: flat buffers in one block of bytes, and this description of what lies where in it.

The renderer makes it once (`SceneMessage` of wire.py), the viewer checks it and serves both. Whoever draws it needs nothing else but
lights and poses. Numbers are little-endian, each array begins at a multiple of ALIGNED bytes.
"""

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.files import decoded_json
from vemlight.runtime.poses import MAX_POSES, Pose, View
from vemlight.runtime.wire_fields import Finite, Side

MAX_DATA = 48 * 2**20  # bytes: what a phone's browser holds twice; a part of a message has 64 MB at most. 16 to 60 MB would do
MAX_DESCRIPTION = 2**22  # bytes: 4096 meshes with their casters have half of it, the shaders 150 kB
ALIGNED = 4
MAX_MESHES, MAX_TEXTURES, MAX_VIEWS = 4096, 1000, 32
MAX_HALVINGS = 16  # of shadow maps: from 65,536 texels a side to one. A page counts them for each light
SURFEL_SIDE = 64  # of the square texture of surfels
MAX_SURFELS, SURFEL_NUMBERS, SURFELS_A_VERTEX = SURFEL_SIDE**2, 16, 4  # 256 kB; a vertex has 12 bytes to say between which it lies
REFLECTING_NUMBERS = 20  # of a mesh in `reflecting`: five texels
ITEM_BYTES = {"float32": 4, "uint32": 4, "uint8": 1}

Index = Annotated[int, Meta(ge=0, lt=2**31)]
Short = Annotated[str, Meta(max_length=200)]
Matrix = Annotated[tuple[Finite, ...], Meta(min_length=3, max_length=3)]


class Flat(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of what a description holds."""


class Span(Flat, frozen=True):
    """An array in the block: where it begins (bytes), how many numbers, of which type."""

    offset: Index
    count: Index
    type: Literal["float32", "uint32", "uint8"]

    @property
    def end(self) -> int:
        return self.offset + self.count * ITEM_BYTES[self.type]


class FlatView(Flat, frozen=True):
    """A camera by name, as View."""

    name: Short
    view: View


class FlatRange(Flat, frozen=True):
    """A run of indices or vertices."""

    first: Index
    count: Index


class FlatMesh(Flat, frozen=True):
    """A mesh: the object that it is part of, its vertices, its indices (of these vertices, from 0 on), its material.
    back: by how much the number of a surfel on its back is more than of that on its front; 0: it has no back."""

    name: Short
    object: Annotated[int, Meta(ge=0, lt=MAX_POSES)] | None
    vertices: FlatRange
    indices: FlatRange
    material: Index
    back: Annotated[int, Meta(ge=0, le=MAX_SURFELS)] = 0


class FlatTexture(Flat, frozen=True):
    """Texels of four bytes, row 0 at v = 0. srgb: whether colours are coded by the sRGB curve. filters: OpenGL's numbers, small, large."""

    texels: Span
    width: Annotated[int, Meta(ge=1, le=8192)]
    height: Annotated[int, Meta(ge=1, le=8192)]
    srgb: bool
    repeats: tuple[bool, bool]
    filters: tuple[Literal[9728, 9729, 9984, 9985, 9986, 9987], Literal[9728, 9729]]


class FlatMaterial(Flat, frozen=True):
    """Which variant of the surface shader draws it, its uniform block as numbers, its kind and its textures by unit.

    cutoff: of its alpha test, where it has one; alpha, alpha_uv_set, alpha_uv_transform: of that, as in
    vemlight.renderer.scene.alpha_vertices.
    """

    variant: Annotated[dict[Annotated[str, Meta(max_length=32)], Short | int], Meta(max_length=16)]
    row: Annotated[tuple[Finite, ...], Meta(max_length=256)]
    kind: Annotated[int, Meta(ge=0, lt=16)]
    textures: Annotated[tuple[Index | None, ...], Meta(max_length=8)]
    cutoff: Finite | None = None
    alpha: Finite = 1.0
    alpha_uv_set: Annotated[int, Meta(ge=0, le=1)] = 0
    alpha_uv_transform: tuple[Matrix, Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


class FlatDetail(Flat, frozen=True):
    """A caster's indices at one level of detail, and whether it is closed there."""

    indices: FlatRange
    closed: bool


class FlatCaster(Flat, frozen=True):
    """What a mesh casts shadows by: a level of detail for each of `FlatCasters.levels`."""

    mesh: Index
    details: Annotated[tuple[FlatDetail, ...], Meta(max_length=16)]


class FlatCasters(Flat, frozen=True):
    """What casts shadows, as vemlight.renderer.passes.shadow_maps.casters.Casters; boxes: with a receiver plane, and without one."""

    members: Annotated[tuple[FlatCaster, ...], Meta(max_length=MAX_MESHES)]
    receiver_plane: FlatCaster | None
    levels: Annotated[tuple[Annotated[int, Meta(ge=0, lt=16)], ...], Meta(min_length=1, max_length=16)]
    plane_normal: Matrix
    box_centre: tuple[Matrix, Matrix]
    box_half: tuple[Matrix, Matrix]


class FlatScene(Flat, frozen=True):
    """The description. arrays: `positions`, `normals` (3 a vertex), `uvs` (2), `colours` (4) and `second_uvs` (2) where a mesh has them,
    `indices`, `caster_positions`, `caster_indices`, and `lobe_albedo` (2 an entry) where something is glossy. What rays find, as
    vemlight.renderer.browser.reflecting_rows has it: `reflecting` (REFLECTING_NUMBERS a mesh), `reflecting_texels` (4), and `colour_uvs`
    and `emission_uvs` (2 a vertex) where they are not `uvs`. Where a browser draws a bounce, as vemlight.renderer.browser.surfels has it:
    `surfels` (SURFEL_NUMBERS each), `vertex_surfels` (two of 16 bits each, 2 a vertex) and `surfel_weights` (4 a vertex). laws: the
    renderer's constants by name. shaders: GLSL ES 3.00 by file name; what a variant defines comes after the first line. left_out: what the
    server's picture has and these do not, a line each.
    """

    version: Literal[1]
    camera: FlatView
    views: Annotated[tuple[FlatView, ...], Meta(max_length=MAX_VIEWS)]
    objects: Annotated[tuple[Pose, ...], Meta(max_length=MAX_POSES)]
    centre: Matrix
    half: Matrix
    size: tuple[Side, Side]
    arrays: Annotated[dict[Annotated[str, Meta(max_length=32)], Span], Meta(max_length=16)]
    meshes: Annotated[tuple[FlatMesh, ...], Meta(max_length=MAX_MESHES)]
    materials: Annotated[tuple[FlatMaterial, ...], Meta(max_length=MAX_MESHES)]
    textures: Annotated[tuple[FlatTexture, ...], Meta(max_length=MAX_TEXTURES)]
    casters: FlatCasters
    laws: Annotated[dict[Annotated[str, Meta(max_length=64)], Finite], Meta(max_length=128)]
    shaders: Annotated[dict[Annotated[str, Meta(max_length=64)], Annotated[str, Meta(max_length=65536)]], Meta(max_length=32)]
    left_out: Annotated[tuple[Short, ...], Meta(max_length=16)] = ()


NUMBERS_A_VERTEX = {"positions": 3, "normals": 3, "uvs": 2, "colours": 4, "second_uvs": 2, "colour_uvs": 2, "emission_uvs": 2}
NEEDED = ("positions", "normals", "uvs", "indices", "caster_positions", "caster_indices", "reflecting", "reflecting_texels")
TYPES = {name: "uint32" if "indices" in name else "float32" for name in (*NEEDED, *NUMBERS_A_VERTEX, "lobe_albedo")}
TYPES |= {"reflecting_texels": "uint8", "surfels": "float32", "vertex_surfels": "uint32", "surfel_weights": "uint8"}
BOUNCE = ("surfels", "vertex_surfels", "surfel_weights")  # all or none


def encoded(scene: FlatScene) -> bytes:
    """The description as JSON."""
    return msgspec.json.encode(scene)


def decoded(description: bytes, data_bytes: int) -> FlatScene:
    """The description of a block of `data_bytes`. Raises ValueError for anything that does not lie within the block or each other."""
    if len(description) > MAX_DESCRIPTION or data_bytes > MAX_DATA:
        raise ValueError(f"scene: more than {MAX_DESCRIPTION} bytes of description or {MAX_DATA} of data")
    scene: FlatScene = decoded_json(description, FlatScene)
    _check_arrays(scene, data_bytes)
    _check(0 <= scene.laws.get("MAP_HALVINGS", 0) <= MAX_HALVINGS, "shadow maps that are halved more often than any can be")
    count = {name: span.count for name, span in scene.arrays.items()}
    vertices = count["positions"] // 3
    for mesh in scene.meshes:
        _check(mesh.vertices.first + mesh.vertices.count <= vertices, "a mesh beyond its vertices")
        _check(mesh.indices.first + mesh.indices.count <= count["indices"], "a mesh beyond its indices")
        _check(mesh.material < len(scene.materials), "a mesh without its material")
        _check(mesh.object is None or mesh.object < len(scene.objects), "a mesh without its object")
    for material in scene.materials:
        _check(all(one is None or one < len(scene.textures) for one in material.textures), "a material without its texture")
    for caster in (*scene.casters.members, *([scene.casters.receiver_plane] if scene.casters.receiver_plane else ())):
        inside = all(own.indices.first + own.indices.count <= count["caster_indices"] for own in caster.details)
        _check(inside and caster.mesh < len(scene.meshes), "a caster beyond its indices")
        _check(len(caster.details) > 0 and (caster is scene.casters.receiver_plane or len(caster.details) > max(scene.casters.levels)),
               "a caster without a level of detail")  # fmt: skip
    return scene


def check_indices(scene: FlatScene, data: np.ndarray) -> None:
    """Raises ValueError for indices of vertices that there are not. data: the block, uint8, of a description that was decoded for it."""
    arrays = {name: data[span.offset : span.end].view("<u4") for name, span in scene.arrays.items() if span.type == "uint32"}
    for mesh in scene.meshes:
        own = arrays["indices"][mesh.indices.first : mesh.indices.first + mesh.indices.count]
        _check(own.max(initial=0) < max(mesh.vertices.count, 1), "an index beyond its mesh's vertices")
    if "surfels" in scene.arrays:
        span, numbers = scene.arrays["surfels"], arrays["vertex_surfels"].view("<u2").reshape(-1, SURFELS_A_VERTEX)
        rows = data[span.offset : span.end].view("<f4").reshape(-1, SURFEL_NUMBERS)
        _check(bool(np.isin(rows[:, 3], np.arange(len(scene.meshes))).all()), "a surfel without its mesh")
        for mesh in scene.meshes:
            own = numbers[mesh.vertices.first : mesh.vertices.first + mesh.vertices.count]
            _check(int(own.max(initial=0)) + mesh.back < max(len(rows), 1), "a vertex among surfels that there are not")
    casters = scene.arrays["caster_positions"].count // 3
    _check(arrays["caster_indices"].max(initial=0) < max(casters, 1), "an index beyond the casters' vertices")


def _check_arrays(scene: FlatScene, data_bytes: int) -> None:
    _check(all(name in scene.arrays for name in NEEDED) and scene.arrays.keys() <= TYPES.keys(), "arrays that are missing or unknown")
    for name, span in scene.arrays.items():
        _check(span.type == TYPES[name] and span.end <= data_bytes and span.offset % ALIGNED == 0, f"{name} beyond the block, or unaligned")
    vertices = scene.arrays["positions"].count // 3
    for name, numbers in NUMBERS_A_VERTEX.items():
        _check(name not in scene.arrays or scene.arrays[name].count == numbers * vertices, f"{name} of another number of vertices")
    _check(scene.arrays["reflecting"].count == REFLECTING_NUMBERS * len(scene.meshes), "what rays find of another number of meshes")
    _check_surfels(scene, vertices)
    _check(scene.arrays["reflecting_texels"].count % 4 == 0, "texels that are not whole")
    for texture in scene.textures:
        fits = texture.texels.type == "uint8" and texture.texels.count == 4 * texture.width * texture.height
        _check(fits and texture.texels.end <= data_bytes, "a texture beyond the block")


def _check_surfels(scene: FlatScene, vertices: int) -> None:
    if not any(name in scene.arrays for name in BOUNCE):
        return
    _check(all(name in scene.arrays for name in BOUNCE), "surfels without their vertices")
    surfels, of_vertices, weights = (scene.arrays[name].count for name in BOUNCE)
    _check(surfels % SURFEL_NUMBERS == 0 and surfels <= SURFEL_NUMBERS * MAX_SURFELS, "surfels that are not whole, or too many")
    _check(of_vertices == 2 * vertices and weights == SURFELS_A_VERTEX * vertices, "surfels of another number of vertices")


def _check(right: bool, fault: str) -> None:
    if not right:
        raise ValueError(f"scene: {fault}")
