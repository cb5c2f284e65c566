"""The virtual goniophotometer: a lamp whose radiance along every ray is known by ray tracing, to be measured like a real one.

A glowing ball near the focus of a paraboloid mirror (a torch, a headlight). Rays are followed backwards from the aperture at z = 0 into the
mirror, which opens towards +z, until they meet the ball, leave through the aperture, or have been reflected MAX_BOUNCES times.
"""

import math
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.luminaire.acquisition import AcquisitionPlanes, Quantisation, Rays, field_from_radiance
from vemlight.renderer.luminaire.bases import Dual
from vemlight.renderer.luminaire.lightfield import LightField, Unit

MAX_BOUNCES = 6  # 0.85^6 = 38 % of the light is left in a good mirror; any value in 4..20 does: hardly a path is so long
EPSILON_M = 1e-9  # a reflected ray does not meet the point that it starts from
Metres = Annotated[float, Meta(gt=0, le=10)]
Reflectance = Annotated[float, Meta(ge=0, le=1)]
Radiance = Annotated[float, Meta(ge=0, le=1e12)]


class ReflectorLamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A ball of even radiance and its mirror z = r^2 / (4 focal_m) - depth, cut at the aperture. offset_m: of the ball from the focus.

    facets: number of ribs round the mirror, each tilting its normals from -facet_tilt to facet_tilt rad, as in real headlights; 0: smooth.
    """

    aperture_radius_m: Metres = 0.03
    focal_m: Metres = 0.008
    ball_radius_m: Metres = 0.0025
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radiance: tuple[Radiance, Radiance, Radiance] = (1.0, 1.0, 1.0)
    reflectance: tuple[Reflectance, Reflectance, Reflectance] = (0.88, 0.86, 0.80)
    facets: Annotated[int, Meta(ge=0, le=1000)] = 0
    facet_tilt: Annotated[float, Meta(ge=0, le=0.5)] = 0.0

    @property
    def depth_m(self) -> float:
        """Of the mirror's vertex below the aperture."""
        return self.aperture_radius_m**2 / (4 * self.focal_m)


class _Optics(NamedTuple):
    """A ReflectorLamp for compiled code: ball (3,) is its centre; metres and rad."""

    aperture_radius: float
    focal: float
    depth: float
    ball: np.ndarray
    ball_radius: float
    facets: int
    tilt: float


def lamp_radiance(lamp: ReflectorLamp, u: np.ndarray, s: np.ndarray, distance_m: float) -> np.ndarray:
    """Radiance (n, 3) that leaves the lamp along the rays from u (n, 2) at z = 0 to s (n, 2) at z = distance_m; 0 outside the aperture."""
    ball = np.array([lamp.offset_m[0], lamp.offset_m[1], lamp.focal_m - lamp.depth_m + lamp.offset_m[2]])
    optics = _Optics(lamp.aperture_radius_m, lamp.focal_m, lamp.depth_m, ball, lamp.ball_radius_m, lamp.facets, lamp.facet_tilt)
    bounces = np.empty(len(u), np.int8)
    _trace(np.ascontiguousarray(u, np.float64), np.ascontiguousarray(s, np.float64), distance_m, optics, bounces)
    powers = np.arange(MAX_BOUNCES + 1)[:, None]
    table = np.vstack([np.array(lamp.radiance) * np.array(lamp.reflectance) ** powers, np.zeros(3)])
    return table[bounces]  # -1, no hit, is the last row


@kernel
def _trace(u, s, distance, optics, bounces):
    """bounces[k]: reflections before ray k, followed backwards, meets the ball; -1 when it never does."""
    for k in range(len(u)):
        o = (u[k, 0], u[k, 1], 0.0)
        d = _unit(u[k, 0] - s[k, 0], u[k, 1] - s[k, 1], -distance)
        bounces[k] = -1
        if o[0] * o[0] + o[1] * o[1] > optics.aperture_radius * optics.aperture_radius:
            continue
        for bounce in range(MAX_BOUNCES + 1):
            ball, mirror = _ball_distance(optics, o, d), _mirror_distance(optics, o, d)
            if ball > EPSILON_M and (mirror <= EPSILON_M or ball < mirror):
                bounces[k] = bounce
                break
            if mirror <= EPSILON_M:
                break
            o = (o[0] + mirror * d[0], o[1] + mirror * d[1], o[2] + mirror * d[2])
            if o[2] > 0:
                break
            d = _reflected(d, _mirror_normal(optics, o))


@subroutine
def _unit(x, y, z):
    n = math.sqrt(x * x + y * y + z * z)
    return (x / n, y / n, z / n)


@subroutine
def _ball_distance(optics, o, d):
    """Along the ray o + t d to the ball; -1 where it misses."""
    bx, by, bz = o[0] - optics.ball[0], o[1] - optics.ball[1], o[2] - optics.ball[2]
    b = bx * d[0] + by * d[1] + bz * d[2]
    root = b * b - (bx * bx + by * by + bz * bz - optics.ball_radius * optics.ball_radius)
    return -b - math.sqrt(root) if root >= 0 else -1.0


@subroutine
def _mirror_distance(optics, o, d):
    """Along the ray o + t d to the paraboloid x^2 + y^2 = 4 focal (z + depth): the farther root of a t^2 + 2 h t + c = 0 lies ahead."""
    a = d[0] * d[0] + d[1] * d[1]
    h = o[0] * d[0] + o[1] * d[1] - 2 * optics.focal * d[2]
    c = o[0] * o[0] + o[1] * o[1] - 4 * optics.focal * (o[2] + optics.depth)
    if a < 1e-12:  # parallel to the axis: the equation is linear
        return -c / (2 * h) if h != 0 else -1.0
    inside = h * h - a * c
    return (-h + math.sqrt(inside)) / a if inside >= 0 else -1.0


@subroutine
def _mirror_normal(optics, o):
    """The normal, of any length, at a point of the mirror; ribs lean it round the axis, in an even sweep over each rib."""
    x, y, z = -o[0], -o[1], 2 * optics.focal
    if optics.facets == 0:
        return (x, y, z)
    phase = (math.atan2(o[1], o[0]) / (2 * math.pi) * optics.facets) % 1.0
    lean = optics.tilt * (2 * phase - 1) * z
    r = max(math.sqrt(o[0] * o[0] + o[1] * o[1]), 1e-12)
    return (x - o[1] / r * lean, y + o[0] / r * lean, z)


@subroutine
def _reflected(d, normal):
    n = math.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    across = 2 * (d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2]) / (n * n)
    return _unit(d[0] - across * normal[0], d[1] - across * normal[1], d[2] - across * normal[2])


def measured_lamp(lamp: ReflectorLamp, planes: AcquisitionPlanes, dual: Dual, *, unit: Unit = "photometric", name: str = "lamp",
                  per_spacing: int = 16, per_pixel: int = 1, quantisation: Quantisation | None = None) -> LightField:
    """The lamp's light field as the goniophotometer measures it; the options are those of `field_from_radiance`."""
    r = lamp.aperture_radius_m
    return field_from_radiance(lambda u, s: lamp_radiance(lamp, u, s, planes.distance_m), planes, dual, (r, r), unit=unit, name=name,
                               per_spacing=per_spacing, per_pixel=per_pixel, quantisation=quantisation)


def lamp_rays(lamp: ReflectorLamp, count: int, spread: float, seed: int) -> Rays:
    """`count` rays of even density over the aperture and over tan(theta) up to `spread` along x and y, each with its flux.

    dPhi = L cos^4 theta d(tan x) d(tan y) du, so the flux of a ray is its radiance times the density's inverse.
    """
    rng = np.random.default_rng(seed)
    r = lamp.aperture_radius_m
    u, slope = rng.uniform(-r, r, (count, 2)), rng.uniform(-spread, spread, (count, 2))
    cos = 1 / np.sqrt(1 + np.sum(slope**2, axis=-1))
    flux = lamp_radiance(lamp, u, u + slope, 1.0) * (cos**4 * (2 * r) ** 2 * (2 * spread) ** 2 / count)[:, None]
    directions = np.concatenate([slope, np.ones((count, 1))], axis=-1) * cos[:, None]
    return Rays(np.concatenate([u, np.zeros((count, 1))], axis=-1), directions, flux)
