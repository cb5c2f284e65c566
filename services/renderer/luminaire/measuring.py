"""Light fields measured: from a function of radiance as Granier et al. 2003 acquire them, or from rays with their flux.

The filter on the sampling plane is the dual of the basis. A slide cannot be negative, so its positive and its negative part are measured
apart and subtracted, each with the steps of the slide and of the camera where these are asked for.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, Dual, Kind, dual_value, span_dual
from vemlight.renderer.luminaire.lightfield import LightField, Unit

CHUNK = 2**20  # rays evaluated together: 24 MB of radiance in float64


class Planes(NamedTuple):
    """The two planes of a measurement, centred on the axis: rows x cols basis functions, height x width pixels of a window half_window_m
    (s, t) wide to each side."""

    kind: Kind
    spacing_m: float
    rows: int
    cols: int
    distance_m: float
    half_window_m: tuple[float, float]
    width: int
    height: int

    @property
    def window_m(self) -> tuple[float, float, float, float]:
        s, t = self.half_window_m
        return -s, -t, s, t

    @property
    def half_sampling_m(self) -> tuple[float, float]:
        """Half the extent along u and v in which the functions reach: the sum of all is 1 within it less a support's half at each end."""
        edge = SUPPORT_CELLS[self.kind] / 2
        return ((self.cols - 1) / 2 + edge) * self.spacing_m, ((self.rows - 1) / 2 + edge) * self.spacing_m

    def field(self, images: np.ndarray, unit: Unit, name: str) -> LightField:
        first = -(self.cols - 1) / 2 * self.spacing_m, -(self.rows - 1) / 2 * self.spacing_m
        return LightField(images.astype(np.float32), self.kind, self.spacing_m, first, self.distance_m, self.window_m, unit, name)


class Equipment(NamedTuple):
    """What the bench measures with. slide_bits, camera_bits: steps of the transmittance and of each image (0: none)."""

    slide_bits: int = 0
    camera_bits: int = 0


def rounded(values: np.ndarray, peak: float, bits: int) -> np.ndarray:
    """Values in [0, peak] on 2^bits even steps; as they are for bits = 0 or a peak of 0."""
    steps = 2**bits - 1
    return np.rint(values * (steps / peak)) * (peak / steps) if bits and peak > 0 else values


def field_from_radiance(
    radiance: Callable[[np.ndarray, np.ndarray], np.ndarray], planes: Planes, dual: Dual, half_source_m: tuple[float, float], *,
    unit: Unit = "radiometric", name: str = "", per_spacing: int = 16, per_pixel: int = 1, equipment: Equipment | None = None,
) -> LightField:
    """The light field of `radiance(u, s)`, points (n, 2) of both planes to (n, 3), which is 0 beyond half_source_m along u or v.

    E_m(s) = integral L dual_m(u) cos^4 theta / distance^2 du (2003, equation 2 with a filter without unit), by the midpoint rule with
    per_spacing places a spacing, averaged over per_pixel^2 places a pixel.
    """
    equipment = equipment or Equipment()
    axes, filters = [], []
    for count, half in zip((planes.cols, planes.rows), half_source_m, strict=True):
        n = max(int(np.ceil(2 * half / planes.spacing_m * per_spacing)), 1)
        axes.append((np.arange(n) + 0.5) * (2 * half / n) - half)
        centres = (np.arange(count) - (count - 1) / 2)[:, None]
        filters.append(dual_value(dual, axes[-1] / planes.spacing_m - centres))
    u = np.stack(np.meshgrid(*axes), axis=-1)  # (v, u, 2)
    area = (2 * half_source_m[0] / len(axes[0])) * (2 * half_source_m[1] / len(axes[1]))
    slides = _slides(filters[1], filters[0], equipment.slide_bits)
    images = np.zeros((len(slides), planes.height * planes.width, planes.rows, planes.cols, 3))
    step = max(CHUNK // u[..., 0].size, 1)
    for places in _pixel_places(planes, per_pixel):
        for first in range(0, len(places), step):
            s = places[first : first + step]
            rays_u = np.broadcast_to(u, (len(s), *u.shape))
            rays_s = np.broadcast_to(s[:, None, None], rays_u.shape)
            tan2 = np.sum((rays_s - rays_u) ** 2, axis=-1) / planes.distance_m**2
            value = radiance(rays_u.reshape(-1, 2), rays_s.reshape(-1, 2)).reshape(*tan2.shape, 3)
            value = value * (area / (planes.distance_m**2 * (1 + tan2) ** 2))[..., None]
            for number, slide in enumerate(slides):
                images[number, first : first + step] += np.tensordot(value, slide, axes=((1, 2), (2, 3))).transpose(0, 2, 3, 1)
    images /= per_pixel**2
    signed = sum(sign * _photographed(image, equipment.camera_bits) for sign, image in zip((1, -1), images, strict=False))
    stacked = np.asarray(signed).transpose(1, 2, 0, 3).reshape(planes.rows, planes.cols, planes.height, planes.width, 3)
    return planes.field(stacked, unit, name)


def _slides(along_v: np.ndarray, along_u: np.ndarray, bits: int) -> list[np.ndarray]:
    """Transmittance (rows, cols, v, u) of the positive and the negative part of the filters; one signed slide when none is quantised."""
    product = along_v[:, None, :, None] * along_u[None, :, None, :]
    if not bits:
        return [product]
    peak = float(np.abs(product).max())
    return [rounded(np.maximum(sign * product, 0), peak, bits) for sign in (1, -1)]


def _photographed(images: np.ndarray, bits: int) -> np.ndarray:
    """Images (pixels, rows, cols, 3) as a camera of so many bits gives them, exposed for the brightest pixel of all."""
    return rounded(images, float(np.abs(images).max()), bits)


def _pixel_places(planes: Planes, per_pixel: int) -> list[np.ndarray]:
    """For each of per_pixel^2 places in a pixel the points (height * width, 2) on S."""
    low_s, low_t, high_s, high_t = planes.window_m
    step_s, step_t = (high_s - low_s) / planes.width, (high_t - low_t) / planes.height
    places = []
    for a, b in np.ndindex(per_pixel, per_pixel):
        s = low_s + (np.arange(planes.width) + (a + 0.5) / per_pixel) * step_s
        t = low_t + (np.arange(planes.height) + (b + 0.5) / per_pixel) * step_t
        places.append(np.stack(np.meshgrid(s, t), axis=-1).reshape(-1, 2))
    return places


class Rays(NamedTuple):
    """positions (n, 3) in metres and unit directions (n, 3), luminaire's frame; flux (n, 3), Rec. 709 shares of W or lm."""

    positions: np.ndarray
    directions: np.ndarray
    flux: np.ndarray


class FluxBudget(NamedTuple):
    """Where the flux of a set of rays went, in the unit of the rays' luminance: total is the sum of the others.

    backward: rays away from the planes; beside_sampling, beside_measurement: rays beyond the extent of U, and, of the rest, of S;
    filter_tails: of rays on both planes, what the filters of functions outside the grid would have had.
    """

    total: float
    kept: float
    backward: float
    beside_sampling: float
    beside_measurement: float
    filter_tails: float


def field_from_rays(rays: Rays, planes: Planes, plane_z_m: float, unit: Unit, name: str) -> tuple[LightField, FluxBudget]:
    """Projects rays through U at z = plane_z_m and S: each adds flux dual_m(u) / pixel area to image m; the sum over m keeps the flux."""
    flux = luminance_from_rgb(rays.flux)
    forward = rays.directions[:, 2] > 1e-6
    slope = rays.directions[forward, :2] / rays.directions[forward, 2:]
    u = rays.positions[forward, :2] + (plane_z_m - rays.positions[forward, 2:]) * slope
    s = u + planes.distance_m * slope
    on_sampling = np.all(np.abs(u) < np.array(planes.half_sampling_m), axis=-1)
    size = np.array([planes.width, planes.height])
    place = np.floor((s / np.array(planes.half_window_m) + 1) / 2 * size).astype(np.int64)
    on_both = on_sampling & np.all((place >= 0) & (place < size), axis=-1)
    dual = span_dual(planes.kind)
    along = [dual_value(dual, u[on_both, axis, None] / planes.spacing_m - (np.arange(n) - (n - 1) / 2))
             for axis, n in enumerate((planes.cols, planes.rows))]
    carried, pixel = rays.flux[forward][on_both], place[on_both, 1] * planes.width + place[on_both, 0]
    area = 4 * planes.half_window_m[0] * planes.half_window_m[1] / (planes.width * planes.height)
    images = np.empty((planes.rows, planes.cols, planes.height * planes.width, 3))
    for j, i, c in np.ndindex(planes.rows, planes.cols, 3):
        weights = along[1][:, j] * along[0][:, i] * carried[:, c]
        images[j, i, :, c] = np.bincount(pixel, weights, minlength=planes.width * planes.height) / area
    field = planes.field(images.reshape(planes.rows, planes.cols, planes.height, planes.width, 3), unit, name)
    ahead = flux[forward]
    kept = float(luminance_from_rgb(images.sum(axis=(0, 1, 2)) * area))
    return field, FluxBudget(
        float(flux.sum()), kept, float(flux[~forward].sum()), float(ahead[~on_sampling].sum()),
        float(ahead[on_sampling & ~on_both].sum()), float(ahead[on_both].sum()) - kept,
    )


def waist_z_m(rays: Rays) -> float:
    """Height of the plane that rays with flux cross least spread: where the flux-weighted variance of their crossings is smallest."""
    forward = (rays.directions[:, 2] > 0.05) & (rays.flux.sum(axis=-1) > 0)  # steeper than 87 degrees says nothing of the source's place
    if not forward.any():
        return 0.0
    weight = rays.flux[forward].sum(axis=-1)
    slope = rays.directions[forward, :2] / rays.directions[forward, 2:]
    at_zero = rays.positions[forward, :2] - rays.positions[forward, 2:] * slope
    mean = lambda values: np.average(values, axis=0, weights=weight)  # noqa: E731
    a, b = at_zero - mean(at_zero), slope - mean(slope)
    return float(-mean(np.sum(a * b, axis=-1)) / max(mean(np.sum(b * b, axis=-1)), 1e-12))
