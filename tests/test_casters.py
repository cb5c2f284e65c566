import numpy as np
import pytest
import trimesh

from tests.support.scenes import SHAPES
from vemlight.renderer.passes.shadow_maps import simplification
from vemlight.renderer.passes.shadow_maps.casters import Casters, placed_casters, scene_casters
from vemlight.renderer.passes.shadow_maps.simplification import simplified
from vemlight.renderer.scene.meshes import VertexAttributes, clean_geometry, shape_geometry
from vemlight.renderer.scene.scene import load_scene


def corners(casters: Casters, span) -> np.ndarray:
    return casters.positions[casters.indices[span.first : span.first + span.count].reshape(-1, 3)]


@pytest.mark.parametrize("tolerance", [1e-3, 5e-3, 2e-2])
def test_a_simplified_sphere_stays_within_its_tolerance(tolerance):
    pytest.importorskip("fast_simplification")
    sphere = shape_geometry("sphere")
    (made,) = simplified(sphere, [tolerance])
    points = made.positions[made.triangles].astype(float)
    inside = points.mean(axis=1)  # the deepest points of facets on a sphere are their middles
    assert made.closed
    # but for one point in 1000; a facet's middle and the corners are its extremes
    assert np.quantile(np.abs(np.linalg.norm(inside, axis=-1) - 1), 0.99) < 1.5 * tolerance
    assert np.quantile(np.abs(np.linalg.norm(points, axis=-1) - 1), 0.99) < 1.5 * tolerance
    if tolerance >= 5e-3:
        assert len(made.triangles) <= len(sphere.triangles) / 4


def test_a_box_is_left_as_it_is():
    box = shape_geometry("box")
    assert simplified(box, [0.1])[0] is box


def test_finer_maps_keep_more_triangles():
    pytest.importorskip("fast_simplification")
    scene = load_scene(SHAPES)
    casters = scene_casters(scene, (4096, 256, 32))
    assert casters.receiver_plane is not None
    assert casters.levels == (0, 1, 2)
    sizes = [sum(member.details[level].indices.count for member in casters.members) for level in casters.levels]
    assert sizes[0] > sizes[1] > sizes[2]
    plane = casters.receiver_plane.details[0].indices.count
    assert [len(scene_casters(scene, (size,)).indices) - plane for size in (4096, 256, 32)] == sizes


def test_resolutions_that_show_the_same_share_their_triangles(tmp_path):
    (tmp_path / "scene.toml").write_text(
        '[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n[[mesh]]\nshape = "plane"\n[[mesh]]\nshape = "box"\nat = [0, 0, 1]\n'
    )
    casters = scene_casters(load_scene(tmp_path / "scene.toml"), (1024, 256, 64))
    assert casters.levels == (0, 0, 0)
    assert [len(member.details) for member in casters.members] == [1]


def test_versions_of_a_mesh_get_no_finer_as_more_is_allowed():
    pytest.importorskip("fast_simplification")
    sphere = shape_geometry("sphere")
    made = simplified(sphere, [1e-9, 1e-3, 1e-3, 1e-1])
    assert made[0] is sphere
    assert made[1] is made[2]
    counts = [len(geometry.triangles) for geometry in made]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[1]


def test_the_ground_is_a_receiver_plane_and_casts_apart():
    casters = scene_casters(load_scene(SHAPES), (64, 32))
    assert casters.receiver_plane is not None
    assert casters.plane_normal.tolist() == [0, 0, 1]
    (plane,) = casters.receiver_plane.details
    assert plane.indices.count == 6
    assert np.ptp(corners(casters, plane.indices)[..., 2]) == 0
    assert np.all(casters.box_half[0] <= casters.box_half[1])
    for box, members in ((0, casters.members), (1, casters.every)):
        points = np.concatenate([corners(casters, detail.indices).reshape(-1, 3) for member in members for detail in member.details])
        assert np.all(np.abs(points - casters.box_centre[box]) <= casters.box_half[box] + 1e-5)


def test_a_ground_that_something_pierces_is_no_receiver_plane(tmp_path):
    (tmp_path / "scene.toml").write_text(
        '[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n[[mesh]]\nshape = "plane"\n[[mesh]]\nshape = "box"\nscale = 0.2\n'
    )
    casters = scene_casters(load_scene(tmp_path / "scene.toml"), (64,))
    assert not casters.plane_normal.any()
    assert casters.receiver_plane is None
    assert [detail.indices.count for member in casters.members for detail in member.details if not detail.closed] == [6]


def test_a_single_plane_casts_for_itself(tmp_path):
    (tmp_path / "scene.toml").write_text('[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n[[mesh]]\nshape = "plane"\n')
    casters = scene_casters(load_scene(tmp_path / "scene.toml"), (64,))
    assert casters.receiver_plane is None
    assert [(detail.indices.count, detail.closed) for detail in casters.members[0].details] == [(6, False)]


@pytest.mark.parametrize(("subdivisions", "fewer"), [(2, False), (3, True)])  # 320 and 1280 triangles
def test_only_meshes_whose_triangles_cost_more_than_a_clear_are_simplified(subdivisions, fewer):
    pytest.importorskip("fast_simplification")
    ball = trimesh.creation.icosphere(subdivisions)
    geometry = clean_geometry(VertexAttributes(np.asarray(ball.vertices)), np.asarray(ball.faces))
    (made,) = simplified(geometry, [0.5])
    assert (len(made.triangles) < len(geometry.triangles)) == fewer


@pytest.mark.parametrize(("radius", "counts"), [(0.06, True), (0.004, False)])  # 1.2 % and 0.08 % of all area
def test_what_departs_counts_from_one_point_in_a_thousand_on(radius, counts):
    # A pillar 0.1 high on a plate of 1 x 1, against the plate alone. Less than that is some hundred texels of a map of 1024 x 1024.
    plate = trimesh.creation.box((1.0, 1.0, 0.02))
    pillar = trimesh.creation.box((radius, radius, 0.1), trimesh.transformations.translation_matrix([0.2, 0.1, 0.06]))
    flat = np.asarray(plate.triangles)
    departure = simplification._departure(np.concatenate([flat, np.asarray(pillar.triangles)]), flat)
    assert (departure > 0.05) == counts


@pytest.mark.parametrize(("sunk", "plane"), [(0.0, True), (0.005, False)])
def test_a_ground_holds_only_what_sinks_in_by_less_than_a_texel_shows(tmp_path, sunk, plane):
    (tmp_path / "scene.toml").write_text(
        '[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n[[mesh]]\nshape = "plane"\n'
        f'[[mesh]]\nshape = "box"\nscale = 0.2\nat = [0.0, 0.0, {0.2 - sunk}]\n'
    )
    # A texel of a map of 1024 is 0.4 mm here, and 5 mm sunk would let light through under the box.
    assert (scene_casters(load_scene(tmp_path / "scene.toml"), (64,)).receiver_plane is not None) == plane


def test_a_box_that_must_grow_grows_by_a_tenth_more():
    # Maps are drawn anew whenever the box changes: what goes on moving outwards must not change it each frame, nor waste texels.
    casters = scene_casters(load_scene(SHAPES), (64,))
    rest = np.tile(np.eye(4), (1 + max(member.mesh for member in casters.every), 1, 1))
    before = placed_casters(casters, rest)
    moved = rest.copy()
    moved[casters.members[0].mesh, 0, 3] = 100.0
    after = placed_casters(casters, moved, before)
    reached = (casters.members[0].corners[:, 0] + 100.0).max()
    width = reached - (before.box_centre - before.box_half)[0]
    assert (after.box_centre + after.box_half)[0] - reached == pytest.approx(0.1 * width, rel=0.1)
    moved[casters.members[0].mesh, 0, 3] = 105.0
    assert np.array_equal(placed_casters(casters, moved, after).box_half, after.box_half)
