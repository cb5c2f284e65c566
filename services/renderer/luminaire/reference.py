"""A light field evaluated by its definition, slowly: the reference that the renderer's methods are tested and measured against.

Radiance by equation 5, irradiance by quadrature, and the 2003 approximation point by point, without tables: equation 14 and its error E_r.
"""

import numpy as np

from vemlight.renderer.luminaire.bases import basis
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.shift_invariant import radiance_images

Box = tuple[float, float, float, float]  # x0, x1, y0, y1 in pixels


def basis_weights(field: LightField, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """phi of each column (..., cols) and of each row (..., rows) of basis functions at points u (..., 2) of the sampling plane."""
    u_m, v_m = field.centres_m
    kind, spacing_m = field.basis_kind, field.spacing_m
    return basis(kind, (u[..., 0, None] - u_m) / spacing_m), basis(kind, (u[..., 1, None] - v_m) / spacing_m)


def pixel_at(field: LightField, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row, column, inside) of points s (..., 2) of the measurement plane; rows and columns are clipped to the image."""
    position = (s - np.array(field.window_m[:2])) / np.array(field.pixel_m)
    height, width = field.images.shape[2:4]
    inside = np.all((position >= 0) & (position < (width, height)), axis=-1)
    column, row = (np.clip(position[..., axis], 0, size - 1).astype(np.int64) for axis, size in ((0, width), (1, height)))
    return row, column, inside


def radiance(field: LightField, u: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) float64 along the rays from u to s (..., 2): equation 5, without approximation."""
    row, column, inside = pixel_at(field, s)
    phi_u, phi_v = basis_weights(field, u)
    pixels = np.moveaxis(field.images[:, :, row, column], (0, 1), (-3, -2)).astype(np.float64)
    total = np.einsum("...j,...i,...jic->...c", phi_v, phi_u, pixels)
    tan2 = np.sum((s - u) ** 2, axis=-1) / field.distance_m**2
    return total * (inside * (field.distance_m / field.spacing_m) ** 2 * (1 + tan2) ** 2)[..., None]


def irradiance(field: LightField, point: np.ndarray, normal: np.ndarray | None = None) -> np.ndarray:
    """Irradiance (3,) float64 at `point` (3,), luminaire's frame, on a plane facing `normal` (3,); None: the integral of radiance over
    solid angle.

    Quadrature over U in pieces on which pixels and polynomials do not change: I_m = (delta / z_p)^2 / spacing^2 integral C_m(s(u)) phi_m(u)
    / cos theta du. One formula before, on and between the planes; behind U there is no light.
    """
    depth = float(point[2])
    if depth <= 0:
        return np.zeros(3)
    nodes, weights = zip(*(_axis_nodes(field, point, axis) for axis in (0, 1)), strict=True)
    u = np.stack(np.meshgrid(*nodes), axis=-1)  # (v nodes, u nodes, 2)
    offset = u - point[:2]
    distance = np.sqrt(np.sum(offset**2, axis=-1) + depth**2)
    kernel = weights[1][:, None] * weights[0] * distance / depth
    if normal is not None:
        kernel = kernel * np.maximum((offset @ normal[:2] - depth * normal[2]) / distance, 0)
    s = u + (field.distance_m / depth) * (point[:2] - u)  # equation 7 of Lu et al. 2015 with the `u +` that its print leaves out
    row, column, inside = pixel_at(field, s)
    kernel = kernel * inside
    phi_u, phi_v = (basis(field.basis_kind, (along[:, None] - centres) / field.spacing_m)
                    for along, centres in zip(nodes, field.centres_m, strict=True))
    total = np.zeros(3)
    for j, i in np.ndindex(field.images.shape[:2]):
        a, b = np.flatnonzero(phi_v[:, j]), np.flatnonzero(phi_u[:, i])
        if len(a) and len(b):
            part = slice(a[0], a[-1] + 1), slice(b[0], b[-1] + 1)
            pixels = field.images[j, i][row[part], column[part]].astype(np.float64)
            total += np.einsum("a,b,ab,abc->c", phi_v[part[0], j], phi_u[part[1], i], kernel[part], pixels)
    return total * (field.distance_m / (depth * field.spacing_m)) ** 2


def _axis_nodes(field: LightField, point: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights along u (axis 0) or v (axis 1): four Gauss points between neighbouring knots and pixel edges seen from `point`."""
    centres = field.centres_m[axis]
    low, high = centres[0] - field.half_support_m, centres[-1] + field.half_support_m
    knots = np.arange(round((high - low) / field.spacing_m) * 2 + 1) * (field.spacing_m / 2) + low
    beyond = point[2] - field.distance_m
    edges = field.window_m[axis] + field.pixel_m[axis] * np.arange(field.images.shape[3 - axis] + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = (point[2] * edges - field.distance_m * point[axis]) / beyond
    foot = point[axis] + point[2] * np.arange(-4, 5) / 2  # 1 / cos theta bends within a distance of z_p from the point's foot
    cuts = np.concatenate([knots, seen[np.isfinite(seen)], foot])
    cuts = np.unique(np.clip(cuts, low, high))
    x, w = np.polynomial.legendre.leggauss(4)
    half = np.diff(cuts)[:, None] / 2
    return ((cuts[1:] + cuts[:-1])[:, None] / 2 + half * x).ravel(), (half * w).ravel()


def relative_error(theta: np.ndarray, s: float) -> np.ndarray:
    """E_r at angles theta in rad for a filter s times as wide as the planes are apart (2003, section 3.1, figure 3).

    cos^4 = (1 + x^2)^-2 falls with |x| = tan theta: its extremes over the filter lie at the ends nearest to and farthest from the axis.
    """
    x = np.abs(np.tan(theta))
    near, far = np.maximum(x - s / 2, 0), x + s / 2
    return ((1 + near**2) ** -2 - (1 + far**2) ** -2) * (1 + x**2) ** 2


def spot_irradiance(field: LightField, point: np.ndarray, normal: np.ndarray | None = None) -> np.ndarray:
    """Equation 14 at `point` (3,) for an even receiver: A sum_m f_m(p) mean of E'_m over the support seen from p; (3,) float64.

    normal None: without the receiver's cosine.
    """
    if point[2] <= 0:
        return np.zeros(3)
    images = radiance_images(field)
    total = np.zeros(3)
    for j, i in np.ndindex(images.shape[:2]):
        centre = np.array([field.centres_m[0][i], field.centres_m[1][j]])
        offset = np.append(centre, 0) - point
        r = np.linalg.norm(offset)
        receiver = 1.0 if normal is None else max(float(offset @ normal) / r, 0.0)
        total += (point[2] / r) * receiver / r**2 * mean_over_box(images[j, i], box_on_measurement_plane(field, centre, point))
    return total * field.spacing_m**2


def box_on_measurement_plane(field: LightField, centre: np.ndarray, point: np.ndarray) -> Box:
    """The box of the support round `centre` (2,) as `point` (3,) sees it on S, not clipped, x0 <= x1, y0 <= y1."""
    ends = []
    for axis in (0, 1):
        edge = centre[axis] + np.array([-1, 1]) * field.half_support_m
        s = edge + field.distance_m / point[2] * (point[axis] - edge)
        ends += sorted(((s - field.window_m[axis]) / field.pixel_m[axis]).tolist())
    return ends[0], ends[1], ends[2], ends[3]


def mean_over_box(image: np.ndarray, box: Box) -> np.ndarray:
    """Mean (3,) of an image (height, width, 3) over a box, dark outside the image: the plain sum, without tables."""
    weights = []
    for low, high, n in ((box[2], box[3], image.shape[0]), (box[0], box[1], image.shape[1])):
        i = np.arange(n)
        inside = np.clip(np.minimum(high, i + 1) - np.maximum(low, i), 0, None) / (high - low) if high > low else (i == np.floor(low)) * 1.0
        weights.append(inside)
    return np.einsum("y,x,yxc->c", *weights, image.astype(np.float64))
