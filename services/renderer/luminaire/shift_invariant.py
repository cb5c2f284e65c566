"""The shift-invariant approximation of Granier et al. 2003 (section 3) and the bound of its error.

Over the support of a basis function the geometric term cos^4 theta is replaced by its value for the support's centre: each function then is
one textured spot light at its centre, and a shaded point needs one mean of its image instead of samples.
"""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.luminaire.lightfield import LightField

MAX_RELATIVE_ERROR = 0.08  # of the radiance: what 2003 accepts (figure 3, a filter of 0.04 of the distance between the planes)
VISIBLE = 1e-3  # of the brightest pixel: the bound leaves out what is darker, which cannot be seen next to the rest


class DrawnBy(NamedTuple):
    """How a light field is drawn, and the relative RMS errors of both methods; nan where they were not needed."""

    shift_invariant: bool
    samples: int
    shift_invariant_error: float = float("nan")
    sampling_error: float = float("nan")


def error_bound(field: LightField) -> float:
    """The largest relative error E_r of the approximation, over all functions and their visible pixels, for square supports.

    cos^4 = (1 + tan^2)^-2 falls with the distance from a support's foot on S, so its extremes lie at the ends nearest and farthest.
    """
    strength = np.abs(field.images).max(axis=-1)
    half = field.half_support_m
    axes = [field.window_m[k] + field.pixel_m[k] * (np.arange(field.images.shape[3 - k]) + 0.5) for k in (0, 1)]
    bound = 0.0
    for j, i in np.ndindex(field.images.shape[:2]):
        visible = strength[j, i] > VISIBLE * strength.max()
        if visible.any():
            offsets = [np.abs(axis - centres[k]) for axis, centres, k in zip(axes, field.centres_m, (i, j), strict=True)]
            nearest, centre, farthest = (_geometric_term(offsets, change, field.distance_m) for change in (-half, 0.0, half))
            bound = max(bound, float(((nearest - farthest) / centre)[visible].max()))
    return bound


def _geometric_term(offsets: list[np.ndarray], change_m: float, distance_m: float) -> np.ndarray:
    """cos^4 theta (height, width) at offsets (width,) and (height,) between the planes that are changed by change_m."""
    x, y = (np.maximum(offset + change_m, 0) / distance_m for offset in offsets)
    return (1 + y[:, None] ** 2 + x**2) ** -2


def is_shift_invariant(field: LightField) -> bool:
    """True where the approximation's error is within MAX_RELATIVE_ERROR."""
    return error_bound(field) <= MAX_RELATIVE_ERROR


def radiance_images(field: LightField) -> np.ndarray:
    """E' (rows, cols, height, width, 3) float32: the images divided by the geometric term at each function's centre (equations 9, 10).

    With a box filter on S the deconvolution is a division: L(u -> s) is about sum_m phi_m(u) E'_m(s) (equation 11).
    """
    low_s, low_t = field.window_m[:2]
    height, width = field.images.shape[2:4]
    s = low_s + field.pixel_m[0] * (np.arange(width) + 0.5) - field.centres_m[0][:, None]
    t = low_t + field.pixel_m[1] * (np.arange(height) + 0.5) - field.centres_m[1][:, None]
    tan2 = (s[None, :, None, :] ** 2 + t[:, None, :, None] ** 2) / field.distance_m**2
    return (field.images * ((field.distance_m / field.spacing_m) ** 2 * (1 + tan2) ** 2)[..., None]).astype(np.float32)
