"""The light field of a luminaire between two planes, and its exact reconstruction (Granier et al. 2003, equations 3 to 5).

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

from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, Kind, basis

Unit = Literal["radiometric", "photometric"]


class LightField(NamedTuple):
    """images: (rows, cols, height, width, 3) float32, Rec. 709; W m^-2, or lx when photometric (then radiance is in cd m^-2, flux in lm).

    first_m: (u, v) of the first basis function. window_m: (s_min, t_min, s_max, t_max).
    """

    images: np.ndarray
    kind: Kind
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
        return self.spacing_m * SUPPORT_CELLS[self.kind] / 2

    @property
    def centres_m(self) -> tuple[np.ndarray, np.ndarray]:
        """u of the columns and v of the rows of basis functions."""
        rows, cols = self.images.shape[:2]
        return self.first_m[0] + self.spacing_m * np.arange(cols), self.first_m[1] + self.spacing_m * np.arange(rows)


def flux(field: LightField) -> np.ndarray:
    """Total flux (3,) float64 through both planes, W (or lm in each channel's share)."""
    return field.images.sum(axis=(0, 1, 2, 3), dtype=np.float64) * (field.pixel_m[0] * field.pixel_m[1])


def basis_weights(field: LightField, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """phi of each column (..., cols) and of each row (..., rows) of basis functions at points u (..., 2) of the sampling plane."""
    u_m, v_m = field.centres_m
    return basis(field.kind, (u[..., 0, None] - u_m) / field.spacing_m), basis(field.kind, (u[..., 1, None] - v_m) / field.spacing_m)


def pixel_at(field: LightField, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row, column, inside) of points s (..., 2) of the measurement plane; rows and columns are clipped to the image."""
    place = (s - np.array(field.window_m[:2])) / np.array(field.pixel_m)
    height, width = field.images.shape[2:4]
    inside = np.all((place >= 0) & (place < (width, height)), axis=-1)
    column, row = (np.clip(place[..., axis], 0, size - 1).astype(np.int64) for axis, size in ((0, width), (1, height)))
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
    off = u - point[:2]
    far = np.sqrt(np.sum(off**2, axis=-1) + depth**2)
    kernel = weights[1][:, None] * weights[0] * far / depth
    if normal is not None:
        kernel = kernel * np.maximum((off @ normal[:2] - depth * normal[2]) / far, 0)
    s = u + (field.distance_m / depth) * (point[:2] - u)  # equation 7 of Lu et al. 2015 with the `u +` that its print leaves out
    row, column, inside = pixel_at(field, s)
    kernel = kernel * inside
    phi_u, phi_v = basis(field.kind, (nodes[0][:, None] - field.centres_m[0]) / field.spacing_m), basis(
        field.kind, (nodes[1][:, None] - field.centres_m[1]) / field.spacing_m)
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


def far_intensity(field: LightField, direction: np.ndarray) -> np.ndarray:
    """Intensity (n, 3), W sr^-1 (cd), far away towards unit vectors (n, 3) with z > 0: the integral of L cos theta over U.

    Along parallel rays s - u is one vector, so image m contributes its mean over the support, weighted by phi, at the support moved by it;
    the midpoint rule takes 16 places a spacing.
    """
    cells = 16
    n = SUPPORT_CELLS[field.kind] * cells
    local = (np.arange(n) + 0.5) / cells - n / (2 * cells)  # spacings
    phi = basis(field.kind, local) * (field.spacing_m / cells)
    height, width = field.images.shape[2:4]
    out = np.zeros((len(np.atleast_2d(direction)), 3))
    for k, d in enumerate(np.atleast_2d(direction)):
        if d[2] <= 0:
            continue
        along = []
        for axis, size in ((0, width), (1, height)):
            s = field.centres_m[axis][:, None] + local * field.spacing_m + field.distance_m * d[axis] / d[2]
            place = (s - field.window_m[axis]) / field.pixel_m[axis]
            pixel = np.clip(place, 0, size - 1).astype(np.int64)
            share = np.zeros((len(s), size))  # of each pixel in the weighted mean
            np.add.at(share, (np.arange(len(s))[:, None], pixel), phi * ((place >= 0) & (place < size)))
            along.append(share)
        total = np.einsum("is,jt,jitsc->c", along[0], along[1], field.images, optimize=True)
        out[k] = total * (field.distance_m / field.spacing_m) ** 2 / d[2] ** 3  # cos theta of the emitter over cos^4 theta
    return out
