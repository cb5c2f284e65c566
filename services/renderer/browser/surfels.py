"""Places on a scene's surfaces at which a browser keeps what surfaces send to each other, and which of them each vertex lies among.

A bounce changes slowly over a surface. So the vertices are put into clusters of one mesh, one neighbourhood and like normals, and one of
each stands for them. A browser lights those, follows rays from each to find which others it sees, and gives every vertex the mean of the
nearest ones. Open meshes have two sides with surfels of their own, as have closed ones with something in them.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from vemlight.renderer.rays.reflecting import NONE, ReflectingMeshes
from vemlight.renderer.scene.camera_table import ViewCamera
from vemlight.renderer.scene.meshes import MAX_SIZE_M, Geometry, bounds
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.subdivision import with_short_edges
from vemlight.runtime.flat_scene import MAX_SURFELS, SURFELS_A_VERTEX

# Of the distance from which a scene is seen: how long edges may be about what the camera looks at, how far about, and how large
# clusters are at first.
FINE, ABOUT, CLUSTER = 1 / 32, 1 / 2, 1 / 64
SURFEL_LIFT = 1e-4  # likewise, by which rays begin off a surface: a millimetre of ten metres
MOST_RAY_TRIANGLES = 2**18  # 16 MB of textures in a browser, which puts them anew in 0.1 s when something moves
GROWTH = 1.2  # of the clusters, until there are few enough
NORMAL_OF_SIZE = 2.0  # how many sizes of a cluster two normals are apart that differ by 60 degrees: farther than its neighbours
INWARDS = 1 / 3  # of the way to its triangle's middle, by which a surfel lies off its vertex: corners stand in others' surfaces
CORNER = 2 / 3  # of the weight of the corner beside each of the places at which a triangle's colours are read
LEAST_SPREAD = 1e-6  # of a cluster's size, in place of no distance at all


class Surfels(NamedTuple):
    """rows: (s, 16) float32: place, mesh; normal, 0; albedo (-1: of the ground under a catcher), 0; emission, 0. of_vertices: (n,
    SURFELS_A_VERTEX) uint16, the nearest on its front, the nearest first. weights: the same shape, uint8 with the sum 255. backs: of each
    mesh by how much the surfel on the back is more than that on the front; 0: it is closed."""

    rows: np.ndarray
    of_vertices: np.ndarray
    weights: np.ndarray
    backs: tuple[int, ...]


def fine_enough(geometries: list[Geometry], camera: ViewCamera) -> list[Geometry]:
    """The meshes with vertices close enough for a bounce, about what a camera looks at."""
    at, distance = np.array(camera.at, np.float64), seen_from(camera)
    cut = [with_short_edges(mesh, at, FINE * distance, ABOUT * distance) for mesh in geometries]
    return cut if sum(len(mesh.triangles) for mesh in cut) <= MOST_RAY_TRIANGLES else geometries


def seen_from(camera: ViewCamera) -> float:
    """How far a camera is from what it looks at, metres."""
    return float(np.linalg.norm(np.subtract(camera.at, camera.position)))


def surfels(scene: Scene, meshes: ReflectingMeshes) -> Surfels | None:
    """The surfels of a scene; None where there would be too many even in few large clusters."""
    geometries = [mesh.geometry for mesh in scene.meshes]
    size = CLUSTER * seen_from(scene.camera)
    sides = [1 if mesh.closed and not holding else 2 for mesh, holding in zip(geometries, _holding(scene), strict=True)]
    while True:
        clusters = [_clusters(own, size) for own in geometries]
        if sum(count * (own.max() + 1) for count, own in zip(sides, clusters, strict=True)) <= MAX_SURFELS:
            break
        if size > MAX_SIZE_M:
            return None
        size *= GROWTH
    rows, ids, weights, backs, first = [], [], [], [], 0
    for number, (own, mesh, count) in enumerate(zip(clusters, geometries, sides, strict=True)):
        vertices = _chosen(mesh, own)
        front = np.zeros((len(vertices), 16), np.float32)
        front[:, 0:3], front[:, 3], front[:, 4:7] = _inside(mesh, vertices), number, mesh.normals[vertices]
        nearest, shares = _neighbours(mesh, vertices, size)
        front[:, 8:11], front[:, 12:15] = _colours(meshes, number, mesh, nearest[:, 0], len(vertices))
        back = front * np.repeat([1, -1, 1], [4, 4, 8]).astype(np.float32)
        rows += [front, back][:count]
        ids.append(nearest + first)
        weights.append(shares)
        backs.append((count - 1) * len(vertices))
        first += count * len(vertices)
    return Surfels(np.concatenate(rows), np.concatenate(ids).astype(np.uint16), np.concatenate(weights), tuple(backs))


def _holding(scene: Scene) -> list[bool]:
    """Whether a camera or another mesh lies within each mesh's box: it may be a room."""
    eyes = [scene.camera.position, *(view.eye for _, view in scene.views)]
    boxes = np.array([bounds([mesh.geometry]) for mesh in scene.meshes] + [(eye, eye) for eye in eyes])
    low, high = boxes[:, 0], boxes[:, 1]  # a box does not lie within itself
    return [bool(((low > own_low) & (high < own_high)).all(axis=1).any()) for own_low, own_high in boxes[: len(scene.meshes)]]


def _clusters(mesh: Geometry, size: float) -> np.ndarray:
    """The number of each vertex's cluster (n,): those in one cube of that size whose normals pass through one face of a cube."""
    cells = np.floor((mesh.positions.astype(np.float64) - mesh.positions.min(axis=0)) / size).astype(np.int64)
    faces = np.argmax(np.hstack([mesh.normals, -mesh.normals]), axis=-1)
    return np.unique(np.column_stack([cells, faces]), axis=0, return_inverse=True)[1].reshape(-1)


def _chosen(mesh: Geometry, clusters: np.ndarray) -> np.ndarray:
    """The vertex nearest to the middle of each cluster."""
    count = clusters.max() + 1
    places = mesh.positions.astype(np.float64)
    middles = np.stack([np.bincount(clusters, axis, count) for axis in places.T], axis=-1) / np.bincount(clusters, minlength=count)[:, None]
    order = np.lexsort([np.linalg.norm(places - middles[clusters], axis=-1), clusters])
    return order[np.unique(clusters[order], return_index=True)[1]]


def _inside(mesh: Geometry, vertices: np.ndarray) -> np.ndarray:
    """Where surfels at vertices lie: on one of their triangles."""
    triangle_of = np.zeros(len(mesh.positions), np.int64)
    triangle_of[mesh.triangles.reshape(-1)] = np.repeat(np.arange(len(mesh.triangles)), 3)
    middles = mesh.positions[mesh.triangles[triangle_of[vertices]]].astype(np.float64).mean(axis=1)
    return (1 - INWARDS) * mesh.positions[vertices] + INWARDS * middles


def _neighbours(mesh: Geometry, vertices: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Of each vertex the SURFELS_A_VERTEX nearest of the mesh's surfels, by place and normal, and their weights, which fall to 0 where
    another one takes over, and for those that face aside."""
    apart = np.column_stack([mesh.positions.astype(np.float64), NORMAL_OF_SIZE * size * mesh.normals])
    count = min(SURFELS_A_VERTEX + 1, len(vertices))
    distances, nearest = KDTree(apart[vertices]).query(apart, count)
    distances, nearest = distances.reshape(len(apart), count), nearest.reshape(len(apart), count)
    reach = distances[:, -1:] if count > SURFELS_A_VERTEX else 2 * distances[:, -1:]
    facing = np.einsum("nkx,nx->nk", mesh.normals[vertices][nearest], mesh.normals)
    shares = (np.maximum(1 - distances / np.maximum(reach, LEAST_SPREAD * size), 0) * np.maximum(facing, 0)) ** 2
    ids, weights = np.zeros((len(apart), SURFELS_A_VERTEX), np.int64), np.zeros((len(apart), SURFELS_A_VERTEX))
    kept = min(count, SURFELS_A_VERTEX)
    ids[:, :kept], weights[:, :kept] = nearest[:, :kept], shares[:, :kept]
    weights[:, 0] = np.maximum(weights[:, 0], LEAST_SPREAD)
    codes = np.rint(255 * weights / weights.sum(axis=-1, keepdims=True)).astype(np.int64)
    codes[:, 0] += 255 - codes.sum(axis=-1)
    return ids, codes.astype(np.uint8)


def _colours(meshes: ReflectingMeshes, number: int, mesh: Geometry, surfel_of: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and emission (count, 3) of a mesh's surfels: means over its triangles, each read beside its corners for their surfels."""
    first = meshes.triangles[meshes.first_triangle[number]].min() - mesh.triangles[0].min()
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    sums = np.zeros((count, 7))
    for corner in range(3):
        weights = np.where(np.arange(3) == corner, CORNER, (1 - CORNER) / 2)
        albedo, emission = _read(meshes, number, mesh.triangles.astype(np.int64) + first, weights)
        np.add.at(sums, surfel_of[mesh.triangles[:, corner]], np.column_stack([albedo, emission, np.ones(len(areas))]) * areas[:, None])
    means = sums[:, :6] / np.maximum(sums[:, 6:], np.finfo(float).tiny)
    return (np.full((count, 3), -1.0) if meshes.catcher[number] else means[:, :3]), means[:, 3:]


def _read(meshes: ReflectingMeshes, number: int, triangles: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and emission (m, 3) of a mesh at the same place of each triangle, as take_hit of rays/hits.py has it."""
    own = np.einsum("c,mcx->mx", weights, meshes.vertex_colours[triangles].astype(np.float64))
    colour = meshes.colour[number] * own * _texels(meshes, meshes.colour_texture[number], weights, meshes.colour_uvs[triangles])
    emission = meshes.emission[number] * _texels(meshes, meshes.emission_texture[number], weights, meshes.emission_uvs[triangles])
    metallic = meshes.metallic[number]
    reflectance = meshes.reflectance[number] * (1 - metallic) + metallic * colour
    albedo = np.minimum(reflectance + (1 - reflectance) * (1 - metallic) * colour, 1)
    return albedo, emission * own if meshes.unlit[number] else emission


def _texels(meshes: ReflectingMeshes, texture: int, weights: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """A texture's colours (m, 3) at coordinates (m, 3, 2) of corners; ones without a texture."""
    if texture == NONE:
        return np.ones((len(uvs), 3))
    first, rows, columns, across, up = meshes.textures[texture]
    places = np.einsum("c,mcx->mx", weights, uvs.astype(np.float64))
    at = [
        np.mod(np.floor(places[:, axis] * size), size) if repeats else np.clip(np.floor(places[:, axis] * size), 0, size - 1)
        for axis, (size, repeats) in enumerate(((columns, across), (rows, up)))
    ]
    return meshes.texels[first + at[1].astype(np.int64) * columns + at[0].astype(np.int64)]
