"""The light field of a luminaire between two planes (Granier et al. 2003, equations 3 to 5).

In the luminaire's own frame light travels towards +z: the sampling plane U is z = 0, the measurement plane S is z = distance_m. Image
[j, i] belongs to the basis function centred at u = first_m + spacing_m (i, j); its pixel [row, column] covers a rectangle of S, row along
t (y) and column along s (x), both upwards from the window's lower corner. A pixel holds the irradiance behind the filter of its basis
function, whose transmittance has no unit, so that

    L(u -> s) = distance^2 / (spacing^2 cos^4 theta) sum_m phi_m(u) C_m(s),

the sum of all images is the irradiance on S, and its integral over S is the flux. (Equation 3's R^2 / cos^2 theta is distance^2 /
cos^4 theta. Lu et al. 2015 print delta^2 cos^4 theta, which is upside down for these images.)
"""

from typing import Literal, NamedTuple

import numpy as np

from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, BasisKind, basis

Unit = Literal["radiometric", "photometric"]
PLACES_PER_SPACING = 16  # of the midpoint rule in far_intensity; any value in 8..64 does: the basis varies over a spacing


class LightField(NamedTuple):
    """images: (rows, cols, height, width, 3) float32, Rec. 709; W m^-2, or lx when photometric (then radiance is in cd m^-2, flux in lm).

    first_m: (u, v) of the first basis function. window_m: (s_min, t_min, s_max, t_max).
    """

    images: np.ndarray
    basis_kind: BasisKind
    spacing_m: float
    first_m: tuple[float, float]
    distance_m: float
    window_m: tuple[float, float, float, float]
    unit: Unit
    name: str

    @property
    def pixel_m(self) -> tuple[float, float]:
        """Width and height of a pixel on S."""
        height, width = self.images.shape[2:4]
        return (self.window_m[2] - self.window_m[0]) / width, (self.window_m[3] - self.window_m[1]) / height

    @property
    def half_support_m(self) -> float:
        """Half the width of a basis function's support on U."""
        return self.spacing_m * SUPPORT_CELLS[self.basis_kind] / 2

    @property
    def centres_m(self) -> tuple[np.ndarray, np.ndarray]:
        """u of the columns and v of the rows of basis functions."""
        rows, cols = self.images.shape[:2]
        return self.first_m[0] + self.spacing_m * np.arange(cols), self.first_m[1] + self.spacing_m * np.arange(rows)


def flux(field: LightField) -> np.ndarray:
    """Total flux (3,) float64 through both planes, W or lm, in Rec. 709 channels whose luminance is the flux."""
    return field.images.sum(axis=(0, 1, 2, 3), dtype=np.float64) * (field.pixel_m[0] * field.pixel_m[1])


def far_intensity(field: LightField, direction: np.ndarray) -> np.ndarray:
    """Intensity (n, 3), W sr^-1 (cd), far away towards unit vectors (n, 3) with z > 0: the integral of L cos theta over U.

    Along parallel rays s - u is one vector, so image m contributes its mean, weighted by phi, over the support moved by that vector; by the
    midpoint rule.
    """
    n = SUPPORT_CELLS[field.basis_kind] * PLACES_PER_SPACING
    local = (np.arange(n) + 0.5) / PLACES_PER_SPACING - n / (2 * PLACES_PER_SPACING)  # spacings
    phi = basis(field.basis_kind, local) * (field.spacing_m / PLACES_PER_SPACING)
    height, width = field.images.shape[2:4]
    out = np.zeros((len(np.atleast_2d(direction)), 3))
    for k, d in enumerate(np.atleast_2d(direction)):
        if d[2] <= 0:
            continue
        along = []
        for axis, size in ((0, width), (1, height)):
            s = field.centres_m[axis][:, None] + local * field.spacing_m + field.distance_m * d[axis] / d[2]
            position = (s - field.window_m[axis]) / field.pixel_m[axis]
            pixel = np.clip(position, 0, size - 1).astype(np.int64)
            weights = np.zeros((len(s), size))  # of each pixel in the mean
            np.add.at(weights, (np.arange(len(s))[:, None], pixel), phi * ((position >= 0) & (position < size)))
            along.append(weights)
        total = np.einsum("is,jt,jitsc->c", along[0], along[1], field.images, optimize=True)
        out[k] = total * (field.distance_m / field.spacing_m) ** 2 / d[2] ** 3  # cos theta of the emitter over cos^4 theta
    return out
