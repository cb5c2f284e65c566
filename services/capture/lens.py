"""The fisheye lens: its projection, its solid angles and its file.

The radial model of Kannala and Brandt (2006, "A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses", eq. 6), applied to rays, so that it holds beyond 90 degrees off the axis. A ray at angle theta from the optical
axis meets the sensor at the radius, in units of the focal length,

    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)

Its elements need not lie on one axis: with (u, v) the point at theta_d, decentring moves it to (Brown 1966, "Decentering Distortion of
Lenses", applied to theta_d; A and B are his tangential terms)

    (u + A m, v + B m),  A = 2 p1 u v + p2 (3 u^2 + v^2),  B = p1 (u^2 + 3 v^2) + 2 p2 u v,  m = 1 + p3 (u^2 + v^2)

A mirror ball, photographed from afar, is such a lens of 2 sin(theta / 2) = theta - theta^3 / 24 + .., with theta from the axis back to the
camera, whose image is not turned about but mirrored: x and y stay, z changes its sign.

Beyond the rim, where no light arrives, theta_d and what decentring adds continue in a straight line, so that every direction has exactly
one pixel.

Camera axes: x right, y down, z along the optical axis. Pixel coordinates (x, y) put the centre of the first pixel at (0, 0), as
OpenCV does.
"""

import math
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.files import read_toml, write_toml
from vemlight.kernels import kernel, subroutine

Row = tuple[float, float, float]
IDENTITY: tuple[Row, Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
MAX_SIZE = 16384  # pixels on a side, as for all images; more would be a typing error
SLOPE_SAMPLES = 1024  # between axis and rim: the slope, of degree 8 and even, has at most 4 turns there; any value from 100 on does
MAX_NEWTON_STEPS = 60  # a real lens takes 4 to 6; bisection alone would need 53 for the last bit, so any value from 54 on does
MAX_CENTRING_STEPS = 64  # of which each halves the error at least; 54 reach the last bit
MAX_DECENTRING = 0.5  # of the derivatives of what decentring adds: the inverse then converges. Lenses have 0.02 to 0.1
DECENTRING_SAMPLES = 64  # directions around the axis: it has three waves around; any value from 12 on does
NEWTON_TOLERANCE = 1e-15  # rad, four units in the last place at 1 rad; any value below 1e-10 keeps directions within 1e-9
ROTATION_TOLERANCE = 1e-5  # of an element of R R^T: files with six digits pass; scaled or skewed axes do not


# Of 2 sin(theta / 2) in theta, as far as k4: right to 0.02 degrees up to 178.
MIRROR_BALL_K = (-1 / 24, 1 / 1920, -1 / 322_560, 1 / 92_897_280)


class Intrinsics(NamedTuple):
    """The projection of a lens as plain numbers, for compiled loops."""

    fx: float  # pixels per unit of theta_d
    fy: float
    cx: float  # pixel where the optical axis meets the sensor
    cy: float
    k1: float
    k2: float
    k3: float
    k4: float
    p1: float
    p2: float
    p3: float
    rim: float  # rad


class Lens(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """One lens on one sensor, as its TOML file has it."""

    size: tuple[int, int]  # width, height in pixels
    f: tuple[float, float]  # pixels per unit of theta_d along x and y
    c: tuple[float, float]  # pixel where the optical axis meets the sensor
    k1: float
    k2: float
    k3: float
    k4: float
    rim_deg: float  # angle off the axis beyond which no light arrives
    p1: float = 0.0  # decentring, of elements off the axis
    p2: float = 0.0
    p3: float = 0.0
    vignetting: tuple[float, ...] = ()  # relative response 1 + v1 theta^2 + v2 theta^4 + ...
    flat_field: str = ""  # image of an evenly lit surface, beside this file; replaces `vignetting`
    model: Literal["fisheye", "mirrorball"] = "fisheye"  # mirrorball: f is half of its radius, rim_deg 178, k1 to k4 and p1 to p3 are 0
    reflectance: float = 1.0  # of a mirror ball
    world_from_camera: tuple[Row, Row, Row] = IDENTITY  # the default looks up, with the image's right side towards +X
    views: int = 0  # photographs that the calibration used; 0: not calibrated from photographs
    rms_px: float = 0.0  # reprojection error of their corners
    date: str = ""

    @property
    def k(self) -> np.ndarray:
        """Coefficients k1 to k4, (4,) float64; those of its curve for a mirror ball."""
        return np.array(MIRROR_BALL_K if self.model == "mirrorball" else [self.k1, self.k2, self.k3, self.k4])

    @property
    def p(self) -> np.ndarray:
        """Decentring p1 to p3, (3,) float64."""
        return np.array([self.p1, self.p2, self.p3])

    @property
    def rim(self) -> float:
        """Angle of the rim off the axis in rad."""
        return math.radians(self.rim_deg)

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) float64: the world's axes from those in which the optical axis is z. A mirror ball's are mirrored, with determinant -1."""
        rotation = np.array(self.world_from_camera)
        return rotation * (1, 1, -1) if self.model == "mirrorball" else rotation

    @property
    def intrinsics(self) -> Intrinsics:
        """The projection for compiled loops."""
        numbers = (*self.f, *self.c, *self.k, self.p1, self.p2, self.p3, self.rim)
        return Intrinsics(*map(float, numbers))


def read_lens(path: Path) -> Lens:
    """Reads a lens file. Raises UserError for a missing or unknown key and for values that describe no lens."""
    lens = read_toml(path, Lens)
    try:
        check_lens(lens)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    return lens


def check_lens(lens: Lens) -> None:
    """Raises UserError unless directions and pixels correspond one to one and radiance can be recovered everywhere."""
    if min(lens.size) < 1 or max(lens.size) > MAX_SIZE:
        raise UserError(f"size = {list(lens.size)} is no image size; give width and height in pixels")
    numbers = [*lens.f, *lens.c, *lens.k, lens.p1, lens.p2, lens.p3, lens.rim_deg, *lens.vignetting, *lens.rotation.ravel()]
    if not np.all(np.isfinite(numbers)):
        raise UserError("a number is nan or inf; replace it")
    if min(lens.f) <= 0:
        raise UserError(f"f = {list(lens.f)} must be above 0 pixels; correct it")
    if lens.model == "mirrorball" and any((lens.k1, lens.k2, lens.k3, lens.k4, lens.p1, lens.p2, lens.p3)):
        raise UserError("k1..k4 and p1..p3 are of a fisheye, and model is mirrorball; set them to 0")
    if not 0 < lens.reflectance <= 1 or (lens.reflectance != 1 and lens.model != "mirrorball"):
        raise UserError(f"reflectance = {lens.reflectance:g} is of a mirror ball, above 0 and at most 1; correct it")
    if not 0 < lens.rim_deg <= 180:
        raise UserError(f"rim_deg = {lens.rim_deg:g} must be above 0 and at most 180; correct it")
    theta = np.linspace(0, lens.rim, SLOPE_SAMPLES)
    with np.errstate(all="ignore"):  # of numbers so large that what they make is inf or nan
        slope, response = slope_from_angle(theta, lens), vignetting_from_angle(theta, lens)
    rises = (slope > 0) & (slope < np.inf)
    if not rises.all():
        at = math.degrees(theta[int(np.argmin(rises))])
        raise UserError(f"k1..k4 turn back at {at:.1f} degrees, before rim_deg = {lens.rim_deg:g}; calibrate again or lower rim_deg")
    with np.errstate(all="ignore"):
        largest = _largest_decentring(lens)
    if not largest <= MAX_DECENTRING:
        raise UserError(f"p1..p3 bend the image by {largest:.2g} of itself within rim_deg, more than {MAX_DECENTRING:g}; calibrate again")
    if not ((response > 0) & (response < np.inf)).all():
        raise UserError(f"vignetting falls to 0 before rim_deg = {lens.rim_deg:g}; correct it or lower rim_deg")
    if lens.flat_field and lens.vignetting:
        raise UserError("flat_field contains the vignetting already; leave one of the two out")
    with np.errstate(all="ignore"):
        orthonormal = np.allclose(lens.rotation @ lens.rotation.T, np.eye(3), rtol=0, atol=ROTATION_TOLERANCE)
    if not orthonormal or np.linalg.det(np.array(lens.world_from_camera)) < 0:
        raise UserError("world_from_camera is no rotation; its rows must be unit vectors at right angles, right-handed")


def _largest_decentring(lens: Lens) -> float:
    """The largest derivative of what decentring adds, within the rim."""
    theta, phi = np.meshgrid(np.linspace(0, lens.rim, DECENTRING_SAMPLES), np.linspace(0, 2 * np.pi, DECENTRING_SAMPLES))
    radius = theta * (1 + np.square(theta) * np.polynomial.polynomial.polyval(np.square(theta), lens.k))
    derivatives = decentring_derivatives(radius * np.cos(phi), radius * np.sin(phi), lens)
    return float(max(np.abs(values).max() for values in derivatives))


def decentring_derivatives(u: np.ndarray, v: np.ndarray, lens: Lens) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives of what decentring adds within the rim, at points u, v in units of the focal length: of u by u and v, of v by u and v."""
    p1, p2, p3 = lens.p1, lens.p2, lens.p3
    a, b = 2 * p1 * u * v + p2 * (3 * u * u + v * v), p1 * (u * u + 3 * v * v) + 2 * p2 * u * v
    m, across = 1 + p3 * (u * u + v * v), 2 * p1 * u + 2 * p2 * v
    return (
        (2 * p1 * v + 6 * p2 * u) * m + 2 * p3 * u * a,
        across * m + 2 * p3 * v * a,
        across * m + 2 * p3 * u * b,
        (6 * p1 * v + 2 * p2 * u) * m + 2 * p3 * v * b,
    )


def write_lens(path: Path, lens: Lens) -> None:
    """Writes the TOML file that `read_lens` reads back to the same record, digit for digit."""
    write_toml(path, lens)


def vignetting_from_angle(theta: np.ndarray, lens: Lens) -> np.ndarray:
    """Response relative to the axis at angles `theta` in rad off it, times a mirror ball's reflectance."""
    square = np.square(theta)
    return lens.reflectance + lens.reflectance * square * np.polynomial.polynomial.polyval(square, lens.vignetting or (0.0,))


def slope_from_angle(theta: np.ndarray, lens: Lens) -> np.ndarray:
    """d theta_d / d theta at angles `theta` in rad up to the rim."""
    return np.polynomial.polynomial.polyval(np.square(theta), np.concatenate([[1], lens.k * (3, 5, 7, 9)]))


@subroutine
def _theta_d(theta, lens):
    # the polynomial itself, without the tangent beyond the rim
    s = theta * theta
    return theta * (1 + s * (lens.k1 + s * (lens.k2 + s * (lens.k3 + s * lens.k4))))


@subroutine
def _slope(theta, lens):
    s = theta * theta
    return 1 + s * (3 * lens.k1 + s * (5 * lens.k2 + s * (7 * lens.k3 + s * 9 * lens.k4)))


@kernel
def radius_from_angle(theta: float, lens: Intrinsics) -> float:
    """theta_d of the angle `theta` in rad; along the tangent beyond the rim."""
    radius = _theta_d(min(theta, lens.rim), lens)
    if theta > lens.rim:
        radius += (theta - lens.rim) * _slope(lens.rim, lens)
    return radius


@kernel
def angle_from_radius(radius: float, lens: Intrinsics) -> float:
    """The angle in rad whose theta_d is `radius`, by Newton's method with a bracket that each step narrows."""
    low, high = 0.0, lens.rim
    edge = radius_from_angle(lens.rim, lens)
    if radius >= edge:
        return lens.rim + (radius - edge) / _slope(lens.rim, lens)
    theta = lens.rim * radius / edge
    for _ in range(MAX_NEWTON_STEPS):
        excess = _theta_d(theta, lens) - radius
        if excess > 0:
            high = theta
        else:
            low = theta
        updated = theta - excess / _slope(theta, lens)
        if not low <= updated <= high:
            updated = 0.5 * (low + high)
        if abs(updated - theta) <= NEWTON_TOLERANCE:
            return updated
        theta = updated
    return theta


@subroutine
def _decentring(u, v, lens):
    # what decentring adds to a point; beyond the rim that at the rim, in proportion
    radius, edge = math.hypot(u, v), _theta_d(lens.rim, lens)
    beyond = max(radius / edge, 1.0)
    u, v = u / beyond, v / beyond
    m = (1 + lens.p3 * (u * u + v * v)) * beyond
    return (2 * lens.p1 * u * v + lens.p2 * (3 * u * u + v * v)) * m, (lens.p1 * (u * u + 3 * v * v) + 2 * lens.p2 * u * v) * m


@kernel
def decentred(u: float, v: float, lens: Intrinsics) -> tuple[float, float]:
    """Where decentring moves a point, in units of the focal length."""
    if lens.p1 == 0 and lens.p2 == 0:
        return u, v
    du, dv = _decentring(u, v, lens)
    return u + du, v + dv


@kernel
def centred(u: float, v: float, lens: Intrinsics) -> tuple[float, float]:
    """The inverse of `decentred`, by fixed-point iteration."""
    if lens.p1 == 0 and lens.p2 == 0:
        return u, v
    x, y = u, v
    for _ in range(MAX_CENTRING_STEPS):
        dx, dy = _decentring(x, y, lens)
        moved = abs(u - dx - x) + abs(v - dy - y)
        x, y = u - dx, v - dy
        if moved <= NEWTON_TOLERANCE:
            break
    return x, y


@kernel
def _pixels(directions, lens):
    pixels = np.empty((len(directions), 2))
    for i in range(len(directions)):
        x, y, z = directions[i]
        across = math.hypot(x, y)
        radius = radius_from_angle(math.atan2(across, z), lens)
        # on the axis every azimuth gives the same pixel; straight behind, +x represents them all
        ux, uy = (x / across, y / across) if across > 0 else (1.0, 0.0)
        u, v = decentred(radius * ux, radius * uy, lens)
        pixels[i, 0] = lens.cx + lens.fx * u
        pixels[i, 1] = lens.cy + lens.fy * v
    return pixels


@kernel
def _directions(pixels, lens):
    directions = np.empty((len(pixels), 3))
    for i in range(len(pixels)):
        x, y = centred((pixels[i, 0] - lens.cx) / lens.fx, (pixels[i, 1] - lens.cy) / lens.fy, lens)
        radius = math.hypot(x, y)
        theta = min(angle_from_radius(radius, lens), math.pi)
        across = math.sin(theta) / radius if radius > 0 else 0.0
        directions[i, 0], directions[i, 1], directions[i, 2] = x * across, y * across, math.cos(theta)
    return directions


def pixel_from_direction(direction: np.ndarray, lens: Lens) -> np.ndarray:
    """Pixel coordinates (..., 2) float64, x and y, of directions (..., 3) of any length in camera axes."""
    flat = np.ascontiguousarray(direction, np.float64).reshape(-1, 3)
    return _pixels(flat, lens.intrinsics).reshape(*np.shape(direction)[:-1], 2)


def direction_from_pixel(pixel: np.ndarray, lens: Lens) -> np.ndarray:
    """Unit vectors (..., 3) float64 in camera axes through pixel coordinates (..., 2)."""
    flat = np.ascontiguousarray(pixel, np.float64).reshape(-1, 2)
    return _directions(flat, lens.intrinsics).reshape(*np.shape(pixel)[:-1], 3)


def centred_points(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """The points u, v of the centre of each pixel without decentring, in units of the focal length, (height, width) float64 each."""
    width, height = lens.size
    u, v = np.meshgrid((np.arange(width) - lens.c[0]) / lens.f[0], (np.arange(height) - lens.c[1]) / lens.f[1])
    if lens.p1 or lens.p2:
        _centre(u.reshape(-1), v.reshape(-1), lens.intrinsics)
    return u, v


@kernel
def _centre(u, v, lens):
    for i in range(len(u)):
        u[i], v[i] = centred(u[i], v[i], lens)


def pixel_angles(lens: Lens) -> np.ndarray:
    """Angle in rad between the optical axis and the centre of each pixel, (height, width) float64."""
    u, v = centred_points(lens)
    return angles_from_radii(np.hypot(u, v).ravel(), lens.intrinsics).reshape(u.shape)


@kernel
def angles_from_radii(radii, lens):
    """`angle_from_radius` of each of `radii` (n,), (n,) float64."""
    angles = np.empty_like(radii)
    for i in range(len(radii)):
        angles[i] = angle_from_radius(radii[i], lens)
    return angles


def pixel_solid_angles(lens: Lens) -> np.ndarray:
    """Solid angle of each pixel in sr, (height, width) float64; 0 where the pixel's centre lies beyond the rim.

    sin(theta) d theta d psi over the pixel's area theta_d d theta_d d psi f_x f_y, and over the area that decentring makes of one, at the
    centre: with h the pixel's side in
    rad the error is of the order of h^2 / 24, 1e-5 for a pixel of one degree.
    """
    theta = pixel_angles(lens)
    inside = np.minimum(theta, lens.rim)
    radius = inside * (1 + np.square(inside) * np.polynomial.polynomial.polyval(np.square(inside), lens.k))
    # sin(theta) / theta_d tends to 1 at the axis; below 1e-9 rad it is 1 to the last bit
    ratio = np.where(inside > 1e-9, np.sin(inside) / np.maximum(radius, 1e-12), 1.0)
    if lens.p1 or lens.p2:
        du_du, du_dv, dv_du, dv_dv = decentring_derivatives(*centred_points(lens), lens)
        ratio = ratio / ((1 + du_du) * (1 + dv_dv) - du_dv * dv_du)
    return np.where(theta <= lens.rim, ratio / slope_from_angle(inside, lens) / (lens.f[0] * lens.f[1]), 0.0)
