"""A scene for browsers: what vemlight.runtime.flat_scene describes, made of what the renderer draws itself."""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from vemlight import settings
from vemlight.light import extent, reflected_light
from vemlight.light.colour import srgb_from_linear
from vemlight.renderer.browser.es_shaders import LIGHT_TEXELS, NEAR_VIEW_TEXELS, SURFEL_RAYS, browser_shaders
from vemlight.renderer.browser.reflecting_rows import reflecting_rows
from vemlight.renderer.browser.surfels import MOST_RAY_TRIANGLES, SURFEL_LIFT, fine_enough, seen_from, surfels
from vemlight.renderer.gl import constants
from vemlight.renderer.gl.buffers import LIGHT_FRAME, NEAR_LIGHT, NEAR_SHADOW_VIEW
from vemlight.renderer.gl.constants import HASHED_ALPHA, MaterialKind, MaterialTexture
from vemlight.renderer.passes.gbuffer.material_uniforms import MaterialUniforms, material_uniforms
from vemlight.renderer.passes.gloss import lobe_albedo, prefiltered_map
from vemlight.renderer.passes.luminaires import depth_range
from vemlight.renderer.passes.near_lights import near_light_plan, near_light_views
from vemlight.renderer.passes.shadow_maps import shadow_map_resolution
from vemlight.renderer.passes.shadow_maps.casters import Caster, Casters, scene_casters
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import map_resolutions
from vemlight.renderer.rays.reflecting import reflecting_meshes
from vemlight.renderer.scene.alpha_vertices import WHITE
from vemlight.renderer.scene.materials import Material, ShadowCatcher, alpha_test_of, emits
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.subdivision import seen_short
from vemlight.renderer.scene.textures import Texture
from vemlight.renderer.scene.vertex_buffers import local_order, vertex_buffers
from vemlight.runtime import flat_scene, wire
from vemlight.runtime.flat_scene import (
    ALIGNED,
    MAX_DATA,
    SURFEL_SIDE,
    FlatCaster,
    FlatCasters,
    FlatDetail,
    FlatMaterial,
    FlatMesh,
    FlatRange,
    FlatScene,
    FlatTexture,
    FlatView,
    Span,
)
from vemlight.runtime.poses import MAX_POSES, View

LEAST_TEXTURE_SIDE = 64  # texels, to which textures are reduced at most so that a scene fits; 16 to 256 would do
TYPES = {"f": "float32", "u": "uint32"}
LAWS = {
    constants: ("CUBE_TANGENT", "FARTHEST_DEPTH", "GUTTER", "NEAR_BATCH", "NEAR_FRACTION", "SHADOW_BIAS_TEXELS"),
    shadow_map_resolution: ("EXPONENT", "FULL_FRACTION", "HYSTERESIS", "SAME_SHADOW_TEXELS"),
    extent: ("DIVIDED_RAD", "POINTS"),
    depth_range: ("FAR_MARGIN", "QUARTER"),
    near_light_views: ("EDGE_TEXELS", "MAX_RESOLUTION"),
    near_light_plan: ("KEPT_RAD", "KEPT_RADIUS"),
    prefiltered_map: ("HEXAGON_VARIANCE", "LEVELS", "REACH"),
    reflected_light: ("CELL_VARIANCE", "GAUSSIAN_SPACING", "NEIGHBOURS"),
}
LAYOUTS = {"LIGHT": LIGHT_FRAME, "NEAR": NEAR_LIGHT, "NEAR_VIEW": NEAR_SHADOW_VIEW}  # records of which browsers write fields by name


class TooLargeError(ValueError):
    """A scene that no browser should be asked to hold."""


class Block:
    """The bytes that the description speaks of."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self.size = 0

    def add(self, array: np.ndarray) -> Span:
        """Appends an array. Raises TooLargeError when there is no more room."""
        data = array.tobytes()
        kind = "uint8" if array.dtype == np.uint8 else TYPES[array.dtype.kind]
        span = Span(offset=self.size, count=array.size, type=kind)  # type: ignore[arg-type]
        padding = -len(data) % ALIGNED
        self.size += len(data) + padding
        if self.size > MAX_DATA:
            raise TooLargeError
        self._parts += [data, bytes(padding)]
        return span

    def bytes(self) -> bytes:
        return b"".join(self._parts)


class Flattened(NamedTuple):
    """A scene's description and its block of bytes."""

    scene: FlatScene
    data: bytes


def scene_message(scene: Scene, drawing: settings.Renderer) -> wire.Message:
    """The scene as a message, to be drawn as the settings say."""
    try:
        made = flattened(scene, drawing)
    except TooLargeError:
        text = f"this scene has more than {MAX_DATA >> 20} MB of triangles: only the server draws it"
        return wire.SceneMessage(description_bytes=0, data_bytes=0, text=text), (np.zeros(0, np.uint8), np.zeros(0, np.uint8))
    description = np.frombuffer(flat_scene.encoded(made.scene), np.uint8)
    data = np.frombuffer(made.data, np.uint8)
    return wire.SceneMessage(description_bytes=len(description), data_bytes=len(data)), (description, data)


def flattened(scene: Scene, drawing: settings.Renderer) -> Flattened:
    """The scene and its bytes. Raises TooLargeError for one that does not fit, whose textures may be reduced until it does."""
    resolutions = map_resolutions(drawing.shadow_map)
    short = seen_short((mesh.geometry for mesh in scene.meshes), scene.camera)
    scene = scene._replace(meshes=tuple(mesh._replace(geometry=own) for mesh, own in zip(scene.meshes, short, strict=True)))
    casters = scene_casters(scene, resolutions.choices)
    rays = _has_rays(scene, drawing)
    fine = fine_enough(short, scene.camera) if rays else short
    scene = scene._replace(meshes=tuple(mesh._replace(geometry=local_order(own)) for mesh, own in zip(scene.meshes, fine, strict=True)))
    reflecting = reflecting_meshes(scene)
    bounce = surfels(scene, reflecting) if rays else None
    block = Block()
    buffers = vertex_buffers(scene)
    rows = buffers.vertices
    local = [
        buffers.indices[run.first : run.end] - np.uint32(own.first)
        for run, own in zip(buffers.mesh_ranges, buffers.vertex_ranges, strict=True)
    ]
    arrays = {name: block.add(rows[name[:-1]].astype("<f4")) for name in ("positions", "normals", "uvs")}
    if any(mesh.geometry.colours is not None for mesh in scene.meshes):
        arrays["colours"] = block.add(rows["vertex_colour"].astype("<f4"))
    if any(mesh.geometry.second_uvs is not None for mesh in scene.meshes):
        arrays["second_uvs"] = block.add(buffers.second_uvs.astype("<f4"))
    arrays["indices"] = block.add(np.concatenate(local).astype("<u4"))
    if scene.glossy:
        arrays["lobe_albedo"] = block.add(lobe_albedo.ggx_albedo())
    found = reflecting_rows(scene, reflecting)
    arrays["reflecting"], arrays["reflecting_texels"] = block.add(found.rows), block.add(found.texels)
    for name, own, texture in (("colour_uvs", found.colour_uvs, 12), ("emission_uvs", found.emission_uvs, 16)):
        where = np.repeat(found.rows[:, texture] >= 0, [run.count for run in buffers.vertex_ranges])
        if not np.array_equal(own[where], rows["uv"][where]):
            arrays[name] = block.add(own)
    if bounce:
        arrays["surfels"], arrays["surfel_weights"] = block.add(bounce.rows), block.add(bounce.weights)
        arrays["vertex_surfels"] = block.add(bounce.of_vertices.astype("<u2").view("<u4"))
    arrays["caster_positions"] = block.add(casters.positions.astype("<f4"))
    arrays["caster_indices"] = block.add(casters.indices.astype("<u4"))

    materials, numbers = _distinct([mesh.material for mesh in scene.meshes])
    emission = any(emits(material) for material in materials)
    uniforms = [material_uniforms(material, emission) for material in materials]
    textures, of_texture, reduced = _textures(uniforms, block)
    backs = bounce.backs if bounce else [0] * len(scene.meshes)
    meshes = tuple(
        FlatMesh(
            name=mesh.name[:200],
            object=mesh.object_index if mesh.object_index is not None and mesh.object_index < MAX_POSES else None,
            vertices=FlatRange(first=own.first, count=own.count),
            indices=FlatRange(first=run.first, count=run.count),
            material=number,
            back=back,
        )
        for mesh, own, run, number, back in zip(scene.meshes, buffers.vertex_ranges, buffers.mesh_ranges, numbers, backs, strict=True)
    )
    camera = View(eye=scene.camera.position, at=scene.camera.at, fov_y=float(np.clip(scene.camera.fov_y, 1, 170)))
    made = FlatScene(
        version=1,
        camera=FlatView(name="scene file", view=camera),
        views=tuple(FlatView(name=name[:200], view=view) for name, view in scene.views[: flat_scene.MAX_VIEWS]),
        objects=scene.objects[:MAX_POSES],
        centre=_triple(scene.centre),
        half=_triple(scene.half),
        size=(drawing.width, drawing.height),
        arrays=arrays,
        meshes=meshes,
        materials=tuple(_material(material, one, of_texture) for material, one in zip(materials, uniforms, strict=True)),
        textures=textures,
        casters=_casters(casters),
        laws={name: float(getattr(module, name)) for module, names in LAWS.items() for name in names}
        | {"LARGEST_MAP": resolutions.largest, "MAP_HALVINGS": resolutions.halvings, "BY_POWER": float(resolutions.by_power)}
        | {"LIGHT_TEXELS": LIGHT_TEXELS, "NEAR_TEXELS": NEAR_LIGHT.dtype.itemsize // 16, "NEAR_VIEW_TEXELS": NEAR_VIEW_TEXELS}
        | {"EMISSION": float(emission), "RAYS": float(rays), "BACKGROUND": float(drawing.background == "map")}
        | {"PREFILTER_SIDE": prefiltered_map.SIDES[0], "PREFILTER_TEXEL_RAD": prefiltered_map.texel_rad(prefiltered_map.SIDES[0])}
        | {"SURFEL_SIDE": SURFEL_SIDE, "SURFEL_RAYS": SURFEL_RAYS, "SURFEL_LIFT": SURFEL_LIFT * seen_from(scene.camera)}
        | {"ALBEDO_SIZE": lobe_albedo.SIZE}
        | {f"KIND_{kind.name}": kind.value for kind in MaterialKind}
        | {
            f"{record}_AT_{name}": layout.dtype.fields[name][1] / 4  # type: ignore[index]
            for record, layout in LAYOUTS.items()
            for name in layout.dtype.names or ()
        },
        shaders=browser_shaders(),
        left_out=tuple(_left_out(scene, drawing, reduced, bounce is not None)),
    )
    return Flattened(made, block.bytes())


def _left_out(scene: Scene, drawing: settings.Renderer, reduced: int, bounce: bool) -> list[str]:
    """What browsers do not draw of this scene, a line each."""
    lines = []
    if drawing.bounces and not bounce:
        only = " (mirrors show the sky alone)" if scene.glossy and not _has_rays(scene, drawing) else ""
        lines.append(f"light from surface to surface{only}")
    if scene.luminaires:
        lines.append("the scene's lamps")
    if scene.plate is not None or any(isinstance(mesh.material, ShadowCatcher) for mesh in scene.meshes):
        lines.append("the plate behind it and shadows on that")
    if any(mesh.motion for mesh in scene.meshes):
        lines.append("its files' animations")
    if reduced > 1:
        lines.append(f"textures finer than a {reduced}th of theirs" if reduced > 2 else "textures finer than half of theirs")
    return lines


def _has_rays(scene: Scene, drawing: settings.Renderer) -> bool:
    """Whether browsers follow rays through the scene."""
    return drawing.bounces > 0 and sum(len(mesh.geometry.triangles) for mesh in scene.meshes) <= MOST_RAY_TRIANGLES


def _distinct(materials: list[Material]) -> tuple[list[Material], list[int]]:
    """The materials without repetitions, and the number of each mesh's."""
    numbers: dict[int, int] = {}
    found: list[Material] = []
    for material in materials:
        if id(material) not in numbers:
            numbers[id(material)] = len(found)
            found.append(material)
    return found, [numbers[id(material)] for material in materials]


def _material(material: Material, uniforms: MaterialUniforms, of_texture: Callable[[Texture, int], int]) -> FlatMaterial:
    textures = tuple(None if one is None else of_texture(one, slot) for slot, one in enumerate(uniforms.textures))
    test = alpha_test_of(material)
    image = test.image if test and test.image else WHITE
    transform = np.eye(3)[:2] if image.uv_transform is None else image.uv_transform
    return FlatMaterial(
        variant=uniforms.variant,
        row=tuple(np.frombuffer(uniforms.row.tobytes(), "<f4").tolist()),
        kind=int(uniforms.row["kind"]),
        textures=textures,
        cutoff=None if test is None else HASHED_ALPHA if test.cutoff is None else test.cutoff,
        alpha=test.alpha if test else 1.0,
        alpha_uv_set=image.uv_set,
        alpha_uv_transform=(_triple(transform[0]), _triple(transform[1])),
    )


def _textures(uniforms: list[MaterialUniforms], block: Block) -> tuple[tuple[FlatTexture, ...], Callable[[Texture, int], int], int]:
    """Adds each image's texels once; returns a texture for each way in which one is read, the number of one, and by how much all were
    reduced in width and height so that they fit."""
    ways: dict[tuple[object, ...], tuple[Texture, bool]] = {}
    for one in uniforms:
        for slot, image in enumerate(one.textures):
            if image is not None:
                ways.setdefault(_way(image, slot), (image, _is_colour(slot)))
    images = {(id(image.texels), is_colour): image for image, is_colour in ways.values()}
    room, reduced = MAX_DATA - block.size, 1
    while images and sum(4 * np.prod(_reduced(image, reduced)) for image in images.values()) > room:
        reduced *= 2
        if reduced > 2**12:
            raise TooLargeError
    spans = {key: block.add(_codes(image, key[1], _reduced(image, reduced))) for key, image in images.items()}
    made, keys = [], list(ways)
    for image, is_colour in ways.values():
        height, width = _reduced(image, reduced)
        made.append(
            FlatTexture(
                texels=spans[id(image.texels), is_colour],
                width=width,
                height=height,
                srgb=is_colour,
                repeats=image.repeats,
                filters=image.filters,  # type: ignore[arg-type]
            )
        )
    return tuple(made), lambda image, slot: keys.index(_way(image, slot)), reduced


def _way(image: Texture, slot: int) -> tuple[object, ...]:
    """Which texels a texture has, and how they are read."""
    return id(image.texels), _is_colour(slot), image.repeats, image.filters


def _is_colour(slot: int) -> bool:
    return slot in (MaterialTexture.COLOUR, MaterialTexture.EMISSIVE)


def _reduced(image: Texture, times: int) -> tuple[int, int]:
    """Height and width of an image that is reduced."""
    height, width, _ = image.texels.shape
    least = min(LEAST_TEXTURE_SIDE, height, width)
    return max(height // times, least), max(width // times, least)


def _codes(image: Texture, is_colour: bool, size: tuple[int, int]) -> np.ndarray:
    """The image as (h, w, 4) uint8; missing channels are 255."""
    texels = np.clip(image.texels.astype(np.float32), 0, 1)
    if texels.shape[:2] != size:
        texels = np.atleast_3d(np.asarray(cv2.resize(texels, size[::-1], interpolation=cv2.INTER_AREA)))
    if is_colour:
        texels[..., :3] = srgb_from_linear(texels[..., :3])
    codes = np.full((*size, 4), 255, np.uint8)
    codes[..., : texels.shape[2]] = np.rint(255 * texels)
    return codes


def _casters(casters: Casters) -> FlatCasters:
    centres, halves = [_triple(one) for one in casters.box_centre], [_triple(one) for one in casters.box_half]
    return FlatCasters(
        members=tuple(_caster(member) for member in casters.members),
        receiver_plane=_caster(casters.receiver_plane) if casters.receiver_plane else None,
        levels=casters.levels,
        plane_normal=_triple(casters.plane_normal),
        box_centre=(centres[0], centres[1]),
        box_half=(halves[0], halves[1]),
    )


def _caster(caster: Caster) -> FlatCaster:
    details = (FlatDetail(indices=FlatRange(first=own.indices.first, count=own.indices.count), closed=own.closed) for own in caster.details)
    return FlatCaster(mesh=caster.mesh, details=tuple(details))


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = np.asarray(vector, np.float64).tolist()
    return x, y, z
