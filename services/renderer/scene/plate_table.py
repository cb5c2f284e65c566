"""`[plate]` of a scene file: a picture of a real place, behind the scene."""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import contained_path, one_line, read_file
from vemlight.light.image_limits import MAX_IMAGE_BYTES
from vemlight.light.images import read_radiance
from vemlight.renderer.scene.textures import open_picture, texels_from_image

MAX_PLATE_RADIANCE = 6e4  # half floats end at 65,504; any value in 32768 .. 65504 does


class PlateTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A picture taken from where the scene's camera stands, stretched over the whole frame."""

    file: str
    stops: Annotated[float, Meta(ge=-20, le=20)] = 0.0  # brighter or darker, to fit the lights


def load_plate(table: PlateTable, folder: Path, where: str) -> np.ndarray:
    """The plate's radiance (h, w, 3) float16, linear, row 0 on top; paths are relative to `folder`.

    nan becomes 0. Raises UserError that begins with `where` when there is no such picture, or it cannot be read.
    """
    path = contained_path(folder, table.file, where)
    if path.suffix.lower() in (".exr", ".hdr"):
        return _half_floats(np.nan_to_num(read_radiance(path)[0]), table.stops)
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise UserError(f"{where}: {path} is none of .exr, .hdr, .png, .jpg; convert it")
    try:
        with open_picture(read_file(path, MAX_IMAGE_BYTES), path) as image:
            pixels = texels_from_image(image)[::-1]
    except UserError as error:
        raise UserError(f"{where}: {error}") from error
    except Exception as error:  # a hostile file raises whatever Pillow trips over: SyntaxError, struct.error, zlib.error and more
        raise UserError(f"{where}: {path} is not a readable picture ({one_line(error)}); check the path") from error
    return _half_floats(pixels.astype(np.float32), table.stops)


def _half_floats(pixels: np.ndarray, stops: float) -> np.ndarray:
    """Pixels made brighter by `stops`, as far as half floats go, (h, w, 3) float16."""
    return np.ascontiguousarray((np.clip(pixels, 0, MAX_PLATE_RADIANCE / 2**stops) * 2**stops).astype(np.float16))
