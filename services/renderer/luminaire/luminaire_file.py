"""A luminaire as a file: one multi-part OpenEXR, a part for each image, with the geometry as JSON in the first part's header.

Parts are named image_ROW_COLUMN in the order of the basis functions; in each, the first scanline is the highest t, so that other programs
show the image as a camera behind the measurement plane would be held: t up, s to the right.
"""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import decoded_json, written_whole
from vemlight.light.exr import read_parts
from vemlight.light.image_limits import LIMITS
from vemlight.light.primaries import REC709
from vemlight.renderer.luminaire.bases import BasisKind
from vemlight.renderer.luminaire.lightfield import LightField, Unit

HEADER_ATTRIBUTE = "vemlight:luminaire"
MAX_IMAGES = 1024  # each is a part of the file; the largest published light field has 99
Length = Annotated[float, Meta(gt=0, le=1e3)]  # metres
Coordinate = Annotated[float, Meta(ge=-1e3, le=1e3)]
Count = Annotated[int, Meta(ge=1, le=MAX_IMAGES)]


class LuminaireHeader(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The header attribute of a luminaire file: the geometry of its light field."""

    schema: Literal["vemlight.luminaire/1"] = "vemlight.luminaire/1"
    name: str
    basis: BasisKind
    rows: Count
    cols: Count
    spacing_m: Length
    first_m: tuple[Coordinate, Coordinate]
    distance_m: Length
    window_m: tuple[Coordinate, Coordinate, Coordinate, Coordinate]
    unit: Unit


def write_luminaire(path: Path, field: LightField) -> None:
    """Writes the light field as .exr: images in float16 as they are, all others in 32-bit float.

    Raises UserError for another suffix, OSError when the disk refuses.
    """
    import OpenEXR

    if path.suffix.lower() != ".exr":
        raise UserError(f"{path}: a luminaire is written as .exr; change the suffix")
    rows, cols = field.images.shape[:2]
    text = msgspec.json.encode({"schema": "vemlight.luminaire/1", **msgspec.structs.asdict(header_of(field))}).decode()
    dtype = np.float16 if field.images.dtype == np.float16 else np.float32
    parts = []
    for j, i in np.ndindex(rows, cols):
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "chromaticities": REC709,
                  "colorInteropID": "lin_rec709_scene"}
        if not parts:
            header[HEADER_ATTRIBUTE] = text
        pixels = np.ascontiguousarray(field.images[j, i, ::-1], dtype)
        parts.append(OpenEXR.Part(header, {"RGB": pixels}, f"image_{j}_{i}"))
    with written_whole(path) as part:
        try:
            OpenEXR.File(parts).write(str(part))
        except RuntimeError as error:
            raise OSError(f"{path}: {' '.join(str(error).split())[:200]}") from error


def header_of(field: LightField) -> LuminaireHeader:
    """The header of a light field's file."""
    rows, cols = field.images.shape[:2]
    return LuminaireHeader(name=field.name, basis=field.basis_kind, rows=rows, cols=cols, spacing_m=field.spacing_m, first_m=field.first_m,
                           distance_m=field.distance_m, window_m=field.window_m, unit=field.unit)


def read_luminaire(path: Path) -> LightField:
    """The light field in a file written by `write_luminaire` or by another program with the same header.

    Raises UserError, naming file and fault, for anything else: no EXR, no header, unknown keys, an empty window, a missing part, parts of
    different sizes, too many pixels, nan or inf.
    """
    if path.suffix.lower() != ".exr":
        raise UserError(f"{path}: lamps are read from .exr, .ies and .ldt; name one of these")
    parts = _parts(path)
    header = parts[0][1].get(HEADER_ATTRIBUTE)
    if not isinstance(header, str):
        raise UserError(f"{path}: is an EXR without the attribute {HEADER_ATTRIBUTE}; make a luminaire with `vemlight luminaire`")
    try:
        geometry = decoded_json(header, LuminaireHeader)
    except ValueError as error:
        raise UserError(f"{path}: {HEADER_ATTRIBUTE}: {error}; write it again with `vemlight luminaire`") from error
    low_s, low_t, high_s, high_t = geometry.window_m
    if not (low_s < high_s and low_t < high_t):
        raise UserError(f"{path}: {HEADER_ATTRIBUTE}: window_m {geometry.window_m} is empty; write s_min, t_min, s_max, t_max")
    if geometry.rows * geometry.cols > MAX_IMAGES:
        grid = f"{geometry.rows} x {geometry.cols}"
        raise UserError(f"{path}: {HEADER_ATTRIBUTE}: {grid} images are more than {MAX_IMAGES}; measure it with fewer")
    named = {name: pixels for name, _, pixels in parts}
    images = []
    for j, i in np.ndindex(geometry.rows, geometry.cols):
        pixels = named.get(f"image_{j}_{i}")
        if pixels is None or pixels.ndim != 3 or pixels.shape[2] != 3:
            grid = f"{geometry.rows} x {geometry.cols}"
            raise UserError(f"{path}: has no RGB part image_{j}_{i} of the {grid} that its header announces; copy it again")
        if images and pixels.shape != images[0].shape:
            raise UserError(f"{path}: part image_{j}_{i} is {pixels.shape[1]} x {pixels.shape[0]} and the first is "
                           f"{images[0].shape[1]} x {images[0].shape[0]}; write all parts in one size")
        images.append(pixels)
    if geometry.rows * geometry.cols * images[0].size > 3 * LIMITS.pixels:
        raise UserError(f"{path}: holds more than {LIMITS.pixels} pixels; make the images smaller")
    stack = np.stack([pixels[::-1] for pixels in images]).astype(np.float32)
    if not np.all(np.isfinite(stack)):
        raise UserError(f"{path}: {np.count_nonzero(~np.isfinite(stack))} values are nan or inf; measure it again or repair the images")
    stack = stack.reshape(geometry.rows, geometry.cols, *images[0].shape)
    return LightField(stack, geometry.basis, geometry.spacing_m, geometry.first_m, geometry.distance_m, geometry.window_m, geometry.unit,
                      geometry.name)


def _parts(path: Path) -> list[tuple[str, dict, np.ndarray]]:
    """(name, attributes, RGB pixels) of each part of an EXR."""
    found = [(part.name(), dict(part.header), part.channels["RGB"].pixels if "RGB" in part.channels else np.zeros(0))
             for part in read_parts(path)[:MAX_IMAGES]]
    if not found:
        raise UserError(f"{path}: is not a readable EXR (no image in it); it may be truncated, copy it again")
    return found
