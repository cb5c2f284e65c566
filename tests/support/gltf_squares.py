"""Squares of glTF files drawn from above."""

from pathlib import Path

import numpy as np

from tests.support.gltf_files import UPRIGHT, TexturedSquare
from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963
DARK = LightSet.none()
SUN = LightSet.of(np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.full((1, 3), np.pi))
RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)
FOUR_COLOURS = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8)


def drawn(folder: Path, sheet: TexturedSquare, lights: LightSet = DARK, more: str = "", samples: int = 1, side: int = 8) -> np.ndarray:
    """(side, side, 4), the square seen from above with its x to the right and its y upwards."""
    sheet.write(folder / "sheet.gltf")
    (folder / "scene.toml").write_text(ABOVE + '[[mesh]]\nfile = "sheet.gltf"\ny_up = false\n' + more)
    renderer = SceneRenderer(load_scene(folder / "scene.toml"), Settings(width=side, height=side, shadow_map=128), samples)
    picture = renderer.picture(lights).copy()
    renderer.release()
    return picture


def emissive(
    uv: np.ndarray | None = UPRIGHT, pixels: np.ndarray = FOUR_COLOURS, info: dict | None = None, **sampler: int
) -> TexturedSquare:
    """A square that shows an image by its emission alone."""
    sheet = TexturedSquare(uv, emissiveFactor=[1.0, 1.0, 1.0])
    sheet.material["emissiveTexture"] = sheet.image(pixels, info, **sampler)
    return sheet


def corners(picture: np.ndarray) -> list[list[float]]:
    """The colours near the corners: left and right on top, left and right below."""
    last = len(picture) - 2
    return [picture[row, col, :3].round(3).tolist() for row in (1, last) for col in (1, last)]
