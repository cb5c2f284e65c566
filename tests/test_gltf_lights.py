"""Lamps of glTF files: where they are drawn, how bright, with shadows."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.gltf_files import TexturedSquare
from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.far_field import FarField, intensity
from vemlight.light.light_set import LightSet
from vemlight.renderer.scene.luminaire_table import Luminaire
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

CAMERA = "[camera]\nfrom = [0.0, 0.0, 20.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 5.0\n"
GROUND = '[[mesh]]\nshape = "plane"\nscale = 4.0\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
HALF = float(np.sqrt(0.5))


def sheet_with(lights: list[dict], nodes: list[dict]) -> TexturedSquare:
    """A square far away, and nodes with lights by their numbers."""
    sheet = TexturedSquare()
    sheet.document.update(extensionsUsed=["KHR_lights_punctual"], extensions={"KHR_lights_punctual": {"lights": lights}})
    shown = [{"extensions": {"KHR_lights_punctual": {"light": node.pop("light")}}, **node} for node in nodes]
    sheet.document["nodes"] = [{"mesh": 0, "translation": [900.0, 0.0, 0.0]}, *shown]
    sheet.document["scenes"] = [{"nodes": list(range(len(nodes) + 1))}]
    return sheet


def scene_of(folder: Path, sheet: TexturedSquare, mesh: str = "", more: str = "") -> Scene:
    sheet.write(folder / "sheet.gltf")
    (folder / "scene.toml").write_text(f'{CAMERA}{GROUND}[[mesh]]\nfile = "sheet.gltf"\n{mesh}\n{more}')
    return load_scene(folder / "scene.toml")


def middle(scene: Scene, poses=()) -> np.ndarray:
    """The radiance of the ground below the middle, (3,)."""
    renderer = SceneRenderer(scene, Settings(width=9, height=9, bounces=0))
    if poses:
        renderer.picture(LightSet.none())
        renderer.place(0.0, poses)
    picture = renderer.picture(LightSet.none())
    renderer.release()
    return picture[4, 4, :3]


def far_field(lamp: Luminaire) -> FarField:
    assert isinstance(lamp.source, FarField)
    return lamp.source


def test_a_point_gives_its_candela_over_the_squared_distance_in_its_colour(tmp_path):
    above = {"light": 0, "translation": [0.0, 2.0, 0.0]}  # the file's y is up
    scene = scene_of(tmp_path, sheet_with([{"type": "point", "intensity": 40.0, "color": [1.0, 0.5, 0.25]}], [above]))
    np.testing.assert_allclose(middle(scene), 40 / 2**2 / np.pi * np.array([1, 0.5, 0.25]), rtol=0.01)


def test_a_lamp_of_a_file_has_shadows(tmp_path):
    roof = '[[mesh]]\nshape = "plane"\nscale = 0.5\nat = [0.0, 0.0, 1.0]\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'
    lamp = sheet_with([{"type": "point", "intensity": 40.0}], [{"light": 0, "translation": [3.0, 2.0, 0.0]}])
    lit, shaded = (middle(scene_of(tmp_path, lamp, more=more)) for more in ("", roof.replace("0.0, 0.0, 1.0", "1.5, 0.0, 1.0")))
    assert lit.min() > 0.3
    assert shaded.max() == 0


def test_a_spot_shines_along_its_axis_within_its_cone(tmp_path):
    spot = {"type": "spot", "intensity": 9.0, "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.6}}
    down = {"light": 0, "name": "Key", "translation": [0.0, 3.0, 0.0], "rotation": [-HALF, 0.0, 0.0, HALF], "scale": [7.0, 7.0, 7.0]}
    scene = scene_of(tmp_path, sheet_with([spot], [down]))
    (lamp,) = scene.luminaires
    np.testing.assert_allclose(lamp.world_from_local[:3, 3], [0, 0, 3], atol=1e-6)
    np.testing.assert_allclose(lamp.world_from_local[:3, 2], [0, 0, -1], atol=1e-6)
    assert np.linalg.det(lamp.world_from_local) == pytest.approx(1)
    np.testing.assert_allclose(middle(scene), 9 / 9 / np.pi, rtol=0.01)
    angles = np.array([0.0, 0.29, 0.45, 0.61, 2.0])
    towards = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    half_way = (np.cos(0.45) - np.cos(0.6)) / (np.cos(0.3) - np.cos(0.6))
    np.testing.assert_allclose(intensity(far_field(lamp), towards), 9 * np.array([1, 1, half_way**2, 0, 0]), atol=0.01)
    assert scene.objects[-1].name == "Key"
    moved = Pose(name="Key", position=(0.0, 0.0, 1.5), rotation=scene.objects[-1].rotation)
    np.testing.assert_allclose(middle(scene, [moved]), 9 / 1.5**2 / np.pi, rtol=0.01)


def test_lamps_stand_where_their_file_is_placed_and_its_scale_changes_no_light(tmp_path):
    lamp = sheet_with([{"type": "point", "intensity": 4.0}], [{"light": 0, "translation": [0.0, 1.0, 0.0]}])
    scene = scene_of(tmp_path, lamp, "scale = [2.0, 2.0, 2.0]\nat = [0.0, 0.0, 1.0]\n")
    np.testing.assert_allclose(scene.luminaires[0].world_from_local[:3, 3], [0, 0, 3], atol=1e-6)
    np.testing.assert_allclose(middle(scene), 4 / 9 / np.pi, rtol=0.01)


def test_a_lamp_beyond_all_scenes_is_refused(tmp_path):
    far = sheet_with([{"type": "point"}], [{"light": 0, "name": "Far", "translation": [0.0, 3e6, 0.0]}])
    with pytest.raises(UserError, match="its lamp Far is farther than 1000000 m away"):
        scene_of(tmp_path, far)


def test_what_is_not_drawn_is_said(tmp_path):
    lights = [{"type": "directional", "name": "Sun"}, {"type": "point", "range": 5.0}]
    nodes = [{"light": 0}, {"light": 1, "name": "Bulb"}, {"light": 1, "name": "Hidden", "scale": [0.0, 0.0, 0.0]}]
    file = read_meshes(sheet_with(lights, nodes).write(tmp_path / "sheet.gltf"), "here")
    assert file.unsupported == [
        "sheet.gltf: its light Sun is left out: it comes from infinitely far away, as that of the map does",
        "sheet.gltf: the range of its light Bulb is left out: it reaches as far as light does",
        "sheet.gltf: its light Hidden is left out: its scale is 0",
    ]
    assert [lamp.name for lamp in file.lamps] == ["Bulb"]


@pytest.mark.parametrize(("light", "said"), [
    ({"type": "point", "intensity": -1.0}, "a light of -1 cd"),
    ({"type": "point", "intensity": 1e300}, "a light of 1e+300 cd"),
    ({"type": "point", "color": [2.0, 0.0, 0.0]}, "a light with the colour"),
    ({"type": "area"}, "a light of type area"),
    ({"type": "spot", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.4}}, "a spot with cones of 0.5 and 0.4 rad"),
])  # fmt: skip
def test_lights_that_cannot_be_are_refused(tmp_path, light, said):
    with pytest.raises(UserError, match="is not a readable mesh") as caught:
        read_meshes(sheet_with([light], [{"light": 0}]).write(tmp_path / "sheet.gltf"), "here")
    assert said in str(caught.value)
