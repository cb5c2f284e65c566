"""Light fields acquired: from a function of radiance as Granier et al. 2003 measure them, or from rays with their flux.

The filter on the sampling plane is the dual of the basis. A slide cannot be negative, so its positive and its negative part are measured
separately and subtracted, each with the quantisation of the slide and of the camera where that is asked for.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, BasisKind, Dual, dual_value, span_dual
from vemlight.renderer.luminaire.lightfield import LightField, Unit

RAYS_PER_CHUNK = 2**20  # evaluated together: 24 MB of radiance in float64; any value does, it changes memory alone
MIN_FORWARD_Z = 1e-6  # of a ray's direction: what is flatter counts as backward; any value in 1e-9..1e-3 does
MIN_WAIST_Z = 0.05  # cos 87 degrees: flatter rays say nothing of where the source is, and would count 1 / z^2


class AcquisitionPlanes(NamedTuple):
    """The sampling plane and the measurement plane of an acquisition, both centred on the axis.

    rows x cols basis functions; height x width pixels over a window that reaches half_window_m (s, t) from the axis.
    """

    basis_kind: BasisKind
    spacing_m: float
    rows: int
    cols: int
    distance_m: float
    half_window_m: tuple[float, float]
    width: int
    height: int

    @property
    def window_m(self) -> tuple[float, float, float, float]:
        """s_min, t_min, s_max, t_max."""
        s, t = self.half_window_m
        return -s, -t, s, t

    @property
    def half_sampling_m(self) -> tuple[float, float]:
        """Half the extent of all supports along u and v; the functions add up to 1 within it less half a support at each end."""
        edge = SUPPORT_CELLS[self.basis_kind] / 2
        return ((self.cols - 1) / 2 + edge) * self.spacing_m, ((self.rows - 1) / 2 + edge) * self.spacing_m

    def field(self, images: np.ndarray, unit: Unit, name: str) -> LightField:
        """The light field of images (rows, cols, height, width, 3) that were acquired on these planes."""
        first = -(self.cols - 1) / 2 * self.spacing_m, -(self.rows - 1) / 2 * self.spacing_m
        return LightField(images.astype(np.float32), self.basis_kind, self.spacing_m, first, self.distance_m, self.window_m, unit, name)


class Quantisation(NamedTuple):
    """Bits of the slide's transmittance and of the camera's images; 0: none."""

    slide_bits: int = 0
    camera_bits: int = 0


def quantised(values: np.ndarray, peak: float, bits: int) -> np.ndarray:
    """Values in [0, peak] on 2^bits even steps; unchanged for bits = 0 or a peak of 0."""
    steps = 2**bits - 1
    return np.rint(values * (steps / peak)) * (peak / steps) if bits and peak > 0 else values


def field_from_radiance(
    radiance: Callable[[np.ndarray, np.ndarray], np.ndarray], planes: AcquisitionPlanes, dual: Dual, half_source_m: tuple[float, float], *,
    unit: Unit = "radiometric", name: str = "", per_spacing: int = 16, per_pixel: int = 1, quantisation: Quantisation | None = None,
) -> LightField:
    """The light field of `radiance(u, s)`, points (n, 2) of both planes to (n, 3), which is 0 beyond half_source_m along u or v.

    E_m(s) = integral L dual_m(u) cos^4 theta / distance^2 du (2003, equation 2 with a filter without unit), by the midpoint rule with
    per_spacing places a spacing, averaged over per_pixel^2 places a pixel.
    """
    quantisation = quantisation or Quantisation()
    # places on the source, and the filters of all functions there
    axes, filters = [], []
    for count, half in zip((planes.cols, planes.rows), half_source_m, strict=True):
        n = max(int(np.ceil(2 * half / planes.spacing_m * per_spacing)), 1)
        axes.append((np.arange(n) + 0.5) * (2 * half / n) - half)
        centres = (np.arange(count) - (count - 1) / 2)[:, None]
        filters.append(dual_value(dual, axes[-1] / planes.spacing_m - centres))
    u = np.stack(np.meshgrid(*axes), axis=-1)  # (v, u, 2)
    area = (2 * half_source_m[0] / len(axes[0])) * (2 * half_source_m[1] / len(axes[1]))
    slides = _slides(filters[1], filters[0], quantisation.slide_bits)
    # the irradiance behind each slide, a chunk of pixels at a time
    images = np.zeros((len(slides), planes.height * planes.width, planes.rows, planes.cols, 3))
    step = max(RAYS_PER_CHUNK // u[..., 0].size, 1)
    for pixel_points in _pixel_points(planes, per_pixel):
        for first in range(0, len(pixel_points), step):
            irradiance = _irradiance_per_place(radiance, u, pixel_points[first : first + step], planes.distance_m, area)
            for number, slide in enumerate(slides):
                images[number, first : first + step] += np.tensordot(irradiance, slide, axes=((1, 2), (2, 3))).transpose(0, 2, 3, 1)
    images /= per_pixel**2
    signed = sum(sign * _photographed(image, quantisation.camera_bits) for sign, image in zip((1, -1), images, strict=False))
    stacked = np.asarray(signed).transpose(1, 2, 0, 3).reshape(planes.rows, planes.cols, planes.height, planes.width, 3)
    return planes.field(stacked, unit, name)


def _irradiance_per_place(radiance: Callable, u: np.ndarray, s: np.ndarray, distance_m: float, area: float) -> np.ndarray:
    """Irradiance (n, v, u, 3) at points s (n, 2) of the measurement plane from each place u (v, u, 2) with its area."""
    rays_u = np.broadcast_to(u, (len(s), *u.shape))
    rays_s = np.broadcast_to(s[:, None, None], rays_u.shape)
    tan2 = np.sum((rays_s - rays_u) ** 2, axis=-1) / distance_m**2
    value = radiance(rays_u.reshape(-1, 2), rays_s.reshape(-1, 2)).reshape(*tan2.shape, 3)
    return value * (area / (distance_m**2 * (1 + tan2) ** 2))[..., None]


def _slides(along_v: np.ndarray, along_u: np.ndarray, bits: int) -> list[np.ndarray]:
    """Transmittance (rows, cols, v, u) of the positive and the negative part of the filters; one signed slide when none is quantised."""
    product = along_v[:, None, :, None] * along_u[None, :, None, :]
    if not bits:
        return [product]
    peak = float(np.abs(product).max())
    return [quantised(np.maximum(sign * product, 0), peak, bits) for sign in (1, -1)]


def _photographed(images: np.ndarray, bits: int) -> np.ndarray:
    """Images (pixels, rows, cols, 3) as a camera of `bits` bits records them, exposed for the brightest pixel of all."""
    return quantised(images, float(np.abs(images).max()), bits)


def _pixel_points(planes: AcquisitionPlanes, per_pixel: int) -> list[np.ndarray]:
    """For each of per_pixel^2 places within a pixel the points (height * width, 2) on S."""
    low_s, low_t, high_s, high_t = planes.window_m
    step_s, step_t = (high_s - low_s) / planes.width, (high_t - low_t) / planes.height
    points = []
    for a, b in np.ndindex(per_pixel, per_pixel):
        s = low_s + (np.arange(planes.width) + (a + 0.5) / per_pixel) * step_s
        t = low_t + (np.arange(planes.height) + (b + 0.5) / per_pixel) * step_t
        points.append(np.stack(np.meshgrid(s, t), axis=-1).reshape(-1, 2))
    return points


class Rays(NamedTuple):
    """positions (n, 3) in metres and unit directions (n, 3), luminaire's frame; flux (n, 3), in Rec. 709 channels, W or lm."""

    positions: np.ndarray
    directions: np.ndarray
    flux: np.ndarray


class FluxBudget(NamedTuple):
    """Where the flux of a set of rays went, in the unit of the rays' luminance: total is the sum of the others.

    captured: what the light field holds. backward: rays away from the planes. outside_sampling_plane, outside_measurement_plane: rays
    beyond the extent of U and, of the rest, of S. filter_tails: what the filters of functions outside the grid would have taken of the
    rays on both planes.
    """

    total: float
    captured: float
    backward: float
    outside_sampling_plane: float
    outside_measurement_plane: float
    filter_tails: float


def field_from_rays(rays: Rays, planes: AcquisitionPlanes, plane_z_m: float, unit: Unit, name: str) -> tuple[LightField, FluxBudget]:
    """Projects rays through U at z = plane_z_m and S: each adds flux dual_m(u) / pixel area to image m; the sum over m preserves flux."""
    flux = luminance_from_rgb(rays.flux)
    forward = rays.directions[:, 2] > MIN_FORWARD_Z
    slope = rays.directions[forward, :2] / rays.directions[forward, 2:]
    u = rays.positions[forward, :2] + (plane_z_m - rays.positions[forward, 2:]) * slope
    s = u + planes.distance_m * slope
    on_sampling = np.all(np.abs(u) < np.array(planes.half_sampling_m), axis=-1)
    size = np.array([planes.width, planes.height])
    pixel_xy = np.floor((s / np.array(planes.half_window_m) + 1) / 2 * size).astype(np.int64)
    on_both = on_sampling & np.all((pixel_xy >= 0) & (pixel_xy < size), axis=-1)
    # each ray's flux goes to its pixel of every image, through that image's filter
    dual = span_dual(planes.basis_kind)
    along = [dual_value(dual, u[on_both, axis, None] / planes.spacing_m - (np.arange(n) - (n - 1) / 2))
             for axis, n in enumerate((planes.cols, planes.rows))]
    carried, pixel = rays.flux[forward][on_both], pixel_xy[on_both, 1] * planes.width + pixel_xy[on_both, 0]
    area = 4 * planes.half_window_m[0] * planes.half_window_m[1] / (planes.width * planes.height)
    images = np.empty((planes.rows, planes.cols, planes.height * planes.width, 3))
    for j, i, c in np.ndindex(planes.rows, planes.cols, 3):
        weights = along[1][:, j] * along[0][:, i] * carried[:, c]
        images[j, i, :, c] = np.bincount(pixel, weights, minlength=planes.width * planes.height) / area
    field = planes.field(images.reshape(planes.rows, planes.cols, planes.height, planes.width, 3), unit, name)
    ahead, captured = flux[forward], float(luminance_from_rgb(images.sum(axis=(0, 1, 2)) * area))
    return field, FluxBudget(
        total=float(flux.sum()), captured=captured, backward=float(flux[~forward].sum()),
        outside_sampling_plane=float(ahead[~on_sampling].sum()), outside_measurement_plane=float(ahead[on_sampling & ~on_both].sum()),
        filter_tails=float(ahead[on_both].sum()) - captured,
    )


def waist_z_m(rays: Rays) -> float:
    """Height of the plane where the beam of rays is narrowest: where the flux-weighted variance of their crossings is smallest."""
    forward = (rays.directions[:, 2] > MIN_WAIST_Z) & (rays.flux.sum(axis=-1) > 0)
    if not forward.any():
        return 0.0
    weight = rays.flux[forward].sum(axis=-1)
    slope = rays.directions[forward, :2] / rays.directions[forward, 2:]
    at_zero = rays.positions[forward, :2] - rays.positions[forward, 2:] * slope
    a = at_zero - np.average(at_zero, axis=0, weights=weight)
    b = slope - np.average(slope, axis=0, weights=weight)
    covariance, variance = (np.average(np.sum(product, axis=-1), axis=0, weights=weight) for product in (a * b, b * b))
    return float(-covariance / max(variance, 1e-12))
