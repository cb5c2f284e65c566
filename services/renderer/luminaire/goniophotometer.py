"""The virtual measuring bench: a lamp whose radiance along every ray is known by tracing, to be measured like a real one.

A glowing ball near the focus of a paraboloid mirror (a torch, a headlight). Rays are followed backwards from the aperture at z = 0 into the
mirror, which opens towards +z, until they meet the ball, leave through the aperture, or have been reflected MAX_BOUNCES times.
"""

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit

from vemlight.renderer.luminaire.bases import Dual
from vemlight.renderer.luminaire.lightfield import LightField, Unit
from vemlight.renderer.luminaire.measuring import Equipment, Planes, Rays, field_from_radiance

MAX_BOUNCES = 6  # 0.85^6 = 38 % of the light is left in a good mirror, and hardly a path is so long
Metres = Annotated[float, Meta(gt=0, le=10)]
Share = Annotated[float, Meta(ge=0, le=1)]
Strength = Annotated[float, Meta(ge=0, le=1e12)]


class Lamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A ball of even radiance and its mirror z = r^2 / (4 focal_m) - depth, cut at the aperture. offset_m: of the ball from the focus.

    facets: so many flat-topped ribs round the mirror tilt its normals by up to facet_tilt rad, as in real headlights; 0: smooth.
    """

    aperture_radius_m: Metres = 0.03
    focal_m: Metres = 0.008
    ball_radius_m: Metres = 0.0025
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radiance: tuple[Strength, Strength, Strength] = (1.0, 1.0, 1.0)
    reflectance: tuple[Share, Share, Share] = (0.88, 0.86, 0.80)
    facets: Annotated[int, Meta(ge=0, le=1000)] = 0
    facet_tilt: Annotated[float, Meta(ge=0, le=0.5)] = 0.0

    @property
    def depth_m(self) -> float:
        """Of the mirror's vertex below the aperture."""
        return self.aperture_radius_m**2 / (4 * self.focal_m)


def lamp_radiance(lamp: Lamp, u: np.ndarray, s: np.ndarray, distance_m: float) -> np.ndarray:
    """Radiance (n, 3) that leaves the lamp along the rays from u (n, 2) at z = 0 to s (n, 2) at z = distance_m; 0 beside the aperture."""
    ball = np.array([lamp.offset_m[0], lamp.offset_m[1], lamp.focal_m - lamp.depth_m + lamp.offset_m[2]])
    hits = np.empty(len(u), np.int8)
    _trace(np.ascontiguousarray(u, np.float64), np.ascontiguousarray(s, np.float64), distance_m, lamp.aperture_radius_m, lamp.focal_m,
           lamp.depth_m, ball, lamp.ball_radius_m, lamp.facets, lamp.facet_tilt, hits)
    bounces = np.arange(MAX_BOUNCES + 1)[:, None]
    table = np.vstack([np.array(lamp.radiance) * np.array(lamp.reflectance) ** bounces, np.zeros(3)])
    return table[hits]  # -1, no hit, is the last row


@njit(cache=True)
def _trace(u, s, distance, radius, focal, depth, ball, ball_radius, facets, tilt, hits):
    """hits[k]: reflections before ray k, followed backwards, meets the ball; -1 when it never does."""
    for k in range(len(u)):
        ox, oy, oz = u[k, 0], u[k, 1], 0.0
        dx, dy, dz = u[k, 0] - s[k, 0], u[k, 1] - s[k, 1], -distance
        n = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / n, dy / n, dz / n
        hits[k] = -1
        if ox * ox + oy * oy > radius * radius:
            continue
        for bounce in range(MAX_BOUNCES + 1):
            # the ball first: it lies inside the mirror
            bx, by, bz = ox - ball[0], oy - ball[1], oz - ball[2]
            b = bx * dx + by * dy + bz * dz
            root = b * b - (bx * bx + by * by + bz * bz - ball_radius * ball_radius)
            near = -b - math.sqrt(root) if root >= 0 else -1.0
            # x^2 + y^2 = 4 focal (z + depth) along the ray: a t^2 + 2 h t + c = 0, the farther root lies ahead
            a = dx * dx + dy * dy
            h = ox * dx + oy * dy - 2 * focal * dz
            c = ox * ox + oy * oy - 4 * focal * (oz + depth)
            if a < 1e-12:
                wall = -c / (2 * h) if h != 0 else -1.0
            else:
                inside = h * h - a * c
                wall = (-h + math.sqrt(inside)) / a if inside >= 0 else -1.0
            if near > 1e-9 and (wall <= 1e-9 or near < wall):
                hits[k] = bounce
                break
            if wall <= 1e-9:
                break
            ox, oy, oz = ox + wall * dx, oy + wall * dy, oz + wall * dz
            if oz > 0:
                break
            nx, ny, nz = -ox, -oy, 2 * focal
            if facets > 0:  # ribs: the normal leans round the axis, in even steps over each rib
                phase = (math.atan2(oy, ox) / (2 * math.pi) * facets) % 1.0
                lean = tilt * (2 * phase - 1) * nz
                r = max(math.sqrt(ox * ox + oy * oy), 1e-12)
                nx, ny = nx - oy / r * lean, ny + ox / r * lean
            n = math.sqrt(nx * nx + ny * ny + nz * nz)
            across = 2 * (dx * nx + dy * ny + dz * nz) / (n * n)
            dx, dy, dz = dx - across * nx, dy - across * ny, dz - across * nz
            n = math.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx / n, dy / n, dz / n


def measured_lamp(lamp: Lamp, planes: Planes, dual: Dual, *, unit: Unit = "photometric", name: str = "lamp", per_spacing: int = 16,
                  per_pixel: int = 1, equipment: Equipment | None = None) -> LightField:
    """The lamp's light field as the bench measures it."""
    r = lamp.aperture_radius_m
    return field_from_radiance(lambda u, s: lamp_radiance(lamp, u, s, planes.distance_m), planes, dual, (r, r), unit=unit, name=name,
                               per_spacing=per_spacing, per_pixel=per_pixel, equipment=equipment)


def lamp_rays(lamp: Lamp, count: int, spread: float, seed: int) -> Rays:
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
