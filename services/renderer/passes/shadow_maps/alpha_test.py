"""Alpha-tested meshes as shadow maps draw them: unsimplified, since other triangles would shift the texture, and with their alpha."""

from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import ALPHA_TESTED_VERTEX
from vemlight.renderer.gl.constants import HASHED_ALPHA
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.scene.alpha_vertices import WHITE, alpha_vertices
from vemlight.renderer.scene.materials import AlphaTest, alpha_test_of
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.textures import Texture
from vemlight.renderer.scene.vertex_buffers import IndexRange


def alpha_tested_vertices(geometry: Geometry, alpha_test: AlphaTest) -> np.ndarray:
    """The mesh's vertices with where each lies in the texture, and its alpha without the texture: (n,) ALPHA_TESTED_VERTEX."""
    rows = np.empty(len(geometry.positions), ALPHA_TESTED_VERTEX.dtype)
    rows["position"] = geometry.positions
    rows["alpha_uv"], rows["vertex_alpha"] = alpha_vertices(geometry, alpha_test)
    return rows


class AlphaTestedItem(NamedTuple):
    """A mesh: its number in the scene, its indices, its cutoff (or HASHED_ALPHA), and the texture of its alpha."""

    mesh: int
    indices: IndexRange
    cutoff: float
    texture: moderngl.Texture


class AlphaTestedMeshes:
    """The alpha-tested meshes of a scene, drawn with the ALPHA_TEST variant of a vertex shader; nothing is made where there are none."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, vertex: str, **constants: str | int) -> None:
        self.program: moderngl.Program | None = None
        self._items: list[AlphaTestedItem] = []
        self._made: list[moderngl.VertexArray | moderngl.Buffer] = []
        self._textures: dict[tuple[object, ...], moderngl.Texture] = {}
        vertices, indices, first_vertex, first = [], [], 0, 0
        for k, mesh in enumerate(scene.meshes):
            if alpha_test := alpha_test_of(mesh.material):
                geometry = mesh.geometry
                vertices.append(alpha_tested_vertices(geometry, alpha_test))
                indices.append(geometry.triangles.reshape(-1) + np.uint32(first_vertex))
                cutoff = HASHED_ALPHA if alpha_test.cutoff is None else alpha_test.cutoff
                indices_of_mesh = IndexRange(first, geometry.triangles.size)
                self._items.append(AlphaTestedItem(k, indices_of_mesh, cutoff, self._alpha(context, alpha_test.image or WHITE)))
                first_vertex, first = first_vertex + len(geometry.positions), first + geometry.triangles.size
        if self._items:
            buffers = context.buffer(np.concatenate(vertices).tobytes()), context.buffer(np.concatenate(indices).tobytes())
            self.program = programs.program(vertex, "shadow_alpha_test.frag", ALPHA_TEST=1, **constants)
            content = [ALPHA_TESTED_VERTEX.content(buffers[0], self.program)]
            self._array = context.vertex_array(self.program, content, buffers[1], index_element_size=4)
            self._made += [*buffers, self._array]

    def _alpha(self, context: moderngl.Context, image: Texture) -> moderngl.Texture:
        """The fourth channel of an image on the GPU."""
        key = (id(image.texels), image.repeats, image.filters)
        if key not in self._textures:
            height, width, _ = image.texels.shape
            texture = context.texture((width, height), 1, image.texels[..., 3].tobytes(), alignment=1, dtype="f2")
            texture.build_mipmaps()
            texture.filter, (texture.repeat_x, texture.repeat_y) = image.filters, image.repeats
            self._textures[key] = texture
        return self._textures[key]

    def draw(self, name: str, before: np.ndarray, matrices: np.ndarray, instances: int) -> None:
        """Draws them `instances` times; `name` is the uniform that becomes `before` (4, 4) times each mesh's matrix of (n, 4, 4)."""
        for item in self._items if instances else ():
            assert self.program is not None
            item.texture.use(0)
            self.program["alpha_texture"] = 0
            self.program["alpha_cutoff"] = item.cutoff
            self.program[name] = tuple((before @ matrices[item.mesh]).T.reshape(-1))
            self._array.render(vertices=item.indices.count, first=item.indices.first, instances=instances)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (*self._made, *self._textures.values()):
            resource.release()
