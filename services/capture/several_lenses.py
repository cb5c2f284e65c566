"""Images with the circles of one lens or several, such as the two of a 360 degree camera, each with a lens file for the whole frame.

Where several lenses see a direction, each pixel counts with a weight, and the weights of a direction add up to 1, so that power stays
whole: w_i = t_i / sum t, with t_i falling straight from 1 to 0 over the overlap that ends at the rim.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from vemlight.capture.fisheye import Contributions, FisheyeToPolar, fisheye_contributions, weights_from_contributions
from vemlight.capture.lens import Lens, direction_from_pixel, pixel_angles, pixel_from_direction, vignetting_from_angle
from vemlight.capture.pixel_overlap import Lattice
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.sphere import Coverage, angle_between, angles_from_direction, cell_directions

NARROWEST = math.radians(0.5)  # overlap, for lenses that hardly meet: below, weights would change within a pixel; 0.1 to 2 degrees do
MOST_SHARED = 0.01  # of a circle's pixels that may lie in another's: circles may touch; more is a wrong c or rim_deg


def lenses_to_polar(
    lenses: Sequence[Lens],
    rows: int,
    cols: int,
    coverage: Coverage,
    lattices: tuple[Lattice, ...],
    flat_fields: Sequence[np.ndarray | None],
) -> FisheyeToPolar:
    """Weights from frames of these lenses, all of one size, to the polar map; see `fisheye_to_polar`."""
    height, width = lenses[0].size[1], lenses[0].size[0]
    parts = []
    for lens, flat_field, weight in zip(lenses, flat_fields, lens_weights(lenses), strict=True):
        response = vignetting_from_angle(np.minimum(pixel_angles(lens), lens.rim), lens) if flat_field is None else flat_field
        sensitivity = np.divide(response, weight, out=np.full(response.shape, np.inf), where=weight > 0)
        part = fisheye_contributions(lens, rows, cols, coverage, lattices, sensitivity)
        counts = part.weight > 0
        parts.append(Contributions(*(values[counts] for values in part)))
    joined = Contributions(*map(np.concatenate, zip(*parts, strict=True)))
    return weights_from_contributions((height, width), rows, cols, joined)


def lens_weights(lenses: Sequence[Lens]) -> list[np.ndarray]:
    """For each lens the weights (height, width) of its pixels, 0 to 1 and 0 beyond its rim; 1 inside it for a lens alone."""
    circles = [pixel_angles(lens) / lens.rim for lens in lenses]
    nearest = np.argmin(circles, axis=0)
    return [np.where((nearest == n) & (circle < 1), _weight(lenses, n), 0.0) for n, circle in enumerate(circles)]


def _weight(lenses: Sequence[Lens], n: int) -> np.ndarray:
    """The weight of each pixel of lens n, by what the others see in its direction."""
    if len(lenses) == 1:
        return np.ones((lenses[n].size[1], lenses[n].size[0]))
    lens = lenses[n]
    y, x = np.mgrid[: lens.size[1], : lens.size[0]]
    directions = direction_from_pixel(np.stack([x, y], axis=-1), lens) @ lens.rotation.T
    seen = [_taper(directions, other, _overlap(lenses, m)) for m, other in enumerate(lenses)]
    total = np.sum(seen, axis=0)
    return np.divide(seen[n], total, out=np.zeros_like(total), where=total > 0)


def _taper(directions: np.ndarray, lens: Lens, overlap: float) -> np.ndarray:
    """1 where `lens` alone is to be used, falling to 0 at its rim, and 0 for directions that lie outside its image."""
    in_camera = directions @ lens.rotation
    theta, _ = angles_from_direction(in_camera)
    pixels = pixel_from_direction(in_camera, lens)
    inside = np.all((pixels >= 0) & (pixels <= np.array(lens.size) - 1), axis=-1)
    return np.where(inside, np.clip((lens.rim - theta) / overlap, 0, 1), 0.0)


def _overlap(lenses: Sequence[Lens], n: int) -> float:
    """Angle over which lens n fades: what it has in common with the lens that it has most in common with."""
    axes = [lens.rotation[:, 2] for lens in lenses]
    common = [lenses[n].rim + other.rim - float(angle_between(axes[n], axes[m])) for m, other in enumerate(lenses) if m != n]
    return float(np.clip(max(common), NARROWEST, lenses[n].rim))


def check_lenses(names: Sequence[str], lenses: Sequence[Lens], coverage: Coverage) -> None:
    """Raises UserError, with the lens files' `names`, for circles that lie on each other in the frame; a notice tells of a gap between."""
    if len(lenses) < 2:
        return
    inside = [pixel_angles(lens) < lens.rim for lens in lenses]
    for (a, first), (b, second) in itertools.combinations(enumerate(inside), 2):
        shared = np.count_nonzero(first & second) / max(min(np.count_nonzero(first), np.count_nonzero(second)), 1)
        if shared > MOST_SHARED:
            way_out = "each lens file has its own c in the whole frame; correct c or rim_deg"
            raise UserError(f"{names[a]}, {names[b]}: their circles share {shared:.0%} of their pixels; {way_out}")
    directions = cell_directions(45, 180, coverage)  # of 2 x 2 degrees
    seen = sum(_taper(directions, lens, NARROWEST) > 0 for lens in lenses)
    if not np.all(seen):
        notice(f"{', '.join(names)}: {np.mean(seen == 0):.1%} of the map lies in a gap between the lenses, and is dark")


def directions_of(lenses: Sequence[Lens], pixel: np.ndarray) -> np.ndarray:
    """Unit vectors (m, 3) in the world of pixel coordinates (m, 2), each by the lens in whose circle it lies."""
    off_axis = [np.hypot(*((pixel - lens.c) / lens.f).T) / lens.rim for lens in lenses]
    nearest = np.argmin(off_axis, axis=0)
    directions = np.empty((len(pixel), 3))
    for n, lens in enumerate(lenses):
        directions[nearest == n] = direction_from_pixel(pixel[nearest == n], lens) @ lens.rotation.T
    return directions
