import numpy as np

from vemlight.renderer.luminaire.bvh import Ray, hierarchy_from_triangles, occluded


def test_rays_are_occluded_by_the_triangles_they_meet():
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1, 1, (80, 1, 3)) + rng.uniform(-0.3, 0.3, (80, 3, 3))
    scene = hierarchy_from_triangles(corners)
    singles = [hierarchy_from_triangles(corners[k : k + 1]) for k in range(80)]
    hits = 0
    for _ in range(150):
        o, target = rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3)
        d = target - o
        expected = any(occluded(one, Ray(*o, *d), 0.0, 1.5) for one in singles)
        assert occluded(scene, Ray(*o, *d), 0.0, 1.5) == expected
        hits += expected
    assert 20 < hits < 140
    assert not occluded(hierarchy_from_triangles(np.zeros((0, 3, 3))), Ray(*np.zeros(3), *np.ones(3)), 0.0, 1.0)


def test_the_tree_splits_every_larger_leaf():
    hierarchy = hierarchy_from_triangles(np.random.default_rng(1).normal(size=(1000, 3, 3)))
    leaves = hierarchy.nodes[hierarchy.nodes[:, 1] > 0]
    assert leaves[:, 1].sum() == 1000
    assert leaves[:, 1].max() <= 16
