"""The fisheye lens: the radial model of Kannala and Brandt (2006, "A generic camera model and calibration method for conventional,
wide-angle, and fish-eye lenses", eq. 6) on rays, so that it holds beyond 90 degrees from the axis, and its file.

A ray at angle theta from the optical axis meets the sensor at the radius, in units of the focal length,

    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)

Beyond the rim, where no light comes, theta_d goes on in a straight line, so that every direction has one pixel.

Camera axes: x right, y down, z along the optical axis. Pixel coordinates (x, y) put the centre of the first pixel at (0, 0), as
OpenCV does.
"""

import math
from pathlib import Path

import msgspec
import numpy as np
from numba import njit

from vemlight.errors import UserError
from vemlight.files import read_toml, written_whole

Row = tuple[float, float, float]
IDENTITY: tuple[Row, Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STEPS = 1024  # the polynomial's slope is looked at so often between axis and rim; a degree-8 even polynomial bends 8 times at most


class Lens(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """One lens on one sensor, as its TOML file has it."""

    size: tuple[int, int]  # width, height in pixels
    f: tuple[float, float]  # pixels per unit of theta_d along x and y
    c: tuple[float, float]  # pixel where the optical axis meets the sensor
    k1: float
    k2: float
    k3: float
    k4: float
    rim_deg: float  # no light comes from farther off the axis than this
    vignetting: tuple[float, ...] = ()  # relative response 1 + v1 theta^2 + v2 theta^4 + ...
    flat_field: str = ""  # image of even light beside this file; takes the place of vignetting
    world_from_camera: tuple[Row, Row, Row] = IDENTITY  # a camera that looks up, image right = +X
    views: int = 0  # images that the calibration kept; 0: not calibrated from images
    rms_px: float = 0.0  # of the corners in them
    date: str = ""

    @property
    def k(self) -> np.ndarray:
        """(4,) float64."""
        return np.array([self.k1, self.k2, self.k3, self.k4])

    @property
    def rim(self) -> float:
        """In rad."""
        return math.radians(self.rim_deg)

    @property
    def rotation(self) -> np.ndarray:
        """world_from_camera as (3, 3) float64."""
        return np.array(self.world_from_camera)


def read_lens(path: Path) -> Lens:
    """The lens file at `path`. Raises UserError for a missing or unknown key and for values that make no lens."""
    lens = read_toml(path, Lens)
    try:
        check_lens(lens)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    return lens


def check_lens(lens: Lens) -> None:
    """Raises UserError when directions and pixels would not belong together one to one, or no radiance could be had."""
    if min(lens.size) < 1 or max(lens.size) > 16384:
        raise UserError(f"size = {list(lens.size)} is no image size; give width and height in pixels")
    numbers = [*lens.f, *lens.c, *lens.k, lens.rim_deg, *lens.vignetting, *lens.rotation.ravel()]
    if not np.all(np.isfinite(numbers)):
        raise UserError("a number is nan or inf; mend it")
    if min(lens.f) <= 0:
        raise UserError(f"f = {list(lens.f)} must be above 0 pixels")
    if not 0 < lens.rim_deg <= 180:
        raise UserError(f"rim_deg = {lens.rim_deg:g} must be above 0 and at most 180")
    theta = np.linspace(0, lens.rim, STEPS)
    slope = slope_from_angle(theta, lens)
    if slope.min() <= 0:
        at = math.degrees(theta[int(np.argmax(slope <= 0))])
        raise UserError(f"k1..k4 turn back at {at:.1f} degrees, before rim_deg = {lens.rim_deg:g}; calibrate again or lower rim_deg")
    if vignetting_from_angle(theta, lens).min() <= 0:
        raise UserError(f"vignetting falls to 0 before rim_deg = {lens.rim_deg:g}; mend it or lower rim_deg")
    if lens.flat_field and lens.vignetting:
        raise UserError("flat_field holds the vignetting already; leave one of the two out")
    if not np.allclose(lens.rotation @ lens.rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(lens.rotation) < 0:
        raise UserError("world_from_camera is no rotation; its rows must be unit vectors at right angles, right-handed")


def write_lens(path: Path, lens: Lens) -> None:
    """Writes the TOML file that `read_lens` reads back to the same record, digit for digit."""
    rows = msgspec.to_builtins(lens, enc_hook=float)  # numpy's numbers too
    text = "".join(f"{key} = {_toml(value)}\n" for key, value in rows.items())
    with written_whole(path) as part:
        part.write_text(text, encoding="utf-8")


def _toml(value: object) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value)


def vignetting_from_angle(theta: np.ndarray, lens: Lens) -> np.ndarray:
    """Response relative to the axis at angles `theta` in rad from it."""
    square = np.square(theta)
    return 1 + square * np.polynomial.polynomial.polyval(square, lens.vignetting or (0.0,))


def slope_from_angle(theta: np.ndarray, lens: Lens) -> np.ndarray:
    """d theta_d / d theta at angles `theta` in rad up to the rim."""
    return np.polynomial.polynomial.polyval(np.square(theta), np.concatenate([[1], lens.k * (3, 5, 7, 9)]))


@njit(cache=True)
def radius_from_angle(theta: float, k: np.ndarray, rim: float) -> float:
    """theta_d of the angle `theta` in rad; straight on beyond `rim`."""
    t = min(theta, rim)
    s = t * t
    radius = t * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
    if theta > rim:
        radius += (theta - rim) * (1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + s * 9 * k[3]))))
    return radius


@njit(cache=True)
def angle_from_radius(radius: float, k: np.ndarray, rim: float) -> float:
    """The angle in rad whose theta_d is `radius`: Newton's steps, kept inside the bracket that they narrow."""
    low, high = 0.0, rim
    edge = radius_from_angle(rim, k, rim)
    if radius >= edge:
        s = rim * rim
        return rim + (radius - edge) / (1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + s * 9 * k[3]))))
    t = rim * radius / edge
    for _ in range(60):  # 4 to 6 are enough for a real lens; halving alone would need 53 for the last bit
        s = t * t
        miss = t * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))) - radius
        if miss > 0:
            high = t
        else:
            low = t
        new = t - miss / (1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + s * 9 * k[3]))))
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-15:
            return new
        t = new
    return t


@njit(cache=True)
def _pixels(direction, f, c, k, rim):
    pixel = np.empty((len(direction), 2))
    for i in range(len(direction)):
        x, y, z = direction[i]
        across = math.hypot(x, y)
        radius = radius_from_angle(math.atan2(across, z), k, rim)
        # on the axis every azimuth gives the same pixel; straight behind, +x stands for all of them
        ux, uy = (x / across, y / across) if across > 0 else (1.0, 0.0)
        pixel[i, 0] = c[0] + f[0] * radius * ux
        pixel[i, 1] = c[1] + f[1] * radius * uy
    return pixel


@njit(cache=True)
def _directions(pixel, f, c, k, rim):
    direction = np.empty((len(pixel), 3))
    for i in range(len(pixel)):
        x, y = (pixel[i, 0] - c[0]) / f[0], (pixel[i, 1] - c[1]) / f[1]
        radius = math.hypot(x, y)
        theta = min(angle_from_radius(radius, k, rim), math.pi)
        across = math.sin(theta) / radius if radius > 0 else 0.0
        direction[i] = x * across, y * across, math.cos(theta)
    return direction


def pixel_from_direction(direction: np.ndarray, lens: Lens) -> np.ndarray:
    """Pixel coordinates (..., 2) float64, x and y, of directions (..., 3) of any length in the camera's axes."""
    flat = np.ascontiguousarray(direction, np.float64).reshape(-1, 3)
    return _pixels(flat, np.array(lens.f), np.array(lens.c), lens.k, lens.rim).reshape(*np.shape(direction)[:-1], 2)


def direction_from_pixel(pixel: np.ndarray, lens: Lens) -> np.ndarray:
    """Unit vectors (..., 3) float64 in the camera's axes of pixel coordinates (..., 2)."""
    flat = np.ascontiguousarray(pixel, np.float64).reshape(-1, 2)
    return _directions(flat, np.array(lens.f), np.array(lens.c), lens.k, lens.rim).reshape(*np.shape(pixel)[:-1], 3)


def pixel_angles(lens: Lens) -> np.ndarray:
    """Angle in rad between the optical axis and the centre of each pixel, (height, width) float64."""
    width, height = lens.size
    x, y = np.meshgrid((np.arange(width) - lens.c[0]) / lens.f[0], (np.arange(height) - lens.c[1]) / lens.f[1])
    flat = np.hypot(x, y).ravel()
    return angles_from_radii(flat, lens.k, lens.rim).reshape(height, width)


@njit(cache=True)
def angles_from_radii(radius, k, rim):
    """`angle_from_radius` of many, (n,) float64."""
    theta = np.empty_like(radius)
    for i in range(len(radius)):
        theta[i] = angle_from_radius(radius[i], k, rim)
    return theta


def pixel_solid_angles(lens: Lens) -> np.ndarray:
    """Solid angle in sr that each pixel sees, (height, width) float64; 0 where its centre lies beyond the rim.

    sin(theta) d theta d psi over the pixel's area theta_d d theta_d d psi f_x f_y, taken at the centre: with h the pixel's side in rad the
    error is of the order of h^2 / 24, 1e-5 for a pixel of one degree.
    """
    theta = pixel_angles(lens)
    inside = np.minimum(theta, lens.rim)
    radius = inside * (1 + np.square(inside) * np.polynomial.polynomial.polyval(np.square(inside), lens.k))
    ratio = np.where(inside > 1e-9, np.sin(inside) / np.maximum(radius, 1e-12), 1.0)
    return np.where(theta <= lens.rim, ratio / slope_from_angle(inside, lens) / (lens.f[0] * lens.f[1]), 0.0)
