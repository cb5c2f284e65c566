"""The renderer as a stage: what a control message changes, whose clock animations follow, what an image carries."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.gltf_files import AnimatedTriangle
from tests.support.renderer_steps import controlled, lights_message, picture_of, stepped
from vemlight.errors import UserError
from vemlight.light.sphere import quaternion_xyz
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import wire
from vemlight.settings import Renderer, Settings

SCENE = """
[camera]
from = [0.0, -7.0, 4.0]
at = [0.0, 0.0, 0.4]
[[mesh]]
shape = "plane"
scale = 3.0
[[mesh]]
file = "film.gltf"
at = [-1.0, 0.0, 0.0]
[[luminaire]]
at = [0.0, 0.0, 2.0]
rotate = [180.0, 0.0, 0.0]
samples = 4
shadows = "none"
"""


@pytest.fixture
def stage(tmp_path: Path) -> RendererStage:
    AnimatedTriangle().move(1, "translation", [0, 2], [[0, 1, 0], [2, 1, 0]]).write(tmp_path / "film.gltf")
    (tmp_path / "scene.toml").write_text(SCENE)
    drawing = Renderer(scene=str(tmp_path / "scene.toml"), width=48, height=36, shadow_map=64, frame_ms=0.0, picture="linear16")
    return RendererStage(Settings(renderer=drawing))


def test_an_image_tells_where_things_stand_and_a_pose_moves_them(stage):
    state, image = stepped(stage, stage.start_at(0)[0], 0)
    assert [(found.name, found.position, found.power) for found in image.objects] == [
        ("plane", (0, 0, 0), None), ("film", (-1, 0, 0), None), ("torch", (0, 0, 2), 1)
    ]  # fmt: skip
    lit = picture_of(state)
    there = wire.Pose(name="torch", position=(1.0, 0.0, 2.0), rotation=quaternion_xyz((180.0, 0.0, 0.0)), power=5.0)
    state, image = stepped(stage, controlled(stage, state, poses=(there,)), 0)
    assert image.objects[2] == there
    assert not np.array_equal(picture_of(state), lit)
    state, image = stepped(stage, controlled(stage, state), 0)
    assert np.array_equal(picture_of(state), lit)


def test_a_pause_holds_the_animation_and_it_goes_on_from_there(stage):
    state, shown = stage.start_at(0)[0], []
    for sequence in range(8):
        state = controlled(stage, state, paused=3 <= sequence < 6)
        state, _ = stepped(stage, state, sequence)
        shown.append(picture_of(state))
    assert all(np.array_equal(shown[2], held) for held in shown[3:6])
    assert not np.array_equal(shown[5], shown[6])
    state, _ = stage.start_at(0)
    for sequence in (0, 3, 4):  # 0.3 s and 0.4 s are what the two pictures after the pause show
        state, _ = stepped(stage, state, sequence)
        if sequence:
            assert np.array_equal(picture_of(state), shown[sequence + 3])


def test_linear_pictures_travel_as_half_floats(tmp_path):
    stage = RendererStage(Settings(renderer=Renderer(width=32, height=24, shadow_map=64, picture="linear16")))
    header, arrays = lights_message(0)
    state, (image, (pixels, linear)) = stage.step(stage.start_at(0)[0], (header, (*arrays[:2], arrays[2] * 1e7, *arrays[3:])))
    assert isinstance(image, wire.ImageMessage)
    assert image.linear
    assert pixels.shape == linear.shape == (24, 32, 4)
    assert linear.dtype == np.float16
    assert picture_of(state).max() > 65504
    _, (_, again) = wire.unpack(wire.pack(image, (pixels, linear)))
    # 11 bits of a half float; what is beyond its largest number becomes that
    assert np.allclose(again, np.minimum(picture_of(state), 65504), rtol=2**-11, atol=1e-7)


@pytest.mark.parametrize(("picture", "width", "fits"), [("srgb8", 4096, True), ("srgb8", 4097, False), ("linear16", 2049, False)])
def test_a_picture_that_no_message_holds_is_refused_at_once(picture, width, fits, monkeypatch):
    monkeypatch.setattr("vemlight.renderer.stage.Renderer", lambda *_: None)
    wanted = Settings(renderer=Renderer(width=width, height=4096, picture=picture))
    if fits:
        RendererStage(wanted)
    else:
        with pytest.raises(UserError, match=r"\[renderer\] width, height: .* make them smaller"):
            RendererStage(wanted)


def test_a_target_that_cannot_be_met_is_said_once(capsys):
    stage = RendererStage(Settings(renderer=Renderer(width=32, height=24, shadow_map=32, frame_ms=0.01)))
    state = stage.start_at(0)[0]
    for k in range(8):  # two frames warm up, and then one is enough to know
        state, image = stepped(stage, state, k)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("vemlight: renderer: [renderer] frame_ms: ")
    assert line.endswith(" ms a picture even with 8 lights, not 0.01; ask for fewer pixels")
    assert image.report.light_budget == 8
    stage._frame_ms, stage._renderer._frame_ms = 1e4, 1e4
    stepped(stage, state, 8)
    assert capsys.readouterr().err == "vemlight: renderer: pictures are in time again\n"
