"""OBJ files and the files beside them: which are read, which are left out with a line, and which references are refused."""

import os

import numpy as np
import pytest
from PIL import Image

from vemlight.errors import UserError
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.mesh_files import read_meshes

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACE = "usemtl paint\nf 1/1 2/2 3/3\n"


def obj(folder, library="a.mtl", image="a.png"):
    (folder / "a.mtl").write_text(f"newmtl paint\nKd 0.5 0.5 0.5\nmap_Kd {image}\n")
    (folder / "a.obj").write_text(f"mtllib {library}\n{CORNERS}{FACE}")
    return folder / "a.obj"


def test_the_image_of_a_material_is_read(tmp_path):
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)).save(tmp_path / "a.png")
    file = read_meshes(obj(tmp_path), "here")
    material = file.parts[0].material
    assert isinstance(material, Phong)
    assert material.colour_map is not None
    assert file.unsupported == []


def test_a_byte_order_mark_is_passed_over(tmp_path):
    """It would make the first vertex, and the first material, no words that OBJ knows."""
    path = obj(tmp_path)
    plain = read_meshes(path, "here").parts[0]
    path.write_bytes(b"\xef\xbb\xbf" + f"{CORNERS}mtllib a.mtl\n{FACE}".encode())
    (tmp_path / "a.mtl").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "a.mtl").read_bytes())
    marked = read_meshes(path, "here").parts[0]
    assert marked.geometry.positions.tolist() == plain.geometry.positions.tolist()
    assert isinstance(marked.material, Phong)
    assert isinstance(plain.material, Phong)
    assert marked.material.diffuse == plain.material.diffuse


def outside(folder):
    (folder / "link").symlink_to("/etc/passwd")
    return "link"


@pytest.mark.parametrize("key", ["library", "image"])
@pytest.mark.parametrize("name", ["/dev/zero", "../a.png", "http://host/a.png", "file:///etc/passwd", outside])
def test_a_reference_out_of_the_folder_is_refused(tmp_path, key, name):
    name = str(name(tmp_path)) if callable(name) else name
    with pytest.raises(UserError, match=rf"^here: .*a\.obj: {name} (leads|is an|is a link) .*; put the file") as caught:
        read_meshes(obj(tmp_path, **{key: name}), "here")
    assert len(str(caught.value).splitlines()) == 1


def test_a_pipe_beside_it_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match=r"pipe: is not a regular file"):
        read_meshes(obj(tmp_path, image="pipe"), "here")


@pytest.mark.parametrize(("key", "name"), [("library", "b.mtl"), ("image", "b.png")])
def test_what_is_not_there_is_left_out_with_a_line(tmp_path, key, name):
    file = read_meshes(obj(tmp_path, **{key: name}), "here")
    assert file.unsupported == [f"a.obj: {name} is left out: there is no such file beside it"]


def test_an_image_that_is_none_is_left_out_with_a_line(tmp_path):
    (tmp_path / "a.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n")
    (line,) = read_meshes(obj(tmp_path), "here").unsupported
    assert line.startswith("a.obj: a.png is left out: ")


def test_texture_coordinates_that_are_nan_are_left_out_with_a_line(tmp_path, capfd):
    (tmp_path / "a.obj").write_text(CORNERS.replace("vt 1 0", "vt nan 0") + "f 1/1 2/2 3/3\n")
    file = read_meshes(tmp_path / "a.obj", "here")
    assert file.unsupported == ["a.obj: its texture coordinates are left out: some are nan or inf"]
    assert not file.parts[0].geometry.uvs.any()
    assert capfd.readouterr().err == ""


def area(path):
    file = read_meshes(path, "here")
    return sum(area_of(part.geometry) for part in file.parts)


def area_of(geometry):
    a, b, c = np.moveaxis(geometry.positions[geometry.triangles].astype(float), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2


TWO_TRIANGLES = [
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nv 0 0 5\nv 2 0 5\nv 0 2 5\nf 4 5 6\n",
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 2 0 5\nv 0 2 5\nf -3 -2 -1\n",
    "v\t0\t0 0\r\nv  1 0 0 \r\n  v 0 1 0\r\nf\t1 2\t3\r\nv 0 0 5\r\nv 2 0 5 # far\r\nv 0 2 5\r\nf 4 5 6 # last",
    "v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3\rv 0 0 5\rv 2 0 5\rv 0 2 5\rf 4 \\\n5 6",
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf -3/-1/-1 -2/-1/-1 -1/-1/-1\nv 0 0 5\nv 2 0 5\nv 0 2 5\nvt 1 1\nf -3/-1 -2/-2 -1/-1\n",
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\nv 0 0 5\nv 2 0 5\nv 0 2 5\nf 4 5 6\nl 1 2\np 1\n",
    "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\nv 0 0 5 0 1 0\nv 2 0 5 0 1 0\nv 0 2 5 0 1 0\nf 4 5 6 \nf 1 2\n",
]


@pytest.mark.parametrize("text", TWO_TRIANGLES)
def test_ways_to_write_two_triangles(tmp_path, text):
    (tmp_path / "a.obj").write_text(text, newline="")
    (part,) = read_meshes(tmp_path / "a.obj", "here").parts
    assert len(part.geometry.triangles) == 2
    assert area_of(part.geometry) == pytest.approx(2.5)
    assert np.unique(part.geometry.positions[:, 2]).tolist() == [0, 5]


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ("0 0,2 0,2 1,1 1,1 2,0 2", 3),  # an L, from each of its corners
        ("0 0,3 0,3 3,2 3,2 1,1 1,1 3,0 3", 7),
        ("0 0,2 1,0 2,1 1", 1),  # a dart
        ("0 0,4 0,4 4,0 4,0 0,1 1,1 3,3 3,3 1,1 1", 12),  # a frame, its hole joined to its rim by an edge gone both ways
        ("0 0,1 0,2 0,2 2,1 2,0 2", 4),  # corners on straight edges
    ],
)
def test_concave_faces_are_not_cut_as_fans(tmp_path, corners, expected):
    points = corners.split(",")
    for shift in range(len(points)):
        for turned in (False, True):
            moved = (points[shift:] + points[:shift])[:: -1 if turned else 1]
            text = "".join(f"v {point} {2 * float(point.split()[0])}\n" for point in moved)  # in a plane that leans
            (tmp_path / "a.obj").write_text(text + "f " + " ".join(str(k + 1) for k in range(len(moved))))
            assert area(tmp_path / "a.obj") == pytest.approx(expected * np.sqrt(5))


def test_a_face_that_crosses_itself_is_said(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n")
    assert read_meshes(tmp_path / "a.obj", "here").unsupported == ["a.obj: 1 of its faces cross their own edges and may be drawn too large"]


def test_a_star_drawn_in_one_stroke_crosses_itself(tmp_path):
    angles = np.arange(5) * 0.8 * np.pi
    text = "".join(f"v {np.cos(angle)} {np.sin(angle)} 0\n" for angle in angles)
    (tmp_path / "a.obj").write_text(text + "f 1 2 3 4 5\n")
    assert "cross their own edges" in read_meshes(tmp_path / "a.obj", "here").unsupported[0]
    radii = np.where(np.arange(10) % 2, 0.382, 1.0)  # and its outline does not
    points = radii[:, None] * np.stack([np.cos(np.arange(10) * np.pi / 5), np.sin(np.arange(10) * np.pi / 5)], axis=-1)
    (tmp_path / "a.obj").write_text("".join(f"v {x} {y} 0\n" for x, y in points) + "f 1 2 3 4 5 6 7 8 9 10\n")
    file = read_meshes(tmp_path / "a.obj", "here")
    assert file.unsupported == []
    assert area_of(file.parts[0].geometry) == pytest.approx(5 * 0.382 * np.sin(np.pi / 5), rel=1e-6)


@pytest.mark.parametrize(
    ("faces", "said"),
    [
        ("f 1 2 9", "vertices that it does not have"), ("f 0 1 2", "vertices that it does not have"),
        ("f -4 1 2", "vertices that it does not have"),
        ("f 1 2 3/x", "corner 3/x"), ("f 1 2 1/2/3/4", "corner 1/2/3/4"), ("f 1.5 2 3", "corner 1.5"),
    ],
)  # fmt: skip
def test_faces_that_cannot_be_are_refused(tmp_path, faces, said):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{faces}\n")
    with pytest.raises(UserError, match=said):
        read_meshes(tmp_path / "a.obj", "here")


@pytest.mark.parametrize("face", ["f 1/1 2/2 3/9", "f 1//1 2//2 3//9"])
def test_coordinates_and_normals_that_are_not_there_are_left_out_with_a_line(tmp_path, face):
    (tmp_path / "a.obj").write_text(CORNERS + "vn 0 0 1\n" * 3 + face)
    file = read_meshes(tmp_path / "a.obj", "here")
    assert "are left out: some faces name others than it has" in file.unsupported[0]
    assert not file.parts[0].geometry.uvs.any()


def materials(folder, library, faces="usemtl paint\nf 1/1 2/2 3/3\n", image="a.png"):
    Image.new("RGB", (2, 2), (255, 0, 0)).save(folder / image)
    (folder / "a.mtl").write_text(library)
    (folder / "a.obj").write_text(f"mtllib a.mtl\n{CORNERS}{faces}")
    return read_meshes(folder / "a.obj", "here")


def test_an_image_is_multiplied_by_the_colour(tmp_path):
    (part,) = materials(tmp_path, "newmtl paint\nKd 1 0.5 0\nmap_Kd a.png\n").parts
    assert isinstance(part.material, Phong)
    assert part.material.diffuse == pytest.approx((1, 0.2140, 0), abs=1e-4)
    assert part.material.colour_map is not None


def test_options_of_an_image(tmp_path):
    library = "newmtl paint\nmap_Kd -blendu on -s 2 3 1 -o 0.5 -clamp on -mm 0 2 my picture.png\n"
    file = materials(tmp_path, library, image="my picture.png")
    material = file.parts[0].material
    assert isinstance(material, Phong)
    texture = material.colour_map
    assert texture is not None
    assert texture.uv_transform is not None
    assert texture.uv_transform.tolist() == [[2, 0, 0.5], [0, 3, 0]]
    assert texture.repeats == (False, False)
    assert file.unsupported == ["a.obj: material paint: option -mm of its image is left out"]


def test_an_image_named_by_windows_is_found(tmp_path):
    (tmp_path / "tex").mkdir()
    Image.new("RGB", (2, 2)).save(tmp_path / "tex" / "b.png")
    file = materials(tmp_path, "newmtl paint\nmap_Kd tex\\b.png\n")
    material = file.parts[0].material
    assert isinstance(material, Phong)
    assert material.colour_map is not None
    assert file.unsupported == []


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("map_Kd A.PNG", "A.PNG is left out: there is a.png beside it, of another case"), ("map_Kd C:\\x\\b.png", "there is no such file"),
        ("Kd spectral a.rfl", "three numbers are read"), ("d 0.5", "its d is not drawn"), ("Tr 0.5", "its Tr is not drawn"),
        ("map_d a.png", "its map_d is not drawn"), ("Ke 1 0 0", "its Ke is not drawn"), ("Kd 0 0 0\nmap_Kd a.png", "makes its image black"),
    ],
)  # fmt: skip
def test_what_a_library_asks_for_in_vain_is_said(tmp_path, statement, said):
    (line,) = materials(tmp_path, f"newmtl paint\n{statement}\n").unsupported
    assert said in line


def test_a_material_that_no_library_has_is_said(tmp_path):
    file = materials(tmp_path, "newmtl paint\nKd 1 0 0\nd 1\nTr 0\nKe 0 0 0\n", "usemtl paint\nf 1 2 3\nusemtl other\nf 1 3 2\n")
    assert [part.material for part in file.parts] == [Phong((1.0, 0.0, 0.0)), None]
    assert file.unsupported == ["a.obj: material other is left out: no library has it"]


def test_meshes_have_the_vertices_of_their_own_faces(tmp_path):
    few = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    (tmp_path / "a.obj").write_text(few + "usemtl a\nf 1 2 3\nusemtl b\nf 2 3 4\nusemtl a\nf 1 2 4\n")
    assert [len(part.geometry.triangles) for part in read_meshes(tmp_path / "a.obj", "here").parts] == [2, 1]


@pytest.mark.parametrize(("materials", "refused"), [(4096, False), (4097, True)])
def test_an_obj_has_up_to_4096_materials(tmp_path, materials, refused):
    faces = "".join(f"usemtl {k}\nf 1 2 3\n" for k in range(materials))
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + faces)
    if refused:
        with pytest.raises(UserError, match="4097 materials"):
            read_meshes(tmp_path / "a.obj", "here")
    else:
        assert len(read_meshes(tmp_path / "a.obj", "here").parts) == materials
