import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals

from vemlight.errors import UserError
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.meshes import VertexAttributes, clean_geometry, shape_geometry
from vemlight.renderer.scene.textures import Texture


def face_normals(geometry) -> np.ndarray:
    a, b, c = np.moveaxis(geometry.positions[geometry.triangles].astype(float), 1, 0)
    n = np.cross(b - a, c - a)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def test_a_box_is_flat_and_closed():
    box = shape_geometry("box")
    assert box.closed
    assert box.positions.min() == -1
    assert box.positions.max() == 1
    assert np.abs(box.normals[box.triangles] - face_normals(box)[:, None]).max() < 1e-6


def test_a_sphere_is_smooth_round_and_closed():
    ball = shape_geometry("sphere")
    assert ball.closed
    assert np.abs(np.linalg.norm(ball.positions, axis=1) - 1).max() < 1e-6
    assert np.abs(ball.normals - ball.positions).max() < 1e-6
    assert np.einsum("ij,ij->i", face_normals(ball), ball.positions[ball.triangles].mean(axis=1)).min() > 0.99


def test_a_plane_faces_up_and_is_open():
    plane = shape_geometry("plane")
    assert not plane.closed
    assert np.all(plane.normals == [0, 0, 1])
    assert np.ptp(plane.positions, axis=0).tolist() == [2, 2, 0]


def test_normals_are_computed_smooth_where_round_and_sharp_at_edges():
    tube = trimesh.creation.cylinder(radius=1, height=2, sections=32)
    geometry = clean_geometry(VertexAttributes(np.asarray(tube.vertices)), np.asarray(tube.faces))
    corner = geometry.normals[geometry.triangles].reshape(-1, 3)
    place = geometry.positions[geometry.triangles].reshape(-1, 3)
    side = np.abs(np.repeat(face_normals(geometry), 3, axis=0)[:, 2]) < 0.5
    radial = place[side] * [1, 1, 0] / np.linalg.norm(place[side][:, :2], axis=-1, keepdims=True)
    assert np.abs(corner[side] - radial).max() < 1e-3
    assert np.abs(np.abs(corner[~side][:, 2]) - 1).max() < 1e-6


def _tube(sections: int) -> tuple[np.ndarray, np.ndarray]:
    """A tube about z of radius 1 without ends, in `sections` facets."""
    phi = np.arange(sections) * 2 * np.pi / sections
    ring = np.stack([np.cos(phi), np.sin(phi), np.zeros(sections)], axis=-1)
    k, after = np.arange(sections), (np.arange(sections) + 1) % sections
    faces = [np.stack([k, after, after + sections], axis=-1), np.stack([k, after + sections, k + sections], axis=-1)]
    return np.concatenate([ring, ring + np.array([0, 0, 1])]), np.concatenate(faces)


@pytest.mark.parametrize(("sections", "is_round"), [(12, True), (10, True), (8, False), (6, False)])  # 30, 36, 45 and 60 degrees
def test_coarse_round_forms_are_smooth_and_chamfers_sharp(sections, is_round):
    positions, triangles = _tube(sections)
    geometry = clean_geometry(VertexAttributes(positions), triangles)
    assert len(geometry.positions) == (2 if is_round else 4) * sections


def test_an_unwelded_file_is_as_smooth_as_a_welded_one():
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners = np.asarray(ball.vertices)[np.asarray(ball.faces)].reshape(-1, 3)
    geometry = clean_geometry(VertexAttributes(corners), np.arange(len(corners)).reshape(-1, 3))
    assert len(geometry.positions) == len(ball.vertices)
    assert geometry.closed
    # the angle-weighted mean of facets 8 degrees wide departs from the true normal by a small part of a facet
    assert np.einsum("ij,ij->i", geometry.normals, geometry.positions).min() > np.cos(np.radians(1))


def test_inside_out_and_open_meshes_are_not_closed():
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    assert clean_geometry(VertexAttributes(vertices), faces).closed
    assert not clean_geometry(VertexAttributes(vertices), faces[:, ::-1]).closed
    assert not clean_geometry(VertexAttributes(vertices), faces[1:]).closed
    both = np.concatenate([faces, faces[:, ::-1] + len(vertices)])
    assert not clean_geometry(VertexAttributes(np.concatenate([vertices, vertices * 0.5 + 5])), both).closed


def test_normals_of_the_file_are_kept_and_bad_ones_replaced(tmp_path):
    plane = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    (tmp_path / "good.obj").write_text(plane + "vn 0.6 0 0.8\nf 1//1 2//1 3//1\n")
    (good,) = read_meshes(tmp_path / "good.obj", "here").parts
    assert np.abs(good.geometry.normals - [0.6, 0, 0.8]).max() < 1e-6
    bad = clean_geometry(VertexAttributes(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.zeros((3, 3))), np.array([[0, 1, 2]]))
    assert np.abs(bad.normals - [0, 0, 1]).max() < 1e-6


def test_triangles_without_area_are_left_out():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0.0]])
    geometry = clean_geometry(VertexAttributes(positions), np.array([[0, 1, 2], [0, 1, 3], [1, 1, 2]]))
    assert len(geometry.triangles) == 1


def test_indices_out_of_range_are_refused():
    with pytest.raises(ValueError, match="does not have"):
        clean_geometry(VertexAttributes(np.eye(3)), np.array([[0, 1, 3]]))


def test_moving_keeps_normals_of_unit_length():
    moved = shape_geometry("sphere").moved(3 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([1, 2, 3]))
    assert np.abs(np.linalg.norm(moved.normals, axis=1) - 1).max() < 1e-6
    assert np.abs((moved.positions - [1, 2, 3]) / 3 - moved.normals).max() < 1e-6


def test_a_ply_without_normals_gets_its_own(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=3)
    (tmp_path / "ball.ply").write_bytes(sphere.export(file_type="ply", vertex_normal=False))
    (part,) = read_meshes(tmp_path / "ball.ply", "here").parts
    outwards = part.geometry.positions / np.linalg.norm(part.geometry.positions, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", part.geometry.normals, outwards).min() > 0.999
    assert part.geometry.closed


def test_a_huge_texture_is_made_smaller(tmp_path):
    plane = trimesh.creation.box()
    image = Image.fromarray(np.tile(np.array([[[200, 30, 30]]], np.uint8), (16, 5000, 1)))
    plane.visual = TextureVisuals(uv=np.zeros((len(plane.vertices), 2)), image=image)
    plane.export(tmp_path / "box.glb")
    (part,) = read_meshes(tmp_path / "box.glb", "here").parts
    assert part.material is not None
    (image,) = [value for value in part.material if isinstance(value, Texture)]
    assert image.texels.shape == (13, 4096, 3)


@pytest.mark.parametrize(
    "text",
    [
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
        "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 0\nproperty list uchar int vertex_indices\nend_header\n",
    ],
)
def test_points_alone_and_nothing_at_all_are_one_line(tmp_path, text):
    (tmp_path / "mesh.ply").write_text(text)
    with pytest.raises(UserError, match=r"^here: .*mesh\.ply") as caught:
        read_meshes(tmp_path / "mesh.ply", "here")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_a_comment_in_latin_1_is_no_obstacle(tmp_path, suffix):
    text = str(trimesh.creation.box().export(file_type="obj" if suffix == "obj" else "stl_ascii"))
    words = "# K\u00f6rper\n" + text if suffix == "obj" else text.replace("solid", "solid K\u00f6rper", 1)
    (tmp_path / f"mesh.{suffix}").write_bytes(words.encode("latin-1"))
    (part,) = read_meshes(tmp_path / f"mesh.{suffix}", "here").parts
    assert part.geometry.closed
    assert len(part.geometry.triangles) == 12


def test_a_triangle_of_rounding_errors_has_no_area():
    """Corners on one line but for 1e-15 of the mesh's size, which float64 makes of any three points of a line."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 1e-15, 0]])
    geometry = clean_geometry(VertexAttributes(positions), np.array([[0, 1, 2], [0, 1, 3]], np.uint32))
    assert len(geometry.triangles) == 1
