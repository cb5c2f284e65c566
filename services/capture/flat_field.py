"""How unevenly a lens and its sensor see an evenly lit surface: the flat field that a lens file may name."""

from pathlib import Path

import numpy as np

from vemlight.capture.lens import Lens
from vemlight.errors import UserError
from vemlight.files import contained_path
from vemlight.light.images import read_radiance

FLAT_FIELD_CENTRE = 1 / 20  # of the image's shorter side: radius of the disc whose mean is the axis's response; 1/40 to 1/10 do
MIN_FLAT_FIELD = 1e-3  # of the axis's response: less is noise beyond the rim, and would be divided by; any value up to 0.02 does


def flat_field(lens: Lens, lens_path: Path) -> np.ndarray | None:
    """The image of an evenly lit surface over its value at the axis, (height, width); None where the lens has none.

    Raises UserError for a file that cannot be used.
    """
    if not lens.flat_field:
        return None
    path = contained_path(lens_path.parent, lens.flat_field, f"{lens_path}: flat_field")
    image = read_radiance(path)[0].mean(axis=-1)
    if image.shape != (lens.size[1], lens.size[0]):
        sizes = f"is {image.shape[1]}x{image.shape[0]} and the lens file is for {lens.size[0]}x{lens.size[1]}"
        raise UserError(f"{path}: {sizes}; name the flat field of this lens")
    y, x = np.ogrid[: image.shape[0], : image.shape[1]]
    centre = image[np.hypot(x - lens.c[0], y - lens.c[1]) < max(2, min(lens.size) * FLAT_FIELD_CENTRE)].mean()
    if not (np.all(np.isfinite(image)) and centre > 0):
        raise UserError(f"{path}: is no image of an evenly lit surface; it must be finite, and lit at the optical axis")
    return np.maximum(image / centre, MIN_FLAT_FIELD)
