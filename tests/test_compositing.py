"""What stands behind the scene: the light around and a second camera's picture, of the same frame as the lights."""

import cv2
import numpy as np
import pytest

from tests.support.processes import LOADED_S
from tests.support.renderer_steps import lights_message
from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.images import read_radiance
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import stamps, wire
from vemlight.settings import Plate, Renderer, Settings

SCENE = '[camera]\nfrom = [0.0, -7.0, 1.0]\nat = [0.0, 0.0, 3.0]\n[[mesh]]\nshape = "sphere"\nscale = 0.2\n'


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    return str(tmp_path / "scene.toml")


def corner(stage: RendererStage, messages: list[wire.Message]) -> np.ndarray:
    """The sky pixel at the picture's upper left."""
    state, _ = stage.start_at(0)
    for message in messages:
        state = stage.on_message(state, message)
    state, _ = stage.step(state, lights_message(0))
    assert state.picture is not None
    return state.picture[0, 0]


def test_the_map_and_the_plate_are_seen_behind_the_scene(scene):
    size = Renderer(scene=scene, width=32, height=24, shadow_map=32, picture="linear16")
    header = wire.MapMessage(stamp=stamps.stamp(0, 0.0), rows=4, cols=8, coverage="sphere")
    around = header, (np.full((4, 8, 3), 0.3, np.float32), *NO_BRIGHT_CELLS)
    plate = wire.PlateMessage(stamp=stamps.stamp(0, 0.0), width=2, height=2), (np.full((2, 2, 3), 188, np.uint8),)  # 188 is 0.503 linear

    plain = RendererStage(Settings(renderer=size, mode="lossless"))
    assert plain.side_inputs(plain.start_at(0)[0]) == ()
    np.testing.assert_array_equal(corner(plain, []), 0)

    mapped = RendererStage(Settings(renderer=Renderer(**{**as_dict(size), "background": "map"}), mode="lossless"))
    assert mapped.side_inputs(mapped.start_at(0)[0]) == ("map",)
    np.testing.assert_allclose(corner(mapped, [around]), [0.3, 0.3, 0.3, 1], rtol=2e-3)

    filmed = RendererStage(Settings(renderer=size, mode="lossless", plate=Plate(source="film.mp4", stops=1.0)))
    assert filmed.side_inputs(filmed.start_at(0)[0]) == ("plate",)
    np.testing.assert_array_equal(corner(filmed, []), 0)
    np.testing.assert_allclose(corner(filmed, [plate]), [1.006, 1.006, 1.006, 1], rtol=5e-3)


def as_dict(settings: Renderer) -> dict:
    return {name: getattr(settings, name) for name in settings.__struct_fields__}


def test_in_a_run_each_picture_stands_before_its_own_frame(run, scene, tmp_path):
    films = tmp_path / "film"
    films.mkdir()
    for k in range(3):
        cv2.imwrite(str(films / f"{k}.png"), np.full((4, 6, 3), 60 * (k + 1), np.uint8))
    out = tmp_path / "out"
    drawing = {"scene": scene, "width": 32, "height": 24, "shadow_map": 32}
    _, process = run(
        mode="lossless", out=str(out), capture={"frames": 5}, renderer=drawing, plate={"source": str(films)}, sampler={"count": 2}
    )
    _, errors = process.communicate(timeout=LOADED_S)
    assert process.returncode == 0, errors.decode()
    seen = [read_radiance(out / f"frame_{k:04d}.exr")[0][0, 0, 0] for k in range(5)]
    codes = np.array([60, 120, 180, 60, 120]) / 255  # the film begins again
    np.testing.assert_allclose(seen, ((codes + 0.055) / 1.055) ** 2.4, rtol=1e-2)  # a code more at 60 is 4 % more light
