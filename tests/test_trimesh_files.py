"""OBJ files and the files beside them: which are read, which are left out with a line, and which references are refused."""

import os

import numpy as np
import pytest
from PIL import Image

from vemlight.errors import UserError
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.trimesh_files import check_obj

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


@pytest.mark.parametrize(
    ("content", "refused"),
    [
        (b"v 0 0 0\n" * 9 + b"f 1 2 9\n", False),
        (b"v 0 0 0\n" * 9 + b"f 1 2 10\n", True),
        (b"v 0 0 0\n" * 9 + b"f 1/1 2/1 \\\n-10/1\n", True),
        (b"v 0 0 0\n" * 10 + b"f 1 2 99\n", False),  # found when it is read: arrays of 99 rows do no harm
        (b"v 0 0 0\n" * 3000 + b"".join(b"usemtl %d\n" % k for k in range(2048)), False),
        (b"v 0 0 0\n" * 3000 + b"".join(b"usemtl %d\n" % k for k in range(2049)), True),
        (b"v 0 0 0\n" * 4090 + b"".join(b"usemtl %d\n" % k for k in range(2048)), False),
        (b"v 0 0 0\n" * 4100 + b"".join(b"usemtl %d\n" % k for k in range(2048)), True),
        (b"v 0 0 0\n" * 3000 + b"usemtl a\n" * 3000, False),
    ],
)
def test_an_obj_that_asks_for_much_memory_is_refused_before_it_is_read(content, refused):
    if refused:
        with pytest.raises(ValueError, match="has "):
            check_obj(content)
    else:
        check_obj(content)
