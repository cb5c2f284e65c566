"""`[plate]` of a scene file: the picture of a real place that stands behind the scene."""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.light.images import read_radiance
from vemlight.renderer.scene.materials import plate_pixels


class PlateTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[plate]` of a scene file: a picture stretched over the whole picture, taken where the camera stands."""

    file: str
    stops: Annotated[float, Meta(ge=-20, le=20)] = 0.0  # brighter or darker, to fit the lights


def load_plate(table: PlateTable, folder: Path, where: str) -> np.ndarray:
    """The plate's radiance (h, w, 3) float16, row 0 on top. Raises UserError that begins with `where` when there is no such picture."""
    path = folder / table.file
    if path.suffix.lower() in (".exr", ".hdr"):
        pixels = np.nan_to_num(read_radiance(path)[0])
        return (np.clip(pixels, 0, 6e4 / 2**table.stops) * 2**table.stops).astype(np.float16)  # half floats end at 65,504
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise UserError(f"{where}: {path} is none of .exr, .hdr, .png, .jpg; convert it")
    from PIL import Image

    try:
        with Image.open(path) as image:
            return (plate_pixels(image).astype(np.float32) * 2**table.stops).astype(np.float16)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:  # PIL raises SyntaxError for a damaged PNG
        raise UserError(f"{where}: {path} is not a readable picture ({' '.join(str(error).split())[:160]}); check the path") from error
