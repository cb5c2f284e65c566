"""The fisheye lens: its projection, its solid angles and its file.

The radial model of Kannala and Brandt (2006, "A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses", eq. 6), applied to rays, so that it holds beyond 90 degrees off the axis. A ray at angle theta from the optical
axis meets the sensor at the radius, in units of the focal length,

    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)

Beyond the rim, where no light arrives, theta_d continues along its tangent, so that every direction has exactly one pixel.

Camera axes: x right, y down, z along the optical axis. Pixel coordinates (x, y) put the centre of the first pixel at (0, 0), as
OpenCV does.
"""

import math
from pathlib import Path
from typing import NamedTuple

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
NEWTON_TOLERANCE = 1e-15  # rad, four units in the last place at 1 rad; any value below 1e-10 keeps directions within 1e-9
ROTATION_TOLERANCE = 1e-5  # of an element of R R^T: files with six digits pass; scaled or skewed axes do not


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
    vignetting: tuple[float, ...] = ()  # relative response 1 + v1 theta^2 + v2 theta^4 + ...
    flat_field: str = ""  # image of an evenly lit surface, beside this file; replaces `vignetting`
    world_from_camera: tuple[Row, Row, Row] = IDENTITY  # the default looks up, with the image's right side towards +X
    views: int = 0  # photographs that the calibration used; 0: not calibrated from photographs
    rms_px: float = 0.0  # reprojection error of their corners
    date: str = ""

    @property
    def k(self) -> np.ndarray:
        """Coefficients k1 to k4, (4,) float64."""
        return np.array([self.k1, self.k2, self.k3, self.k4])

    @property
    def rim(self) -> float:
        """Angle of the rim off the axis in rad."""
        return math.radians(self.rim_deg)

    @property
    def rotation(self) -> np.ndarray:
        """world_from_camera as (3, 3) float64."""
        return np.array(self.world_from_camera)

    @property
    def intrinsics(self) -> Intrinsics:
        """The projection for compiled loops."""
        return Intrinsics(*map(float, (*self.f, *self.c, self.k1, self.k2, self.k3, self.k4, self.rim)))


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
    numbers = [*lens.f, *lens.c, *lens.k, lens.rim_deg, *lens.vignetting, *lens.rotation.ravel()]
    if not np.all(np.isfinite(numbers)):
        raise UserError("a number is nan or inf; replace it")
    if min(lens.f) <= 0:
        raise UserError(f"f = {list(lens.f)} must be above 0 pixels; correct it")
    if not 0 < lens.rim_deg <= 180:
        raise UserError(f"rim_deg = {lens.rim_deg:g} must be above 0 and at most 180; correct it")
    theta = np.linspace(0, lens.rim, SLOPE_SAMPLES)
    with np.errstate(all="ignore"):  # of numbers so large that what they make is inf or nan
        slope, response = slope_from_angle(theta, lens), vignetting_from_angle(theta, lens)
    rises = (slope > 0) & (slope < np.inf)
    if not rises.all():
        at = math.degrees(theta[int(np.argmin(rises))])
        raise UserError(f"k1..k4 turn back at {at:.1f} degrees, before rim_deg = {lens.rim_deg:g}; calibrate again or lower rim_deg")
    if not ((response > 0) & (response < np.inf)).all():
        raise UserError(f"vignetting falls to 0 before rim_deg = {lens.rim_deg:g}; correct it or lower rim_deg")
    if lens.flat_field and lens.vignetting:
        raise UserError("flat_field contains the vignetting already; leave one of the two out")
    with np.errstate(all="ignore"):
        orthonormal = np.allclose(lens.rotation @ lens.rotation.T, np.eye(3), rtol=0, atol=ROTATION_TOLERANCE)
    if not orthonormal or np.linalg.det(lens.rotation) < 0:
        raise UserError("world_from_camera is no rotation; its rows must be unit vectors at right angles, right-handed")


def write_lens(path: Path, lens: Lens) -> None:
    """Writes the TOML file that `read_lens` reads back to the same record, digit for digit."""
    write_toml(path, lens)


def vignetting_from_angle(theta: np.ndarray, lens: Lens) -> np.ndarray:
    """Response relative to the axis at angles `theta` in rad off it."""
    square = np.square(theta)
    return 1 + square * np.polynomial.polynomial.polyval(square, lens.vignetting or (0.0,))


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


@kernel
def _pixels(directions, lens):
    pixels = np.empty((len(directions), 2))
    for i in range(len(directions)):
        x, y, z = directions[i]
        across = math.hypot(x, y)
        radius = radius_from_angle(math.atan2(across, z), lens)
        # on the axis every azimuth gives the same pixel; straight behind, +x represents them all
        ux, uy = (x / across, y / across) if across > 0 else (1.0, 0.0)
        pixels[i, 0] = lens.cx + lens.fx * radius * ux
        pixels[i, 1] = lens.cy + lens.fy * radius * uy
    return pixels


@kernel
def _directions(pixels, lens):
    directions = np.empty((len(pixels), 3))
    for i in range(len(pixels)):
        x, y = (pixels[i, 0] - lens.cx) / lens.fx, (pixels[i, 1] - lens.cy) / lens.fy
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


def pixel_angles(lens: Lens) -> np.ndarray:
    """Angle in rad between the optical axis and the centre of each pixel, (height, width) float64."""
    width, height = lens.size
    x, y = np.meshgrid((np.arange(width) - lens.c[0]) / lens.f[0], (np.arange(height) - lens.c[1]) / lens.f[1])
    return angles_from_radii(np.hypot(x, y).ravel(), lens.intrinsics).reshape(height, width)


@kernel
def angles_from_radii(radii, lens):
    """`angle_from_radius` of each of `radii` (n,), (n,) float64."""
    angles = np.empty_like(radii)
    for i in range(len(radii)):
        angles[i] = angle_from_radius(radii[i], lens)
    return angles


def pixel_solid_angles(lens: Lens) -> np.ndarray:
    """Solid angle of each pixel in sr, (height, width) float64; 0 where the pixel's centre lies beyond the rim.

    sin(theta) d theta d psi over the pixel's area theta_d d theta_d d psi f_x f_y, evaluated at the centre: with h the pixel's side in
    rad the error is of the order of h^2 / 24, 1e-5 for a pixel of one degree.
    """
    theta = pixel_angles(lens)
    inside = np.minimum(theta, lens.rim)
    radius = inside * (1 + np.square(inside) * np.polynomial.polynomial.polyval(np.square(inside), lens.k))
    # sin(theta) / theta_d tends to 1 at the axis; below 1e-9 rad it is 1 to the last bit
    ratio = np.where(inside > 1e-9, np.sin(inside) / np.maximum(radius, 1e-12), 1.0)
    return np.where(theta <= lens.rim, ratio / slope_from_angle(inside, lens) / (lens.f[0] * lens.f[1]), 0.0)
