import numpy as np
import pytest

from services.renderer.casters import Casters, scene_casters, simplified
from services.renderer.meshes import shape_geometry
from services.renderer.scene import load_scene


def corners(casters: Casters, span) -> np.ndarray:
    return casters.positions[casters.indices[span.first : span.first + span.count].reshape(-1, 3)]


@pytest.mark.parametrize("tolerance", [1e-3, 5e-3, 2e-2])
def test_a_simplified_sphere_stays_within_its_tolerance(tolerance):
    pytest.importorskip("fast_simplification")
    sphere = shape_geometry("sphere")
    made = simplified(sphere, tolerance)
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
    assert simplified(box, 0.1) is box


def test_finer_maps_keep_more_triangles():
    pytest.importorskip("fast_simplification")
    scene = load_scene(None)
    sizes = [len(scene_casters(scene, tile).indices) for tile in (32, 256, 4096)]
    assert sizes[0] < sizes[1] < sizes[2]


def test_the_ground_is_a_floor_and_casts_apart(tmp_path):
    scene = load_scene(None)
    casters = scene_casters(scene, 64)
    assert casters.floor_normal.tolist() == [0, 0, 1]
    assert casters.floor.count == 6
    assert np.ptp(corners(casters, casters.floor)[..., 2]) == 0
    assert np.all(casters.box_half[0] <= casters.box_half[1])
    for box, spans in ((0, (casters.closed, casters.open)), (1, (casters.closed, casters.open, casters.floor))):
        points = np.concatenate([corners(casters, span).reshape(-1, 3) for span in spans])
        assert np.all(np.abs(points - casters.box_centre[box]) <= casters.box_half[box] + 1e-5)


def test_a_ground_that_something_pierces_is_no_floor(tmp_path):
    (tmp_path / "scene.toml").write_text(
        '[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n[[mesh]]\nshape = "plane"\n[[mesh]]\nshape = "box"\nscale = 0.2\n'
    )
    casters = scene_casters(load_scene(tmp_path / "scene.toml"), 64)
    assert not casters.floor_normal.any()
    assert casters.floor.count == 0
    assert casters.open.count == 6


def test_a_single_plane_casts_for_itself(tmp_path):
    (tmp_path / "scene.toml").write_text('[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n[[mesh]]\nshape = "plane"\n')
    casters = scene_casters(load_scene(tmp_path / "scene.toml"), 64)
    assert (casters.open.count, casters.floor.count) == (6, 0)
