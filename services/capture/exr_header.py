"""What the headers of our EXR files say beyond the standard's attributes, written and read."""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells

UNIT = 1e-4  # by which a unit vector's length may be off: float32 has 1e-7, and what is longer off was never ours
Axis = Annotated[float, Meta(ge=-1 - UNIT, le=1 + UNIT)]
Part = tuple[Annotated[int, Meta(ge=0)], Axis, Axis, Axis, Annotated[float, Meta(gt=0, le=1)]]
Parts = Annotated[list[Part], Meta(max_length=4096)]  # as many as a message takes


def bright_cells_text(bright: BrightCells) -> str:
    """JSON: [cell, x, y, z, weight] of each sample, in digits that give back every bit."""
    rows = zip(bright.cells.tolist(), *bright.directions.T.tolist(), bright.weights.tolist(), strict=True)
    return msgspec.json.encode(list(rows)).decode()


def bright_cells_from_attributes(name: str, attributes: dict[str, Any], cells: int) -> BrightCells:
    """What `bright_cells_text` wrote as vemlight:strong for a map of so many cells; none where the header does not tell.

    Raises UserError, with the file's `name`, for anything else.
    """
    text = attributes.get("vemlight:strong")
    if text is None:
        return NO_BRIGHT_CELLS
    try:
        rows = msgspec.json.decode(text, type=Parts)
    except (msgspec.DecodeError, TypeError, UnicodeError) as error:
        raise UserError(f"{name}: vemlight:strong in its header: {error}; record again") from error
    if not rows:
        return NO_BRIGHT_CELLS
    cell, centres = np.array([row[0] for row in rows]), np.array([row[1:4] for row in rows])
    if cell.max() >= cells or np.any(np.diff(cell) < 0) or np.any(np.abs(np.linalg.norm(centres, axis=1) - 1) > UNIT):
        raise UserError(f"{name}: vemlight:strong in its header has cells outside the map or directions that are none; record again")
    return BrightCells(cell.astype(np.int64), centres.astype(np.float32), np.array([row[4] for row in rows], np.float32))


def count_from_attributes(attributes: dict[str, Any], key: str) -> int:
    """A count that the header tells, or 0."""
    count = attributes.get(key)
    return count if isinstance(count, int) and count >= 0 else 0


def scale_from_attributes(attributes: dict[str, Any]) -> float | None:
    """cd/m2 per unit of luminance, where the header tells: exactly in ours, by the standard's whiteLuminance (float32) in others'."""
    for key in ("vemlight:luminance_scale", "whiteLuminance"):
        try:
            scale = float(attributes[key])
        except (KeyError, TypeError, ValueError):
            continue
        if 0 < scale < 1e30:
            return scale
    return None
