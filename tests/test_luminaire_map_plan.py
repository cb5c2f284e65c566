"""Which luminaires' shadow maps are drawn again when something moves."""

import numpy as np
import pytest

from vemlight.light.far_field import FarField
from vemlight.light.sphere import quaternion_xyz
from vemlight.renderer.passes.luminaires.luminaire_map_plan import placed_luminaires, stale_luminaire_maps
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose
from vemlight.runtime.poses import Pose

SCENE = """
[camera]
from = [0.0, -7.0, 4.0]
at = [0.0, 0.0, 0.4]
[[mesh]]
shape = "plane"
scale = 3.0
[[mesh]]
shape = "sphere"
name = "below"
scale = 0.2
at = [0.0, 0.0, 0.5]
[[mesh]]
shape = "sphere"
name = "above"
scale = 0.2
at = [0.0, 0.0, 3.5]
"""
LAMP = '[[luminaire]]\nname = "{name}"\nat = [{x}, 0.0, 2.0]\nrotate = [180.0, 0.0, 0.0]\nshadows = "{shadows}"\n'


@pytest.fixture
def scene(tmp_path) -> Scene:
    """Two lamps that shine down, one of them without shadows, between a sphere below them and one above."""
    lamps = LAMP.format(name="lamp", x=0.0, shadows="maps") + LAMP.format(name="bare", x=0.5, shadows="none")
    (tmp_path / "scene.toml").write_text(SCENE + lamps)
    return load_scene(tmp_path / "scene.toml")


def pose(scene: Scene, name: str = "", position: tuple[float, float, float] = (0.0, 0.0, 0.0), power: float | None = None) -> ScenePose:
    turned = quaternion_xyz((180.0, 0.0, 0.0)) if name in ("lamp", "bare") else (0.0, 0.0, 0.0, 1.0)
    return scene_pose(scene, 0.0, [Pose(name=name, position=position, rotation=turned, power=power)] if name else [])


def stale(scene: Scene, now: ScenePose, drawn: ScenePose | None = None) -> tuple[bool, ...]:
    before = drawn or pose(scene)
    return stale_luminaire_maps(scene, (before, before), now)


def test_maps_that_were_never_drawn_are_stale_where_there_are_any(scene):
    assert stale_luminaire_maps(scene, (None, None), pose(scene)) == (True, False)


def test_what_moves_before_a_lamp_makes_its_maps_stale_and_what_moves_behind_it_does_not(scene):
    assert stale(scene, pose(scene)) == (False, False)
    assert stale(scene, pose(scene, "below", (0.3, 0.0, 0.5))) == (True, False)
    assert stale(scene, pose(scene, "above", (0.3, 0.0, 3.5))) == (False, False)
    # Before or after in the light is enough: a shadow comes or goes.
    assert stale(scene, pose(scene, "above", (0.3, 0.0, 1.0))) == (True, False)
    assert stale(scene, pose(scene), pose(scene, "above", (0.3, 0.0, 1.0))) == (True, False)


def test_a_lamp_that_moves_has_stale_maps_and_one_that_is_dimmed_has_not(scene):
    assert stale(scene, pose(scene, "lamp", (0.1, 0.0, 2.0))) == (True, False)
    assert stale(scene, pose(scene, "lamp", (0.0, 0.0, 2.0), 5.0)) == (False, False)
    assert stale(scene, pose(scene, "bare", (0.1, 0.0, 2.0))) == (False, False)


def test_a_lamp_that_came_back_is_exactly_where_it_was(scene):
    lamp, _ = placed_luminaires(scene, pose(scene))
    dimmed, _ = placed_luminaires(scene, pose(scene, "lamp", (0.0, 0.0, 2.0), 0.5))
    assert np.array_equal(lamp.world_from_local, scene.luminaires[0].world_from_local)
    assert np.allclose(dimmed.world_from_local, lamp.world_from_local, atol=1e-12)
    assert (lamp.power, dimmed.power) == (scene.luminaires[0].power, 0.5)


def test_a_lamp_that_shines_to_all_sides_has_nothing_behind_it(scene):
    bulb = FarField(np.ones((2, 2)), np.array([0.0, 360.0]), np.array([0.0, 180.0]), (0.0, 0.0, 0.0), 1.0, "bulb")
    far = scene.luminaires[0]._replace(source=bulb)
    everywhere = scene._replace(luminaires=(far, scene.luminaires[1]))
    assert stale(everywhere, pose(scene, "above", (0.3, 0.0, 3.5))) == (True, False)
