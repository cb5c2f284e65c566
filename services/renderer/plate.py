"""Mixed reality: the picture of a real place behind the scene, on which catchers leave the scene's shadows.

Differential rendering (Debevec 1998) in its form for a ground whose colour is unknown: where virtual objects take a share of the light from
a catcher, the plate is darkened by that share.
"""

from pathlib import Path
from typing import Annotated

import moderngl
import msgspec
import numpy as np
from msgspec import Meta

from services.files import BadInput
from services.images import read_radiance
from services.renderer.materials import plate_pixels
from services.renderer.programs import Programs


class PlateTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[plate]` of a scene file: a picture stretched over the whole picture, taken where the camera stands."""

    file: str
    stops: Annotated[float, Meta(ge=-20, le=20)] = 0.0  # brighter or darker, to fit the lights


def load_plate(table: PlateTable, folder: Path, where: str) -> np.ndarray:
    """The plate's radiance (h, w, 3) float16, row 0 on top. Raises BadInput that begins with `where` when there is no such picture."""
    path = folder / table.file
    if path.suffix.lower() in (".exr", ".hdr"):
        pixels = np.nan_to_num(read_radiance(path)[0])
        return (np.clip(pixels, 0, 6e4 / 2**table.stops) * 2**table.stops).astype(np.float16)  # half floats end at 65,504
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise BadInput(f"{where}: {path} is none of .exr, .hdr, .png, .jpg; convert it")
    from PIL import Image

    try:
        with Image.open(path) as image:
            return (plate_pixels(image).astype(np.float32) * 2**table.stops).astype(np.float16)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:  # PIL raises SyntaxError for a damaged PNG
        raise BadInput(f"{where}: {path} is not a readable picture ({' '.join(str(error).split())[:160]}); check the path") from error


class Plate:
    """Puts the plate behind a picture of `size` pixels (width, height) by its alpha."""

    def __init__(self, context: moderngl.Context, programs: Programs, pixels: np.ndarray, size: tuple[int, int]) -> None:
        self._context, self._size = context, size
        self._program = programs.program("screen.vert", "plate.frag")
        self._array = context.vertex_array(self._program, [])
        self._texture = context.texture((pixels.shape[1], pixels.shape[0]), 3, pixels.tobytes(), alignment=1, dtype="f2")
        self._texture.build_mipmaps()
        self._texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        self._texture.repeat_x = self._texture.repeat_y = False

    def draw(self, frame: moderngl.Framebuffer) -> None:
        """Fills what the picture in `frame` leaves open; its alpha becomes 1."""
        self._texture.use(0)
        self._program["plate"] = 0
        self._program["size"] = self._size
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        self._array.release()
        self._texture.release()
