"""Exact ray casting of a scene without OpenGL, in numba: what the tests and benches compare the renderer's pictures with.

Rays traverse a bounding volume hierarchy over the triangles (median split); visibility is exact up to float64.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from vemlight.renderer.scene.materials import Ggx, Phong
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.view import view_from_world

LEAF = 4  # triangles


class Tree(NamedTuple):
    """low, high: (nodes, 3) float64 boxes. first, count: (nodes,) int64; a leaf holds `count` triangles from `first`, another node has
    count 0 and the children `first` and first + 1.

    corners: (m, 3, 3) float64, in the tree's order; order: (m,) their numbers in the scene, meshes one after the other.
    """

    low: np.ndarray
    high: np.ndarray
    first: np.ndarray
    count: np.ndarray
    corners: np.ndarray
    order: np.ndarray


class Hits(NamedTuple):
    """What each pixel's centre sees, (height, width, ...): triangle number or -1, position, smooth and flat normal on the viewer's side."""

    triangle: np.ndarray
    position: np.ndarray
    smooth_normal: np.ndarray
    flat_normal: np.ndarray


def scene_tree(scene: Scene) -> Tree:
    """The tree over all triangles of a scene."""
    corners = np.concatenate([mesh.geometry.positions[mesh.geometry.triangles] for mesh in scene.meshes]).astype(np.float64)
    order = np.arange(len(corners))
    centre = corners.mean(axis=1)
    low, high, first, count, stack = [np.zeros(3)], [np.zeros(3)], [0], [0], [(0, 0, len(corners))]
    while stack:
        node, begin, end = stack.pop()
        part = corners[order[begin:end]].reshape(-1, 3)
        low[node], high[node] = part.min(axis=0), part.max(axis=0)
        if end - begin <= LEAF:
            first[node], count[node] = begin, end - begin
            continue
        axis = int(np.argmax(np.ptp(centre[order[begin:end]], axis=0)))
        middle = (begin + end) // 2
        order[begin:end] = order[begin:end][np.argpartition(centre[order[begin:end], axis], middle - begin)]
        first[node] = len(low)
        for side in ((begin, middle), (middle, end)):
            stack.append((len(low), *side))
            low.append(np.zeros(3))
            high.append(np.zeros(3))
            first.append(0)
            count.append(0)
    return Tree(np.array(low), np.array(high), np.array(first), np.array(count), np.ascontiguousarray(corners[order]), order)


@njit(cache=True)
def _hit(low, high, first, count, corners, origin, direction, nearest, any_hit):
    """(distance, triangle in the tree's order) of the first hit before `nearest`; (nearest, -1) when there is none."""
    found = -1
    stack = np.empty(64, np.int64)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        t0, t1 = 0.0, nearest
        for a in range(3):
            if direction[a] == 0.0:
                if origin[a] < low[node, a] or origin[a] > high[node, a]:
                    t1 = -1.0
            else:
                x = (low[node, a] - origin[a]) / direction[a]
                y = (high[node, a] - origin[a]) / direction[a]
                t0, t1 = max(t0, min(x, y)), min(t1, max(x, y))
        if t0 > t1:
            continue
        if count[node] == 0:
            stack[top], stack[top + 1] = first[node], first[node] + 1
            top += 2
            continue
        for k in range(first[node], first[node] + count[node]):
            e1, e2, s = corners[k, 1] - corners[k, 0], corners[k, 2] - corners[k, 0], origin - corners[k, 0]
            p = np.cross(direction, e2)
            det = np.dot(e1, p)
            if det == 0.0:
                continue
            q = np.cross(s, e1)
            u, v, t = np.dot(s, p) / det, np.dot(direction, q) / det, np.dot(e2, q) / det
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and 0.0 < t < nearest:
                nearest, found = t, k
                if any_hit:
                    return nearest, found
    return nearest, found


@njit(cache=True, parallel=True)
def _closest(low, high, first, count, corners, origins, directions, distance, triangle):
    for i in prange(len(origins)):
        distance[i], triangle[i] = _hit(low, high, first, count, corners, origins[i], directions[i], np.inf, False)


@njit(cache=True, parallel=True)
def _unblocked(low, high, first, count, corners, origins, direction, seen):
    for i in prange(len(origins)):
        seen[i] = _hit(low, high, first, count, corners, origins[i], direction, np.inf, True)[1] < 0


@njit(cache=True, parallel=True)
def _each_unblocked(low, high, first, count, corners, origins, directions, seen):
    for i in prange(len(origins)):
        seen[i] = _hit(low, high, first, count, corners, origins[i], directions[i], np.inf, True)[1] < 0


def rays_leave(tree: Tree, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Whether each of the rays (n, 3) meets nothing, (n,) bool."""
    seen = np.zeros(len(origins), bool)
    _each_unblocked(*tree[:5], np.ascontiguousarray(origins, np.float64), np.ascontiguousarray(directions, np.float64), seen)
    return seen


def first_hits(scene: Scene, tree: Tree, width: int, height: int) -> Hits:
    """What rays through the pixel centres of a picture of the scene hit first."""
    view = view_from_world(scene.camera)
    tall = np.tan(np.radians(scene.camera.fov_y) / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * tall * width / height
    y = ((np.arange(height) + 0.5) / height * 2 - 1) * tall
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1).reshape(-1, 3) @ view[:3, :3]
    eye = np.array(scene.camera.position, np.float64)
    distance, found = np.empty(len(rays)), np.empty(len(rays), np.int64)
    _closest(*tree[:5], np.broadcast_to(eye, rays.shape).copy(), rays, distance, found)
    hit = found >= 0
    position = eye + rays * np.where(hit, distance, 1)[:, None]
    a, b, c = np.moveaxis(tree.corners[found], 1, 0)
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
    flat *= np.where(np.einsum("ij,ij->i", flat, rays) > 0, -1, 1)[:, None]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    edges = ((b, c), (c, a), (a, b))
    barycentric = np.stack([np.linalg.norm(np.cross(p - position, q - position), axis=-1) / area for p, q in edges], axis=-1)
    normals = np.concatenate([mesh.geometry.normals[mesh.geometry.triangles] for mesh in scene.meshes])[tree.order[found]]
    smooth = np.einsum("ij,ijk->ik", barycentric, normals)
    smooth /= np.linalg.norm(smooth, axis=-1, keepdims=True)
    smooth *= np.where(np.einsum("ij,ij->i", smooth, flat) < 0, -1, 1)[:, None]
    rows = (np.where(hit, tree.order[found], -1), position, smooth, flat)
    return Hits(*(row.reshape(height, width, *row.shape[1:]) for row in rows))


def visible(tree: Tree, hits: Hits, direction: np.ndarray, size: float) -> np.ndarray:
    """Whether a light from `direction` reaches each hit, (height, width) bool; rays start 10^-6 of the scene's `size` off the surface."""
    facing = (hits.flat_normal @ direction > 0) & (hits.smooth_normal @ direction > 0) & (hits.triangle >= 0)
    seen = np.zeros(hits.triangle.shape, bool)
    origins = (hits.position + hits.flat_normal * (1e-6 * size))[facing]
    result = np.zeros(len(origins), bool)
    if len(origins):
        _unblocked(*tree[:5], origins, np.asarray(direction, np.float64), result)
    seen[facing] = result
    return seen


def unshadowed(scene: Scene, hits: Hits, direction: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """Radiance (height, width, 3) that a light without shadows would give."""
    sizes = [len(mesh.geometry.triangles) for mesh in scene.meshes]
    mesh = np.repeat(np.arange(len(sizes)), sizes)[hits.triangle]
    view = np.array(scene.camera.position) - hits.position
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    cosine = np.maximum(hits.smooth_normal @ direction, 0)[..., None]
    brdf = np.zeros((*mesh.shape, 3))
    for k, made in enumerate(m.material for m in scene.meshes):
        here = mesh == k
        if isinstance(made, Ggx):
            brdf[here] = ggx(made, hits.smooth_normal[here], view[here], np.asarray(direction, np.float64))
        elif isinstance(made, Phong):
            mirrored = 2 * np.einsum("ij,ij->i", view[here], hits.smooth_normal[here])[:, None] * hits.smooth_normal[here] - view[here]
            lobe = np.maximum(mirrored @ direction, 0)[:, None] ** made.exponent
            brdf[here] = np.array(made.diffuse) / np.pi + np.array(made.specular) * (made.exponent + 2) / (2 * np.pi) * lobe
    return irradiance * cosine * brdf * (hits.triangle >= 0)[..., None]


def ggx(material: Ggx, normal: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """The BRDF (n, 3) of glTF 2.0, appendix B, for unit vectors normal and view (n, 3) and light (3,), written from the specification."""
    base, metallic, alpha = np.array(material.base_color), material.metallic, max(material.roughness, 0.05) ** 2
    half = view + light
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    nl, nv = np.maximum(normal @ light, 1e-4), np.maximum(np.einsum("ij,ij->i", normal, view), 1e-4)
    nh, vh = np.einsum("ij,ij->i", normal, half), np.einsum("ij,ij->i", view, half)
    microfacets = alpha**2 / (np.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
    # Smith's Lambda of either direction; masked and shadowed at correlated heights: G = 1 / (1 + Lambda + Lambda) (Heitz 2014)
    hidden = sum((np.sqrt(1 + alpha**2 * (1 - c**2) / c**2) - 1) / 2 for c in (nl, nv))
    both = 1 / (1 + hidden) / (4 * nl * nv)
    f0 = 0.04 * (1 - metallic) + base * metallic
    fresnel = f0 + (1 - f0) * (1 - vh[:, None]) ** 5
    return (1 - fresnel) * base * (1 - metallic) / np.pi + fresnel * (microfacets * both)[:, None]


def near_edges(seen: np.ndarray, pixels: int) -> np.ndarray:
    """Whether a pixel lies within `pixels` of one with the other value of `seen` (height, width)."""
    from scipy.ndimage import maximum_filter, minimum_filter

    window = 2 * pixels + 1
    return maximum_filter(seen, window) != minimum_filter(seen, window)
