"""The shift-invariant approximation of Granier et al. 2003 (section 3) and the bound that says where it is good enough.

Over the support of a basis function the geometric term cos^4 theta is held at its value for the support's centre: each function then is one
textured spot light at its centre, and a shaded point needs one mean of its image instead of samples.
"""

import numpy as np

from vemlight.renderer.luminaire.lightfield import LightField

GOOD_ENOUGH = 0.08  # of the radiance: what 2003 accepts (figure 3, a filter of 0.04 of the distance between the planes)


def relative_error(theta_0: np.ndarray, s: float) -> np.ndarray:
    """E_r at angles theta_0 in rad for a filter s times as wide as the planes are apart (2003, section 3.1, figure 3).

    cos^4 = (1 + x^2)^-2 falls with |x| = tan theta: its extremes over the filter lie at the ends nearest to and farthest from the axis.
    """
    x = np.abs(np.tan(theta_0))
    near, far = np.maximum(x - s / 2, 0), x + s / 2
    return ((1 + near**2) ** -2 - (1 + far**2) ** -2) * (1 + x**2) ** 2


def error_bound(field: LightField) -> float:
    """The largest E_r of a luminaire: over all functions and the pixels that hold more than 10^-3 of its brightest, square supports.

    Darker pixels are left out because what they hold cannot be seen beside the others.
    """
    strength = np.abs(field.images).max(axis=-1)
    half = field.half_support_m
    axes = [field.window_m[k] + field.pixel_m[k] * (np.arange(field.images.shape[3 - k]) + 0.5) for k in (0, 1)]
    worst = 0.0
    for j, i in np.ndindex(field.images.shape[:2]):
        lit = strength[j, i] > 1e-3 * strength.max()
        if lit.any():
            off = [np.abs(axis - centres[k]) for axis, centres, k in zip(axes, field.centres_m, (i, j), strict=True)]
            terms = []
            for change in (-half, 0.0, half):
                x, y = (np.maximum(o + change, 0) / field.distance_m for o in off)
                terms.append((1 + y[:, None] ** 2 + x**2) ** -2)
            worst = max(worst, float(((terms[0] - terms[2]) / terms[1])[lit].max()))
    return worst


def good_enough(field: LightField, tolerance: float = GOOD_ENOUGH) -> bool:
    """True where the approximation stays within `tolerance`: model no more than needed."""
    return error_bound(field) <= tolerance


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


def irradiance(field: LightField, point: np.ndarray, normal: np.ndarray | None = None) -> np.ndarray:
    """Equation 14 at `point` (3,) for an even receiver: A sum_m f_m(p) mean of E'_m over the support seen from p; (3,) float64.

    normal None: without the receiver's cosine.
    """
    from vemlight.renderer.luminaire.tables import box_on_measurement_plane, mean_over_box

    if point[2] <= 0:
        return np.zeros(3)
    images = radiance_images(field)
    total = np.zeros(3)
    for j, i in np.ndindex(images.shape[:2]):
        centre = np.array([field.centres_m[0][i], field.centres_m[1][j]])
        off = np.append(centre, 0) - point
        r = np.linalg.norm(off)
        receiver = 1.0 if normal is None else max(float(off @ normal) / r, 0.0)
        mean = mean_over_box(images[j, i], box_on_measurement_plane(field, centre, point))
        total += (point[2] / r) * receiver / r**2 * mean
    return total * field.spacing_m**2
