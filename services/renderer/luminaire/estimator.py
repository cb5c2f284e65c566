"""Position-dependent importance sampling of a luminaire (Lu et al. 2015), one estimator before, on and between the planes.

With Delta / |s - p|^3 ds = z_p / |u - p|^3 du equations 5 and 9 are one integral over U,

    I_m(p) = (delta / (z_p spacing))^2 integral C_m(s(u)) phi_m(u) / cos theta du,

so a sample is drawn in the box on S and weighted on U, and nothing special happens where p lies on S or the box is smaller than a pixel.

Samples are distributed over the images by systematic rounding, which drops no image (equation 12's nearest integer loses up to 16 % of the
light), and divided by the number expected. K_max caps the samples of one image; what is capped is divided by the number used. All images
of a point draw from one Halton sequence, each where the one before it stopped: if each began at its start, all would err alike (21 %
against 8 % at 200 samples of 25 images).
"""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.luminaire.bvh import Ray, TriangleHierarchy, hierarchy_from_triangles, occluded
from vemlight.renderer.luminaire.tables import AxisBox, PixelAxis, SummedAreaTables, axis_box, mean_importance, sample_box

POINTS_PER_TASK = 512  # a thread's; any value in 64..4096 does: long against handing them out, short against the whole
RAY_START = 1e-4  # of the way to the lamp: a shadow ray begins off its own surface; any value in 1e-6..1e-3 does


class Receivers(NamedTuple):
    """What is lit, (n, ...) float64 in the luminaire's frame: positions, shading and flat normals on the viewer's side, the mirrored view,
    diffuse and specular (n, 3), shape (n,), the Phong exponent or GGX' alpha, and ggx (n,) bool, False for Lambert and Phong."""

    positions: np.ndarray
    normals: np.ndarray
    flat_normals: np.ndarray
    mirrored: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    shape: np.ndarray
    ggx: np.ndarray


class Receiver(NamedTuple):
    """One point of Receivers, in compiled code."""

    position: np.ndarray
    normal: np.ndarray
    flat_normal: np.ndarray
    mirrored: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    shape: float
    ggx: bool


class Occluders(NamedTuple):
    """What casts traced shadows: triangles in the world, and the luminaire's place there, a rigid transform (4, 4) float64."""

    triangles: TriangleHierarchy
    world_from_local: np.ndarray


class ImageSamples(NamedTuple):
    """The samples that one point draws from image number m: its boxes, points (k, 2) of the sequence, their shift and weight."""

    m: int
    u: AxisBox
    v: AxisBox
    points: np.ndarray
    shift: np.ndarray
    weight: float


NO_OCCLUDERS = Occluders(hierarchy_from_triangles(np.zeros((0, 3, 3))), np.eye(4))


def irradiance_receivers(positions: np.ndarray, normals: np.ndarray) -> Receivers:
    """Receivers whose reflected radiance equals their irradiance: diffuse = pi."""
    n = len(positions)
    return Receivers(positions, normals, normals, normals, np.full((n, 3), np.pi), np.zeros((n, 3)), np.zeros(n), np.zeros(n, bool))


def halton(count: int) -> np.ndarray:
    """Points 1 to `count` of the Halton sequence in bases 2 and 3, (count, 2) float64."""
    from scipy.stats.qmc import Halton

    return Halton(2, scramble=False).random(count + 1)[1:]


def interleaved_shifts(rows: np.ndarray, columns: np.ndarray, side: int) -> np.ndarray:
    """Shifts (n, 3) of the sequence and of the rounding at pixels: side^2 different ones in tiles; side 1: the same for all.

    Additive recurrence by the generalised golden ratio of three dimensions (Roberts 2018), centred so that side 1 rounds to nearest.
    """
    k = (rows % side) * side + columns % side
    ratio = 1.2207440846057596  # x^4 = x + 1
    shift = (k[:, None] * ratio ** -np.arange(1.0, 4.0)) % 1.0
    shift[:, 2] = (shift[:, 2] + 0.5) % 1.0
    return shift


def shade(tables: SummedAreaTables, receivers: Receivers, shifts: np.ndarray, samples: int, max_per_image: int = 0,
          occluders: Occluders = NO_OCCLUDERS) -> np.ndarray:
    """Reflected radiance (n, 3) float64 of receivers under a luminaire, about `samples` samples each.

    shifts: (n, 3) from `interleaved_shifts`. max_per_image: K_max, the most samples of one image at a point (0: no cap). occluders: what
    casts shadows, by traced rays.
    """
    out = np.zeros((len(receivers.positions), 3))
    arrays = Receivers(*(np.ascontiguousarray(a, bool if name == "ggx" else np.float64) for name, a in receivers._asdict().items()))
    occluders = occluders._replace(world_from_local=np.ascontiguousarray(occluders.world_from_local, np.float64))
    points, shifts = halton(samples + 1), np.ascontiguousarray(shifts, np.float64)

    limits = samples, max_per_image or samples + 1

    def shade_from(first: int) -> None:
        part = slice(first, first + POINTS_PER_TASK)
        _shade(tables, Receivers(*(a[part] for a in arrays)), shifts[part], points, limits, occluders, out[part])

    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the compiled loop releases the GIL
        list(threads.map(shade_from, range(0, len(out), POINTS_PER_TASK)))
    return out


@subroutine
def basis_value(cells, x):
    """phi of bases.basis, for compiled code: the support's width in cells names the basis."""
    a = abs(x)
    if cells == 2:
        return 1 - 2 * a * a if a <= 0.5 else (2 * (1 - a) * (1 - a) if a < 1 else 0.0)
    return 0.75 - a * a if a <= 0.5 else (0.5 * (1.5 - a) * (1.5 - a) if a < 1.5 else 0.0)


@subroutine
def image_boxes(tables, m, p):
    """The AxisBoxes along u and v that point p sees of image m."""
    ratio = tables.distance / p[2]
    low, high, origin, size = tables.support_low[m], tables.support_high[m], tables.window_low, tables.pixel
    height, width = tables.importance.shape[1:]
    u = axis_box(low[0], high[0], p[0], ratio, PixelAxis(origin[0], size[0], width))
    return u, axis_box(low[1], high[1], p[1], ratio, PixelAxis(origin[1], size[1], height))


@subroutine
def image_weight(tables, m, u, v):
    """The integral of importance over the part of U behind the boxes u and v of image m, 0 where nothing is seen."""
    if u.x1 < u.x0 or v.x1 < v.x0:
        return 0.0
    return mean_importance(tables.sums[m], tables.importance[m], u, v) * abs((u.u1 - u.u0) * (v.u1 - v.u0))


@kernel(nogil=True)
def _shade(tables, receivers, shifts, points, limits, occluders, out):
    """Adds the reflected radiance of each receiver to out (n, 3). limits: samples in all, and of one image."""
    weights = np.empty(len(tables.sums))
    samples, max_per_image = limits
    for n in range(len(out)):
        p = receivers.positions[n]
        if not p[2] > 0:
            continue
        receiver = Receiver(p, receivers.normals[n], receivers.flat_normals[n], receivers.mirrored[n], receivers.diffuse[n],
                            receivers.specular[n], receivers.shape[n], receivers.ggx[n])
        # the light of each image through what the point sees of it
        total = 0.0
        for m in range(len(weights)):
            u, v = image_boxes(tables, m, p)
            weights[m] = image_weight(tables, m, u, v)
            total += weights[m]
        if total <= 0:
            continue
        # samples in proportion, by systematic rounding
        scale = (tables.distance / (p[2] * tables.spacing)) ** 2
        passed, drawn = 0.0, 0
        for m in range(len(weights)):
            expected = samples * (weights[m] / total)
            count = math.floor(passed + expected + shifts[n, 2]) - math.floor(passed + shifts[n, 2])
            passed += expected
            divisor = expected
            if expected > max_per_image:
                count, divisor = max_per_image, float(max_per_image)
            if count > 0:
                u, v = image_boxes(tables, m, p)
                weight = scale * weights[m] / divisor
                _add_samples(tables, ImageSamples(m, u, v, points[drawn : drawn + count], shifts[n], weight), receiver, occluders, out[n])
                drawn += count


@subroutine
def _add_samples(tables, samples, receiver, occluders, out):
    """Adds what the samples of one image reflect at a Receiver to out (3,)."""
    m, u, v, shift, p = samples.m, samples.u, samples.v, samples.shift, receiver.position
    centre_u = (tables.support_low[m, 0] + tables.support_high[m, 0]) / 2
    centre_v = (tables.support_low[m, 1] + tables.support_high[m, 1]) / 2
    sums, importance, pixels, unoccluded = tables.sums[m], tables.importance[m], tables.pixels[m], len(occluders.triangles.nodes) == 0
    normal, flat, specular = receiver.normal, receiver.flat_normal, receiver.specular
    glossy = receiver.ggx or specular.max() > 0
    for k in range(len(samples.points)):
        a, b = samples.points[k, 0] + shift[0], samples.points[k, 1] + shift[1]
        drawn = sample_box(sums, importance, u, v, a - math.floor(a), b - math.floor(b))
        q = importance[drawn.row, drawn.column]
        if q <= 0:
            continue
        # the sample's place on U and its direction
        at_u, at_v = u.u0 + drawn.x * (u.u1 - u.u0), v.u0 + drawn.y * (v.u1 - v.u0)
        phi = basis_value(tables.cells, (at_u - centre_u) / tables.spacing) * basis_value(tables.cells, (at_v - centre_v) / tables.spacing)
        dx, dy, dz = at_u - p[0], at_v - p[1], -p[2]
        r = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / r, dy / r, dz / r
        cosine = normal[0] * dx + normal[1] * dy + normal[2] * dz
        if cosine <= 0 or flat[0] * dx + flat[1] * dy + flat[2] * dz <= 0:
            continue
        if not unoccluded and occluded(occluders.triangles, _world_ray(occluders.world_from_local, p, dx, dy, dz), RAY_START * r, r):
            continue
        value = samples.weight * phi * (r / p[2]) * cosine / q
        lobe, grazing = _lobe(receiver, cosine, dx, dy, dz) if glossy else (0.0, 0.0)
        for c in range(3):
            fresnel = specular[c] + (1 - specular[c]) * grazing
            transmitted = 1 - fresnel if receiver.ggx else 1.0
            out[c] += value * pixels[drawn.row, drawn.column, c] * (receiver.diffuse[c] / math.pi * transmitted + fresnel * lobe)


@subroutine
def _world_ray(matrix, p, dx, dy, dz):
    """The Ray in the world from a point p (3,) in a direction of the luminaire's frame."""
    return Ray(
        matrix[0, 0] * p[0] + matrix[0, 1] * p[1] + matrix[0, 2] * p[2] + matrix[0, 3],
        matrix[1, 0] * p[0] + matrix[1, 1] * p[1] + matrix[1, 2] * p[2] + matrix[1, 3],
        matrix[2, 0] * p[0] + matrix[2, 1] * p[1] + matrix[2, 2] * p[2] + matrix[2, 3],
        matrix[0, 0] * dx + matrix[0, 1] * dy + matrix[0, 2] * dz,
        matrix[1, 0] * dx + matrix[1, 1] * dy + matrix[1, 2] * dz,
        matrix[2, 0] * dx + matrix[2, 1] * dy + matrix[2, 2] * dz,
    )


@subroutine
def _lobe(receiver, cosine, dx, dy, dz):
    """(specular lobe, Schlick's weight of grazing angles) towards a direction whose cosine with the normal is given."""
    normal, mirrored = receiver.normal, receiver.mirrored
    towards_mirrored = mirrored[0] * dx + mirrored[1] * dy + mirrored[2] * dz
    if receiver.ggx:
        view = normal[0] * mirrored[0] + normal[1] * mirrored[1] + normal[2] * mirrored[2]  # the view's cosine equals that of its mirror
        return ggx_lobe(cosine, max(view, 1e-4), 2 * view * cosine - towards_mirrored, receiver.shape)
    return (receiver.shape + 2) / (2 * math.pi) * max(towards_mirrored, 1e-6) ** receiver.shape, 0.0


@kernel
def ggx_lobe(light, view, between, alpha):
    """(distribution x visibility, Schlick's (1 - v.h)^5) of glTF 2.0, appendix B.3: brdf.glsl's ggx_lobe.

    light, view: cosines of the normal with either; between: of light and view.
    """
    length = math.sqrt(max(2 + 2 * between, 1e-12))
    n = min((light + view) / length, 1.0)
    a2 = alpha * alpha
    t = n * n * (a2 - 1) + 1
    smith = light * math.sqrt(view * view * (1 - a2) + a2) + view * math.sqrt(light * light * (1 - a2) + a2)
    return a2 / (math.pi * t * t) * 0.5 / smith, (1 - min((1 + between) / length, 1.0)) ** 5
