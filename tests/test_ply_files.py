"""PLY and STL files: mixed faces, strips, colours, byte orders, what is cut off."""

import struct

import numpy as np
import pytest
from PIL import Image

from vemlight.errors import UserError
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.polygons import strip_triangles

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = [[0, 1, 2], [0, 1, 2, 3], [0, 2, 3]]


def area(file):
    total = 0.0
    for part in file.parts:
        a, b, c = np.moveaxis(part.geometry.positions[part.geometry.triangles].astype(float), 1, 0)
        total += np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2
    return total


def ply(folder, faces=FACES, order="<", vertex="", face="", more=b"", count="uchar", index="int"):
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = f"ply\nformat {form} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\n{vertex}"
    header += f"element face {len(faces)}\nproperty list {count} {index} vertex_indices\n{face}end_header\n"
    codes = {"uchar": "B", "int": "i", "ushort": "H", "uint": "I"}
    data = b"".join(struct.pack(f"{order}ffd", *corner) for corner in SQUARE)
    data += b"".join(struct.pack(f"{order}{codes[count]}{len(row)}{codes[index]}", len(row), *row) for row in faces)
    (folder / "a.ply").write_bytes(header.encode() + data + more)
    return folder / "a.ply"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("count", "index"), [("uchar", "int"), ("ushort", "uint"), ("int", "ushort"), ("uint", "uchar")])
@pytest.mark.parametrize("faces", [FACES, FACES[::-1], FACES[:1], [[0, 1, 2, 3]], [[], [0, 1, 2], [0, 1]]])
def test_binary_faces_of_several_sizes(tmp_path, order, count, index, faces):
    file = read_meshes(ply(tmp_path, faces, order, count=count, index=index), "here")
    assert area(file) == pytest.approx(sum({3: 0.5, 4: 1.0}.get(len(face), 0) for face in faces))
    few = sum(len(face) < 3 for face in faces)
    assert file.unsupported == ([f"a.ply: {few} of its faces have fewer than three corners and are left out"] if few else [])


def test_bytes_behind_the_faces_are_passed_over(tmp_path):
    assert area(read_meshes(ply(tmp_path, more=b"more"), "here")) == pytest.approx(2)


@pytest.mark.parametrize("faces", [FACES, FACES[:1] * 3])
def test_a_binary_ply_that_is_cut_off_is_refused(tmp_path, faces):
    path = ply(tmp_path, faces)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(UserError, match="cut off"):
        read_meshes(path, "here")


def text_ply(folder, elements, numbers):
    (folder / "a.ply").write_text(f"ply\nformat ascii 1.0\n{elements}end_header\n{numbers}")
    return read_meshes(folder / "a.ply", "here")


VERTICES = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
CORNERS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
FACE = "element face 2\nproperty list uchar int vertex_index\n"


def test_strips_of_a_ply(tmp_path):
    strips = "element tristrips 1\nproperty list int int vertex_indices\n"
    assert area(text_ply(tmp_path, VERTICES + strips, CORNERS + "8 0 1 3 2 -1 0 1 2\n")) == pytest.approx(1.5)


def test_a_strip_turns_every_other_triangle_round():
    assert strip_triangles(np.array([0, 1, 2, 3, -1, 4, 5, 6, 7])).tolist() == [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]]
    assert len(strip_triangles(np.array([0, 1]))) == 0


@pytest.mark.parametrize("kind", ["uchar", "float"])
def test_colours_of_faces_and_vertices(tmp_path, kind):
    colours = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    one, half = ("255", "128") if kind == "uchar" else ("1", "0.50196")
    of_faces = text_ply(tmp_path, VERTICES + FACE + colours, CORNERS + f"3 0 1 2 {one} {half} 0\n3 0 2 3 0 {one} 0\n").parts[0].geometry
    assert of_faces.colours is not None
    assert of_faces.colours[of_faces.triangles[0]] == pytest.approx(np.tile([1, 0.2158, 0, 1], (3, 1)), abs=1e-3)
    assert of_faces.colours[of_faces.triangles[1]] == pytest.approx(np.tile([0, 1, 0, 1], (3, 1)))
    corners = "".join(f"{line} {one} {half} 0\n" for line in CORNERS.splitlines())
    of_vertices = text_ply(tmp_path, VERTICES + colours + FACE, corners + "3 0 1 2\n3 0 2 3\n").parts[0].geometry
    assert of_vertices.colours == pytest.approx(np.tile([1, 0.2158, 0, 1], (4, 1)), abs=1e-3)


def test_images_of_faces(tmp_path):
    for name, colour in (("a.png", (255, 0, 0)), ("b c.png", (0, 255, 0))):
        Image.new("RGB", (2, 2), colour).save(tmp_path / name)
    elements = "comment TextureFile a.png\ncomment TextureFile b c.png\n" + VERTICES + FACE
    elements += "property list uchar float texcoord\nproperty int texnumber\n"
    file = text_ply(tmp_path, elements, CORNERS + "3 0 1 2 6 0 0 1 0 1 1 0\n3 0 2 3 6 0 0 1 1 0 1 1\n")
    texels = [part.material.colour_map.texels for part in file.parts]  # type: ignore[union-attr]
    assert [texel[0, 0].tolist() for texel in texels] == [[1, 0, 0], [0, 1, 0]]
    assert file.parts[0].geometry.uvs[file.parts[0].geometry.triangles[0]].tolist() == [[0, 0], [1, 0], [1, 1]]


@pytest.mark.parametrize(
    ("numbers", "said"),
    [("3 0 1 2\n3 0 1 9\n", "vertices that it does not have"),
     ("3 0 1 2\n3 0 1\n", "cut off"), ("3 0 1 2\n", "cut off"), ("3 0 1 2\nx", "x")],
)
def test_a_text_ply_that_contradicts_itself_is_refused(tmp_path, numbers, said):
    with pytest.raises(UserError, match=said):
        text_ply(tmp_path, VERTICES + FACE, CORNERS + numbers)


ONE = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


@pytest.mark.parametrize(
    "content",
    [
        b"solid".ljust(80) + struct.pack("<I", 2) + ONE * 2,
        bytes(80) + struct.pack("<I", 2) + ONE * 2 + b"\0trail\xff",
        f"solid my facet vertex part\n{FACET * 2}endsolid my facet vertex part\n".encode(),
        f"  SOLID a\r\n{FACET.upper()}{FACET}ENDSOLID".replace("\n", "\r\n").encode(),
        f"solid a\n{FACET}endsolid a\nsolid b\n{FACET}endsolid b".replace("\n", "\r").encode(),
        f"solid {FACET * 2}endsolid".replace("\n", " ").encode(),
    ],
)
def test_ways_to_write_an_stl(tmp_path, content):
    (tmp_path / "a.stl").write_bytes(content)
    file = read_meshes(tmp_path / "a.stl", "here")
    assert len(file.parts[0].geometry.triangles) == 2
    assert file.unsupported == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (bytes(80) + struct.pack("<I", 3) + ONE * 2, "counts 3 triangles: it was cut off"),
        (f"solid a\n{FACET}facet normal 0 0 1\nouter loop\nvertex 0 0".encode(), "2 facets and 3 vertices"),
        (b"no mesh", "is no STL"),
    ],
)
def test_an_stl_that_is_cut_off_is_refused(tmp_path, content, said):
    (tmp_path / "a.stl").write_bytes(content)
    with pytest.raises(UserError, match=said):
        read_meshes(tmp_path / "a.stl", "here")


def test_an_stl_without_its_last_line_is_said(tmp_path):
    (tmp_path / "a.stl").write_text(f"solid a\n{FACET}")
    assert read_meshes(tmp_path / "a.stl", "here").unsupported == ["a.stl: it ends without endsolid: it may be cut off"]
