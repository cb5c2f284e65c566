"""Where the vertices of an alpha-tested mesh lie in the texture of its alpha, for shadow maps and shadow rays alike."""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.scene.materials import AlphaTest
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.textures import Texture

WHITE = Texture(np.ones((1, 1, 4), np.float16))


class AlphaVertices(NamedTuple):
    """uvs: (n, 2) float32, where each vertex lies in the texture. alphas: (n,) float32, without the texture's."""

    uvs: np.ndarray
    alphas: np.ndarray


def alpha_vertices(geometry: Geometry, alpha_test: AlphaTest) -> AlphaVertices:
    """The mesh's vertices as its alpha test sees them."""
    image = alpha_test.image or WHITE
    uvs = geometry.uvs if image.uv_set == 0 or geometry.second_uvs is None else geometry.second_uvs
    uv_transform = np.eye(3)[:2] if image.uv_transform is None else image.uv_transform
    alphas = alpha_test.alpha * (np.ones(len(uvs)) if geometry.colours is None else geometry.colours[:, 3])
    return AlphaVertices((uvs @ uv_transform[:, :2].T + uv_transform[:, 2]).astype(np.float32), alphas.astype(np.float32))
