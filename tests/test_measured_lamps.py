"""Measured lamps in place of near lights: as strong towards the rig as the light, and as their file says elsewhere."""

import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.light.measured_lamp import MeasuredLamp
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.scene.measured_lamps import irradiance_towards, lit_by_lamps, recognised, with_measured_lamps
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

RIG = np.array([0.0, 0.0, 1.0])
GROUND = """
[camera]
from = [0.0, 0.0, 10.0]
at = [0.0, 0.0, 0.0]
fov_y = 11.0
[[mesh]]
shape = "plane"
scale = 4.0
material = {diffuse = [1.0, 1.0, 1.0]}
"""


@pytest.fixture
def lamp_file(tmp_path):
    """Writes an LM-63 file of one plane: candela at gamma 0, 90 and 180 degrees."""

    def write(*candela: float) -> str:
        numbers = " ".join(map(str, candela))
        text = f"IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 100\n0 90 180\n0\n{numbers}\n"
        (tmp_path / "lamp.ies").write_text(text)
        return str(tmp_path / "lamp.ies")

    return write


def near_light(at, intensity=(3.0, 2.0, 1.0)) -> NearLightSet:
    return NearLightSet.of(np.zeros(1), np.array([at]), np.array([intensity]), np.zeros(1), np.zeros(1))


def scene_with(folder, *lamps: MeasuredLamp):
    (folder / "scene.toml").write_text(GROUND)
    return with_measured_lamps(load_scene(folder / "scene.toml"), lamps)


def test_an_even_lamp_gives_the_picture_of_its_near_light(tmp_path, lamp_file):
    at = (0.3, 0.1, 1.5)
    lamp = MeasuredLamp(file=lamp_file(80, 80, 80), at=at)
    scene, near = scene_with(tmp_path, lamp), near_light((0.35, 0.1, 1.5))
    renderer = SceneRenderer(scene, Settings(width=48, height=48, bounces=0))
    renderer.near = near_light(at)
    expected = renderer.picture(LightSet.none()).copy()
    found = recognised(scene.luminaires, [0.3], near_light(at), RIG)
    assert len(found.near.ids) == 0
    renderer.near, renderer.pose = found.near, lit_by_lamps(renderer.pose, scene, found.colours)
    assert renderer.picture(LightSet.none())[..., :3] == pytest.approx(expected[..., :3], rel=2e-3)
    renderer.pose = lit_by_lamps(renderer.pose, scene, [(0.0, 0.0, 0.0)])
    assert not renderer.picture(LightSet.none())[..., :3].any()
    renderer.release()
    assert len(recognised(scene.luminaires, [0.04], near, RIG).near.ids) == 1


def test_the_rig_receives_what_it_measured_whatever_the_lamp_sends_elsewhere(tmp_path, lamp_file):
    """A lamp that shines down most, tilted: towards the rig its light is the near light's, in each channel."""
    lamp = MeasuredLamp(file=lamp_file(400, 100, 20), at=(1.0, 0.5, 2.5), rotate=(170.0, 20.0, 0.0))
    scene, near = scene_with(tmp_path, lamp), near_light((1.1, 0.5, 2.45))
    found = recognised(scene.luminaires, [0.3], near, RIG)
    own = scene.luminaires[0]
    assert irradiance_towards(own, RIG) * found.colours[0] == pytest.approx(near.irradiance_at(RIG)[0], rel=1e-6)
    below, beside = (irradiance_towards(own, np.array(lamp.at) + offset) for offset in ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0)))
    assert below[0] > 2 * beside[0]


def test_a_light_is_one_lamp_and_a_lamp_that_sends_nothing_to_the_rig_is_none(tmp_path, lamp_file):
    even = MeasuredLamp(file=lamp_file(80, 80, 80), at=(1.0, 0.0, 2.0))
    scene = scene_with(tmp_path, even, even)
    found = recognised(scene.luminaires, [0.3, 0.3], near_light((1.0, 0.0, 2.0)), RIG)
    assert found.colours[1] == (0.0, 0.0, 0.0) != found.colours[0]
    dark = scene_with(tmp_path, MeasuredLamp(file=lamp_file(80, 0, 0), at=(1.0, 0.0, 2.0)))  # shines up, and the rig is below
    assert len(recognised(dark.luminaires, [0.3], near_light((1.0, 0.0, 2.0)), RIG).near.ids) == 1


def test_of_two_lamps_beside_each_other_the_one_that_is_lit_is_found(tmp_path, lamp_file):
    """Both lie within reach of the light; the second, which is nearer, is the one, whatever their order."""
    first, second = (MeasuredLamp(file=lamp_file(80, 80, 80), at=(x, 0.0, 2.0)) for x in (1.0, 1.2))
    for lamps, lit in (((first, second), 1), ((second, first), 0)):
        found = recognised(scene_with(tmp_path, *lamps).luminaires, [0.3, 0.3], near_light((1.15, 0.0, 2.0)), RIG)
        assert [colour != (0.0, 0.0, 0.0) for colour in found.colours] == [number == lit for number in range(2)]
        assert len(found.near.ids) == 0


@pytest.mark.parametrize(("towards", "told"), [(2.0, True), (0.5, False)])
def test_a_lamp_that_hardly_shines_to_the_rig_is_not_told_by_it(tmp_path, lamp_file, towards, told):
    """100 cd upwards, and so many to the rig beside it: a hundredth of the brightest is the least."""
    scene = scene_with(tmp_path, MeasuredLamp(file=lamp_file(100, towards, 0), at=(1.0, 0.0, 1.0)))
    found = recognised(scene.luminaires, [0.3], near_light((1.0, 0.0, 1.0)), RIG)
    assert (len(found.near.ids) == 0) == told


def test_a_file_that_is_no_lamp_is_named(tmp_path):
    (tmp_path / "lamp.ies").write_text("no lamp\n")
    with pytest.raises(UserError, match=r"\[renderer\] lamp 1: .*lamp.ies"):
        scene_with(tmp_path, MeasuredLamp(file=str(tmp_path / "lamp.ies"), at=(0.0, 0.0, 1.0)))
