"""Our own attributes in EXR headers, in addition to the standard's: written and read."""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import decoded_json
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.runtime.wire_fields import Lux

BRIGHT_CELLS = "vemlight:bright_cells"
OLD_BRIGHT_CELLS = "vemlight:strong"  # the same, in recordings of version 1
# By how much the length of a unit vector may differ from 1. float32 leaves 1e-7, and other writers may round to five digits; what
# differs more was never a direction. Any value from 1e-5 to 1e-2 does.
UNIT_TOLERANCE = 1e-4
ESTIMATED_LUX = "vemlight:estimated_lux"
MAX_LUMINANCE_SCALE = 1e30  # cd/m2 per unit: products with it stay finite in float32
Coordinate = Annotated[float, Meta(ge=-1 - UNIT_TOLERANCE, le=1 + UNIT_TOLERANCE)]
Sample = tuple[Annotated[int, Meta(ge=0)], Coordinate, Coordinate, Coordinate, Annotated[float, Meta(gt=0, le=1)]]
Samples = Annotated[list[Sample], Meta(max_length=4096)]  # as many as a message takes


def bright_cells_text(bright_cells: BrightCells) -> str:
    """JSON: [cell, x, y, z, weight] of each sub-cell sample, in digits that preserve every bit."""
    cells, centres, weights = bright_cells
    rows = zip(cells.tolist(), *centres.T.tolist(), weights.tolist(), strict=True)
    return msgspec.json.encode(list(rows)).decode()


def bright_cells_from_attributes(name: str, attributes: dict[str, Any], cells: int) -> BrightCells:
    """Reads what `bright_cells_text` wrote for a map of so many cells; none where the header has no such attribute.

    Raises UserError, with the file's `name`, for anything else.
    """
    text = attributes.get(BRIGHT_CELLS, attributes.get(OLD_BRIGHT_CELLS))
    if text is None:
        return NO_BRIGHT_CELLS
    try:
        rows = decoded_json(text, Samples)
    except (ValueError, TypeError) as error:
        raise UserError(f"{name}: {BRIGHT_CELLS} in its header: {error}; record again") from error
    if not rows:
        return NO_BRIGHT_CELLS
    cell, centres = np.array([row[0] for row in rows]), np.array([row[1:4] for row in rows])
    lengths = np.linalg.norm(centres, axis=1)
    if cell.max() >= cells or np.any(np.diff(cell) < 0) or np.any(np.abs(lengths - 1) > UNIT_TOLERANCE):
        raise UserError(f"{name}: {BRIGHT_CELLS} in its header has cells outside the map or invalid directions; record again")
    return BrightCells(cell.astype(np.int64), centres.astype(np.float32), np.array([row[4] for row in rows], np.float32))


def count_from_attributes(attributes: dict[str, Any], key: str) -> int:
    """A count in the header; 0 where there is none."""
    count = attributes.get(key)
    return count if isinstance(count, int) and count >= 0 else 0


def estimate_from_attributes(attributes: dict[str, Any]) -> float:
    """Illuminance of clipped light that was estimated, lux; 0 where there is none."""
    try:
        return msgspec.convert(attributes.get(ESTIMATED_LUX, 0.0), Lux, strict=False)
    except ValueError:
        return 0.0


def scale_from_attributes(attributes: dict[str, Any]) -> float | None:
    """cd/m2 per unit of luminance, if known: exactly in our files, by the standard's whiteLuminance (float32) in those of others."""
    for key in ("vemlight:luminance_scale", "whiteLuminance"):
        try:
            scale = float(attributes[key])
        except (KeyError, TypeError, ValueError):
            continue
        if 0 < scale < MAX_LUMINANCE_SCALE:
            return scale
    return None
