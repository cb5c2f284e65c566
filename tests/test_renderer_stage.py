"""The renderer as a stage: what a control message changes, whose clock animations follow, what an image carries."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.gltf_files import AnimatedTriangle
from tests.support.renderer_steps import controlled, lights_message, picture_of, stepped
from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import direction_from_angles, quaternion_xyz
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.frame_budget import CostModel
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import stamps, wire
from vemlight.runtime.poses import Pose
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


def test_an_image_lists_the_poses_of_objects_and_a_control_moves_them(stage):
    state, image = stepped(stage, stage.start_at(0)[0], 0)
    assert [(found.name, found.position, found.power) for found in image.objects] == [
        ("plane", (0, 0, 0), None), ("film", (-1, 0, 0), None), ("torch", (0, 0, 2), 1)
    ]  # fmt: skip
    lit = picture_of(state)
    there = Pose(name="torch", position=(1.0, 0.0, 2.0), rotation=quaternion_xyz((180.0, 0.0, 0.0)), power=5.0)
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


@pytest.mark.parametrize(
    ("mode", "frame_ms", "target_ms"), [("live", None, 100.0), ("live", 40.0, 40.0), ("live", 0.0, 0.0), ("lossless", 40.0, 0.0)]
)
def test_the_live_target_is_ten_pictures_a_second_unless_set(mode, frame_ms, target_ms):
    """In lossless mode there is time: a picture follows from its lights alone."""
    stage = RendererStage(Settings(mode=mode, renderer=Renderer(width=8, height=8, frame_ms=frame_ms)))
    assert stage._renderer.setup.target_ms == target_ms


def test_files_have_four_samples_of_each_pixel_and_live_pictures_one(tmp_path):
    small = Renderer(width=8, height=8)
    for out, samples in (("", 1), (str(tmp_path), 4)):
        assert len(RendererStage(Settings(renderer=small, out=out))._renderer.setup.samples) == samples


def test_a_target_that_cannot_be_met_is_reported_once(capsys):
    hurried, patient = (RendererStage(Settings(renderer=Renderer(width=32, height=24, frame_ms=ms))) for ms in (0.01, 1e4))
    state, notices = hurried.start_at(0)[0], []
    for k in range(8):  # two frames warm up, and then one is enough to know
        state, image = stepped(hurried, state, k)
        notices += state.notices
    assert image.report.light_budget == 8
    state, _ = stepped(patient, state, 8)
    without, missed, again, met = [*notices, *state.notices]
    assert without == "vemlight: renderer: [renderer] frame_ms: 0.01 ms leave no time for light from surface to surface; it is left out"
    assert again == "vemlight: renderer: light from surface to surface is drawn again"
    assert missed.startswith("vemlight: renderer: [renderer] frame_ms: ")
    assert missed.endswith(" ms even with 8 lights, not 0.01; make width and height smaller")
    assert met == "vemlight: renderer: the target frame time is met again"
    assert capsys.readouterr().err == ""  # a step has no effect
    patient.write(state, lights_message(8))
    assert capsys.readouterr().err == f"{again}\n{met}\n"


def test_a_frame_a_little_beyond_the_target_is_not_late_and_then_not_in_time():
    stage = RendererStage(Settings(renderer=Renderer(width=32, height=24, frame_ms=100.0)))
    state = stage.start_at(0)[0]
    for fixed_ms, late in ((90.0, False), (114.0, False), (116.0, True), (101.0, True), (99.0, False)):
        state = stage._with_notices(state._replace(costs=CostModel(3, fixed_ms, None, 0.0)))
        assert state.late == late


@pytest.fixture
def moving_sky():
    """Messages of lights that move, a texel and more each: maps are cached, drift, wait and are redrawn."""

    def message(sequence: int) -> wire.Message:
        header, (*_, gloss_directions, gloss_irradiance) = lights_message(sequence)
        count = 30
        k = np.arange(count) + 0.5
        directions = direction_from_angles(np.arccos(k / count), 2.4 * k + 0.01 * sequence * (k > 10)).astype(np.float32)
        irradiance = np.full((count, 3), 0.1, np.float32)
        header = msgspec.structs.replace(header, count=count)
        return header, (np.arange(count), directions, irradiance, gloss_directions, gloss_irradiance)

    return message


def same(a: object, b: object) -> bool:
    """Equality of states: of records by their fields, of arrays by their numbers."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, tuple) and isinstance(b, tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, MapLights) and isinstance(b, MapLights):
        return np.array_equal(a.radiance, b.radiance)
    return bool(a == b)


@pytest.mark.parametrize("frame_ms", [0.0, 1e4])
@pytest.mark.parametrize("paused", [False, True])
def test_a_step_has_no_effect_but_its_result(tmp_path, moving_sky, monkeypatch, frame_ms, paused):
    """From any state the same message makes the same picture and the same next state, whatever was drawn in between.

    Of what a clock decides, `measured` apart, nothing is in the next state. Few maps are redrawn in a frame, so that others are old.
    """
    monkeypatch.setattr("vemlight.renderer.frame_plan.affordable_maps", lambda *_: 4)
    monkeypatch.setattr("vemlight.renderer.frame_plan.coarsening", lambda *_: 0)
    boxes = "".join(f'[[mesh]]\nshape = "box"\nscale = 0.4\nat = [{x}, 0.0, 0.5]\n' for x in (-1.0, 1.0))
    plane, lamp = SCENE[: SCENE.index('[[mesh]]\nfile')], SCENE[SCENE.index("[[luminaire]]") :]
    (tmp_path / "scene.toml").write_text(plane + boxes + lamp.replace('shadows = "none"', "shadow_map = 16"))
    drawing = Renderer(scene=str(tmp_path / "scene.toml"), width=48, height=36, shadow_map=64, frame_ms=frame_ms, picture="linear16")
    stage = RendererStage(Settings(renderer=drawing))
    header = wire.MapMessage(stamp=stamps.stamp(0, 0.0), rows=4, cols=8, coverage="hemisphere")
    sky = header, (np.ones((4, 8, 3), np.float32), *NO_BRIGHT_CELLS)
    state, made = stage.start_at(0)[0], []
    for sequence in range(6):
        if sequence == 3:
            state = controlled(stage, state, poses=(Pose(name="box", position=(-0.7, 0.0, 0.5)),))
        if paused and sequence >= 3:
            state = stage.on_message(controlled(stage, state, paused=True, poses=state.poses), sky)
        before = state
        state, (_, arrays) = stage.step(before, moving_sky(sequence))
        made.append((before, state._replace(measured=None), arrays))
    if frame_ms and not paused:
        assert state.frame.maps is not None  # there is something to be restored
        assert not np.isnan(state.frame.maps.slots.lookups).all()
        assert state.frame.maps.slots.drift_rad.max() > 0
    for sequence in (5, 2, 5, 3, 0, 4):
        before, after, arrays = made[sequence]
        state, (_, again) = stage.step(before, moving_sky(sequence))
        assert all(np.array_equal(a, b) for a, b in zip(again, arrays, strict=True))
        assert same(state._replace(measured=None), after)


def test_polished_things_show_no_dots_of_lights_before_the_first_map(tmp_path):
    (tmp_path / "scene.toml").write_text("""
[camera]
from = [0.0, -4.0, 1.0]
at = [0.0, 0.0, 0.0]
[[mesh]]
shape = "sphere"
material = {diffuse = [0.0, 0.0, 0.0], specular = [0.9, 0.9, 0.9], exponent = 400.0}
""")
    drawing = Renderer(scene=str(tmp_path / "scene.toml"), width=48, height=36, picture="linear16", bounces=0)
    stage = RendererStage(Settings(renderer=drawing))
    state, _ = stepped(stage, stage.start_at(0)[0], 0)
    assert picture_of(state)[..., :3].max() == 0
    environment = EnvironmentMap(np.ones((9, 36, 3), np.float32), "hemisphere")
    state, _ = stepped(stage, state._replace(environment=environment), 1)
    assert picture_of(state)[..., :3].max() > 0
