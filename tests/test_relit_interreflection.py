"""What surfaces show of and send to each other in the browser's pictures, beside the renderer's, which follow rays of their own."""

import numpy as np
import pytest

from tests.support.browser import CHROMIUM
from tests.support.relit_comparison import lights_of
from tests.support.relit_page import RelitPage
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
DRAWING = Renderer(width=160, height=120, shadows="maps", bounces=1, frame_ms=0.0)
RED_FLOOR = """
[camera]
from = [0.0, -4.0, 1.0]
at = [0.0, 0.0, 1.0]
fov_y = 40.0

[[mesh]]
name = "floor"
shape = "plane"
scale = 4.0
material = {diffuse = [0.6, 0.02, 0.02]}

[[mesh]]
name = "ball"
shape = "sphere"
at = [0.0, 0.0, 1.0]
material = {base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.05}
"""


@pytest.fixture
def opened(tmp_path, software_gl_browser):
    """Opens a scene of a text in a page."""
    page = software_gl_browser.new_page()

    def open_scene(text: str, drawing: Renderer = DRAWING):
        (tmp_path / "scene.toml").write_text(text)
        scene = load_scene(tmp_path / "scene.toml")
        return scene, RelitPage(page, scene, drawing)

    yield open_scene
    page.close()


def test_a_mirror_over_a_red_floor_is_red_below(opened):
    _, page = opened(RED_FLOOR)
    picture = page.picture(lights_of(24))
    ball = picture[66:84, 70:90].reshape(-1, 3)  # below the horizon that it mirrors, above its contact
    assert (ball[:, 0] > 0).all()
    # Red over green of the floor is 30; each lamp's own image in the ball adds white.
    assert np.median(ball[:, 0] / np.maximum(ball[:, 1], 1e-9)) > 15
