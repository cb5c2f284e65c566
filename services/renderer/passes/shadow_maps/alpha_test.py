"""Meshes with holes, as shadow maps draw them: whole, since fewer triangles would shift the holes, and with their alpha."""

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.scene.materials import HASHED_ALPHA, AlphaTest, Texture, alpha_test_of
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.vertex_buffers import IndexRange

WHITE = Texture(np.ones((1, 1, 4), np.float16))


def hole_vertices(geometry: Geometry, holes: AlphaTest) -> np.ndarray:
    """Where in the image of a mesh's holes each vertex lies, and its alpha without the image: (n, 3) float32."""
    image = holes.image or WHITE
    uvs = geometry.uvs if image.uv_set == 0 or geometry.second_uvs is None else geometry.second_uvs
    uv_transform = np.eye(3)[:2] if image.uv_transform is None else image.uv_transform
    rows = np.empty((len(uvs), 3), np.float32)
    rows[:, :2] = uvs @ uv_transform[:, :2].T + uv_transform[:, 2]
    rows[:, 2] = holes.alpha * (1.0 if geometry.colours is None else geometry.colours[:, 3])
    return rows


class AlphaTestedMeshes:
    """The meshes of a scene that have holes, drawn with the part CUT of a vertex shader; nothing is made where there are none."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, vertex: str, **constants: str) -> None:
        self.program: moderngl.Program | None = None
        self._drawn: list[tuple[int, IndexRange, float, moderngl.Texture]] = []
        self._held: list[moderngl.VertexArray | moderngl.Buffer] = []
        self._textures: dict[tuple[object, ...], moderngl.Texture] = {}
        vertices, indices, first_vertex, first = [], [], 0, 0
        for k, mesh in enumerate(scene.meshes):
            if holes := alpha_test_of(mesh.material):
                geometry = mesh.geometry
                vertices.append(np.concatenate([geometry.positions, hole_vertices(geometry, holes)], axis=1))
                indices.append(geometry.triangles.reshape(-1) + np.uint32(first_vertex))
                cutoff = HASHED_ALPHA if holes.cutoff is None else holes.cutoff
                self._drawn.append((k, IndexRange(first, geometry.triangles.size), cutoff, self._alpha(context, holes.image or WHITE)))
                first_vertex, first = first_vertex + len(geometry.positions), first + geometry.triangles.size
        if self._drawn:
            buffers = context.buffer(np.concatenate(vertices).tobytes()), context.buffer(np.concatenate(indices).tobytes())
            self.program = programs.program(vertex, "shadow_alpha_test.frag", CUT="1", **constants)
            self._array = context.vertex_array(self.program, [(buffers[0], "3f 3f", "position", "hole")], buffers[1], index_element_size=4)
            self._held += [*buffers, self._array]

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
        for k, span, cutoff, texture in self._drawn if instances else ():
            assert self.program is not None
            texture.use(0)
            self.program["alpha_image"] = 0
            self.program["cutoff"] = cutoff
            self.program[name] = tuple((before @ matrices[k]).T.reshape(-1))
            self._array.render(vertices=span.count, first=span.first, instances=instances)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for thing in (*self._held, *self._textures.values()):
            thing.release()
