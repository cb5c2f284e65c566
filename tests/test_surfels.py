"""Surfels of a scene for browsers: few, on its surfaces, and every vertex among those of its own mesh."""

import numpy as np
import pytest

from vemlight.renderer.browser.surfels import fine_enough, surfels
from vemlight.renderer.rays.reflecting import reflecting_meshes
from vemlight.renderer.scene.scene import BUNDLED_SCENE, load_scene
from vemlight.runtime.flat_scene import MAX_SURFELS

ROOM = """
[camera]
from = [0.0, -0.5, 0.0]
at = [0.0, 0.5, 0.0]

[[mesh]]
shape = "box"
material = {diffuse = [0.5, 0.4, 0.3]}

[[mesh]]
shape = "sphere"
scale = 0.2
at = [0.5, 0.5, 0.5]
material = {base_color = [0.9, 0.8, 0.7], metallic = 1.0}

[[mesh]]
shape = "plane"
at = [0.0, 0.0, -5.0]
material = {catcher = true}
"""


def finely_cut(path):
    scene = load_scene(path)
    cut = fine_enough([mesh.geometry for mesh in scene.meshes], scene.camera)
    return scene._replace(meshes=tuple(mesh._replace(geometry=own) for mesh, own in zip(scene.meshes, cut, strict=True)))


@pytest.fixture(params=["terrace.toml", "headlights.toml", "room"])
def made(request, tmp_path):
    path = BUNDLED_SCENE.parent / request.param
    if request.param == "room":
        path = tmp_path / "room.toml"
        path.write_text(ROOM)
    scene = finely_cut(path)
    found = surfels(scene, reflecting_meshes(scene))
    assert found
    return scene, found


def test_vertices_lie_among_few_surfels_of_their_own_mesh_and_side(made):
    scene, found = made
    assert len(found.rows) <= MAX_SURFELS
    assert (found.weights.sum(axis=1, dtype=int) == 255).all()
    first = 0
    for number, mesh in enumerate(scene.meshes):
        count = len(mesh.geometry.positions)
        ids, weights = found.of_vertices[first : first + count].astype(int), found.weights[first : first + count]
        assert (found.rows[ids, 3][weights > 0] == number).all()
        facing = np.einsum("vki,vi->vk", found.rows[ids, 4:7], mesh.geometry.normals)
        assert np.average(facing, weights=weights) > 0.8, "like normals: a ball has one surfel for each face of a cube at least"
        if found.backs[number]:
            back, front = found.rows[ids + found.backs[number]], found.rows[ids]
            np.testing.assert_array_equal(back[..., :4], front[..., :4])
            np.testing.assert_array_equal(back[..., 4:7], -front[..., 4:7])
        first += count


def test_surfels_lie_on_their_triangles(made):
    scene, found = made
    for number, mesh in enumerate(scene.meshes):
        own = found.rows[found.rows[:, 3] == number, :3].astype(np.float64)
        corners = mesh.geometry.positions[mesh.geometry.triangles].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        size = np.ptp(mesh.geometry.positions, axis=0).max()
        for place in own[:: max(len(own) // 10, 1)]:
            off = np.abs(np.einsum("ti,ti->t", place - corners[:, 0], normals))
            assert off.min() < 1e-5 * max(size, 1)


def test_what_they_reflect_is_their_materials(tmp_path):
    (tmp_path / "room.toml").write_text(ROOM)
    scene = finely_cut(tmp_path / "room.toml")
    found = surfels(scene, reflecting_meshes(scene))
    assert found
    for number, albedo in enumerate([(0.5, 0.4, 0.3), (0.9, 0.8, 0.7), (-1, -1, -1)]):
        own = found.rows[found.rows[:, 3] == number, 8:11]
        np.testing.assert_allclose(own, np.broadcast_to(albedo, own.shape), rtol=1e-5)
    assert [back > 0 for back in found.backs] == [True, False, True], "a room has two sides, what stands in it one"


def test_a_scene_of_very_many_meshes_has_none(tmp_path):
    (tmp_path / "room.toml").write_text(ROOM)
    scene = load_scene(tmp_path / "room.toml")
    many = scene._replace(meshes=scene.meshes[2:] * (MAX_SURFELS // 2 + 1))
    assert surfels(many, reflecting_meshes(many)) is None
