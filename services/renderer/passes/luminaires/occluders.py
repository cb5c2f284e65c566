"""What casts shadows in the light of luminaires: the scene's triangles on the GPU, and as a hierarchy for traced rays."""

from typing import TYPE_CHECKING, NamedTuple

import moderngl
import numpy as np

from vemlight.renderer.scene.materials import alpha_test_of
from vemlight.renderer.scene.meshes import box_corners
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose
from vemlight.renderer.scene.subdivision import seen_short
from vemlight.renderer.scene.vertex_buffers import IndexRange

if TYPE_CHECKING:
    from vemlight.renderer.luminaire.bvh import TriangleHierarchy


class SceneOccluders(NamedTuple):
    """positions: (n, 3) float32 a vertex, at rest. mesh_ranges: the indices of each mesh, empty for alpha-tested ones.

    corners: (m, 8, 3), of the boxes about the meshes, at rest. pose: where the meshes are. triangles: in the world, for traced shadows;
    None where no luminaire asks for them.
    """

    positions: moderngl.Buffer
    indices: moderngl.Buffer
    mesh_ranges: tuple[IndexRange, ...]
    corners: np.ndarray
    pose: ScenePose
    triangles: "TriangleHierarchy | None"

    def corners_in(self, pose: ScenePose) -> np.ndarray:
        """Those of the boxes (m, 8, 3) in the world, where the meshes stand so."""
        return np.einsum("mij,mkj->mki", pose.matrices[:, :3, :3], self.corners) + pose.matrices[:, None, :3, 3]


def scene_occluders(context: moderngl.Context, scene: Scene, pose: ScenePose) -> SceneOccluders:
    """The occluders of a scene in a pose."""
    meshes = seen_short((mesh.geometry for mesh in scene.meshes), scene.camera)
    first_vertices = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])[:-1]
    indices = np.concatenate([mesh.triangles.reshape(-1) + np.uint32(first) for mesh, first in zip(meshes, first_vertices, strict=True)])
    positions = np.concatenate([mesh.positions for mesh in meshes]).astype(np.float32)
    first_indices = np.cumsum([0, *(mesh.triangles.size for mesh in meshes)]).tolist()[:-1]
    opaque = [alpha_test_of(mesh.material) is None for mesh in scene.meshes]  # AlphaTestedMeshes draws the others
    counts = (mesh.triangles.size * drawn for mesh, drawn in zip(meshes, opaque, strict=True))
    mesh_ranges = tuple(IndexRange(first, count) for first, count in zip(first_indices, counts, strict=True))
    buffers = context.buffer(positions.tobytes()), context.buffer(indices.astype(np.uint32).tobytes())
    corners = np.stack([box_corners(mesh) for mesh in meshes])
    return SceneOccluders(*buffers, mesh_ranges, corners, pose, traced_triangles(scene, pose))


def traced_triangles(scene: Scene, pose: ScenePose) -> "TriangleHierarchy | None":
    """The scene's triangles in the world; None where no luminaire traces its shadows."""
    if all(luminaire.table.shadows != "traced" for luminaire in scene.luminaires):
        return None
    from vemlight.renderer.luminaire.bvh import hierarchy_from_triangles  # here, since most scenes do without its kernels

    corners = [
        (mesh.geometry.positions @ matrix[:3, :3].T + matrix[:3, 3])[mesh.geometry.triangles]
        for mesh, matrix in zip(scene.meshes, pose.matrices, strict=True)
    ]
    return hierarchy_from_triangles(np.concatenate(corners))
