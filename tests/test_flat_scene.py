"""The scene for browsers: all of it is there, and nothing is believed that does not fit."""

import json
import re
from typing import Any

import msgspec
import numpy as np
import pytest

from vemlight.renderer.browser.es_shaders import BROWSER_SHADERS, browser_shaders
from vemlight.renderer.browser.flatten import flattened, scene_message
from vemlight.renderer.scene.materials import Ggx
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import BUNDLED_SCENE, load_scene
from vemlight.renderer.scene.subdivision import with_short_edges
from vemlight.runtime import flat_scene, wire
from vemlight.settings import Renderer
from vemlight.viewer.scene_files import scene_files

DRAWING = Renderer(width=64, height=48, shadow_map=64)

TEXTURE = {"texels": {"offset": 0, "count": 4, "type": "uint8"}, "width": 1, "height": 1, "srgb": False, "repeats": [True, True]}


@pytest.fixture(scope="module")
def message() -> wire.Message:
    return scene_message(load_scene(BUNDLED_SCENE.parent / "headlights.toml"), DRAWING)


def changed(message: wire.Message, change) -> bytes:
    """The description after a change of its JSON."""
    described: dict[str, Any] = json.loads(message[1][0].tobytes())
    change(described)
    return json.dumps(described).encode()


def test_the_description_has_all_that_the_renderer_draws(message):
    header, (description, data) = message
    assert isinstance(header, wire.SceneMessage)
    scene = flat_scene.decoded(description.tobytes(), header.data_bytes)
    drawn = load_scene(BUNDLED_SCENE.parent / "headlights.toml")
    assert [mesh.name for mesh in scene.meshes] == [mesh.name for mesh in drawn.meshes]
    assert {pose.name for pose in scene.objects} == {pose.name for pose in drawn.objects}
    assert scene.camera.view.eye == tuple(drawn.camera.position)
    assert set(scene.shaders) == set(BROWSER_SHADERS)
    assert "the scene's lamps" in scene.left_out
    triangles = sum(len(mesh.geometry.triangles) for mesh in drawn.meshes)
    assert scene.arrays["indices"].count >= 3 * triangles
    assert len(data) == header.data_bytes
    assert wire.unpack(wire.pack(*message))[0] == header


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: scene["arrays"]["positions"].update(offset=scene["arrays"]["positions"]["offset"] + 2**20),
        lambda scene: scene["arrays"]["positions"].update(offset=2),
        lambda scene: scene["arrays"]["normals"].update(count=3),
        lambda scene: scene["arrays"]["indices"].update(type="float32"),
        lambda scene: scene["arrays"].pop("uvs"),
        lambda scene: scene["arrays"].update(more=scene["arrays"]["uvs"]),
        lambda scene: scene["arrays"]["reflecting"].update(count=60),
        lambda scene: scene["arrays"]["reflecting_texels"].update(count=2**24),
        lambda scene: scene["arrays"]["surfels"].update(count=24),
        lambda scene: scene["arrays"]["surfels"].update(count=16 * 5000),
        lambda scene: scene["arrays"]["vertex_surfels"].update(count=4),
        lambda scene: scene["arrays"].pop("surfel_weights"),
        lambda scene: scene["meshes"][0].update(back=2**16),
        lambda scene: scene["meshes"][0]["indices"].update(count=2**24),
        lambda scene: scene["meshes"][0]["vertices"].update(first=2**24),
        lambda scene: scene["meshes"][0].update(material=99),
        lambda scene: scene["meshes"][0].update(object=99),
        lambda scene: scene["materials"][0].update(textures=[5, None, None, None]),
        lambda scene: scene["materials"][0].update(cutoff=1e400),
        lambda scene: scene["casters"]["members"][0].update(mesh=99),
        lambda scene: scene["casters"]["members"][0].update(details=[]),
        lambda scene: scene["casters"]["members"][0]["details"][0]["indices"].update(count=2**24),
        lambda scene: scene["camera"]["view"].update(at=scene["camera"]["view"]["from"]),
        lambda scene: scene["shaders"].update(long="x" * 70_000),
        lambda scene: scene.update(textures=[TEXTURE | {"filters": [9729, 9987]}]),
        lambda scene: scene["laws"].update(MAP_HALVINGS=1e9),
        lambda scene: scene.update(version=2),
        lambda scene: scene.update(surprise=1),
        lambda scene: scene.update(meshes=scene["meshes"] * 2000),
    ],
)
def test_descriptions_that_do_not_fit_are_refused(message, change):
    header, (_, data) = message
    assert isinstance(header, wire.SceneMessage)
    description = changed(message, change)
    with pytest.raises(ValueError):
        flat_scene.decoded(description, header.data_bytes)
    own = msgspec.structs.replace(header, description_bytes=min(len(description), 2**22))
    with pytest.raises(ValueError):
        scene_files(own, np.frombuffer(description, np.uint8), data)


@pytest.mark.parametrize("name", ["indices", "caster_indices"])
def test_indices_of_vertices_that_there_are_not_are_refused(message, name):
    header, (description, data) = message
    span = json.loads(description.tobytes())["arrays"][name]
    assert scene_files(header, description, data).hash
    damaged = data.copy()
    damaged[span["offset"] + 4 : span["offset"] + 8] = 255
    with pytest.raises(ValueError, match="an index beyond"):
        scene_files(header, description, damaged)


@pytest.mark.parametrize(
    ("name", "at", "fault"), [("surfels", 12, "a surfel without its mesh"), ("vertex_surfels", 0, "a vertex among surfels")]
)
def test_surfels_that_there_are_not_are_refused(message, name, at, fault):
    header, (description, data) = message
    span = json.loads(description.tobytes())["arrays"][name]
    damaged = data.copy()
    damaged[span["offset"] + at : span["offset"] + at + 4] = 127
    with pytest.raises(ValueError, match=fault):
        scene_files(header, description, damaged)


def test_overlong_and_nested_descriptions_are_refused(message):
    for description in (b" " * (flat_scene.MAX_DESCRIPTION + 1), b"[" * 100_000, b"{", b"\xff"):
        with pytest.raises(ValueError):
            flat_scene.decoded(description, 0)


def test_a_hash_stands_for_all_bytes(message):
    header, (description, data) = message
    assert isinstance(header, wire.SceneMessage)
    files = scene_files(header, description, data)
    assert json.loads(files.description)["hash"] == files.hash
    assert files.data == data.tobytes()
    other = data.copy()
    other[0] ^= 1
    assert scene_files(header, description, other).hash != files.hash


def test_a_scene_that_is_too_large_is_a_line(monkeypatch):
    monkeypatch.setattr("vemlight.renderer.browser.flatten.MAX_DATA", 4096)
    header, arrays = scene_message(load_scene(BUNDLED_SCENE.parent / "headlights.toml"), DRAWING)
    assert isinstance(header, wire.SceneMessage)
    assert "only the server draws it" in header.text
    assert scene_files(header, *arrays).text == header.text


def test_scenes_of_too_many_triangles_for_rays_are_said(monkeypatch):
    scene = load_scene(BUNDLED_SCENE.parent / "headlights.toml")
    assert flattened(scene, DRAWING).scene.laws["RAYS"] == 1
    monkeypatch.setattr("vemlight.renderer.browser.flatten.MOST_RAY_TRIANGLES", 1000)
    made = flattened(scene, DRAWING).scene
    assert made.laws["RAYS"] == 0
    assert "light from surface to surface (mirrors show the sky alone)" in made.left_out


def test_textures_are_reduced_until_a_scene_fits(monkeypatch):
    scene = load_scene(BUNDLED_SCENE)
    whole = flattened(scene, DRAWING)
    monkeypatch.setattr("vemlight.renderer.browser.flatten.MAX_DATA", len(whole.data) - 4)
    less = flattened(scene, DRAWING)
    assert len(less.data) < len(whole.data)
    assert "textures finer than half of theirs" in less.scene.left_out


def test_an_image_that_is_read_in_two_ways_travels_once_and_keeps_both():
    scene = load_scene(BUNDLED_SCENE)
    ground, plinth = scene.meshes[0], scene.meshes[1]
    assert isinstance(ground.material, Ggx)
    assert isinstance(plinth.material, Ggx)
    image = ground.material.colour_map
    assert image
    clamped = image._replace(repeats=(False, True), filters=(9728, 9728))
    other = plinth._replace(material=plinth.material._replace(colour_map=clamped))
    both = flattened(scene._replace(meshes=(ground, other, *scene.meshes[2:])), DRAWING).scene
    first, second = (both.textures[both.materials[mesh.material].textures[0] or 0] for mesh in both.meshes[:2])
    assert first is not second
    assert first.texels == second.texels
    assert (first.repeats, first.filters) == (image.repeats, image.filters)
    assert (second.repeats, second.filters) == (clamped.repeats, clamped.filters)


def test_shaders_are_whole_and_of_the_browsers_dialect():
    for name, source in browser_shaders().items():
        assert source.startswith("#version 300 es\n"), name
        assert "#include" not in source
        assert not re.search(r"\blights\[|\w_views\[|readonly buffer", source), f"{name}: lights and shadow views lie in textures"


def ground(side: float) -> Geometry:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * side / 2
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    return Geometry(corners, normals, corners[:, :2] / 4, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), False)


def test_long_edges_are_cut_near_the_camera_alone():
    centre, radius = np.array([3.0, -2.0, 0.5]), 5.0
    cut = with_short_edges(ground(16_000.0), centre, radius)
    ends = cut.positions[cut.triangles[:, [[0, 1], [1, 2], [2, 0]]]].astype(np.float64)
    lengths = np.linalg.norm(ends[..., 0, :] - ends[..., 1, :], axis=-1)
    away = np.linalg.norm(ends.mean(axis=2) - centre, axis=-1)
    assert (lengths <= np.maximum(away, radius) * 1.0001).all()
    assert len(cut.triangles) < 3000
    a, b, c = np.moveaxis(cut.positions[cut.triangles].astype(np.float64), 1, 0)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all(), "wound as before"
    assert areas.sum() == pytest.approx(16_000.0**2), "and the same surface"
    np.testing.assert_allclose(cut.uvs, cut.positions[:, :2] / 4)
    sides, counts = np.unique(np.sort(cut.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True)
    inner = np.abs(cut.positions[sides]).max(axis=2).min(axis=1) < 7999
    assert (counts[inner] == 2).all(), "no gap between neighbours"


def test_short_meshes_stay_as_they_are():
    mesh = ground(2.0)
    assert with_short_edges(mesh, np.zeros(3), 5.0) is mesh
