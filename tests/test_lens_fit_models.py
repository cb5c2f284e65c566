"""Lenses published in other models: their corners, calibrated here.

Parameters as published with: matsuren/ocamcalib_undistort, JarnoRalli/python_camera_library, eowjd0512/fisheye-calib-adapter (those of
OCamCalib, Scaramuzza 2006), VladyslavUsenko/basalt (double sphere, Usenko 2018; extended unified, Khomutenko 2016).
"""

from collections.abc import Callable

import numpy as np
import pytest

from vemlight.capture.calibration.boards import BoardView
from vemlight.capture.calibration.lens_fit import fit_lens
from vemlight.capture.lens import pixel_from_direction
from vemlight.light.sphere import direction_from_angles, rotation_xyz

POINTS = np.stack(np.meshgrid(np.arange(8), np.arange(6)), -1).reshape(-1, 2) * 0.03
NOISE_PX = 0.1
Radius = Callable[[np.ndarray], np.ndarray]


def ocam(*polynomial: float) -> Radius:
    """Radius in pixels by the angle off the axis of a ray (x, y, z) = (u, v, -polynomial(radius))."""
    radius = np.linspace(0, 1200, 20_000)
    theta = np.arctan2(radius, -np.polynomial.polynomial.polyval(radius, polynomial))
    theta = theta[: int(np.argmax(np.diff(theta) <= 0)) or None]
    return lambda angle: np.interp(angle, theta, radius[: len(theta)])


def double_sphere(f: float, xi: float, alpha: float) -> Radius:
    def radius(theta: np.ndarray) -> np.ndarray:
        x, z = np.sin(theta), np.cos(theta)
        z1 = xi + z
        return f * x / (alpha * np.hypot(x, z1) + (1 - alpha) * z1)

    return radius


def extended_unified(f: float, alpha: float, beta: float) -> Radius:
    return lambda theta: f * np.sin(theta) / (alpha * np.sqrt(beta * np.sin(theta) ** 2 + np.cos(theta) ** 2) + (1 - alpha) * np.cos(theta))


# radius by angle, size, axis, rim in degrees
LENSES = {
    "ocam, 185 degrees": (ocam(-471.4441, 0.0, 7.356108e-4, -3.773045e-7, 5.800006e-10), (1600, 1600), (798.18, 794.31), 92.0),
    "ocam, 110 degrees": (ocam(-551.7655, 0.0, 8.372454e-4, -6.474789e-7, 1.235631e-9), (1024, 768), (505.48, 381.78), 56.0),
    "ocam, narrow chip": (ocam(-209.3037, 0.0, 2.216175e-3, -5.122558e-6, 2.149945e-8), (752, 480), (359.83, 243.61), 75.0),
    "double sphere, 195 degrees": (double_sphere(158.286, -0.172131, 0.593118), (512, 512), (254.96, 256.89), 97.0),
    "extended unified": (extended_unified(191.148, 0.629106, 1.041807), (512, 512), (254.96, 256.88), 88.0),
    "double sphere, wide angle": (double_sphere(349.756, -0.240957, 0.566997), (752, 480), (365.89, 249.33), 60.0),
}


def project(seen: np.ndarray, radius: Radius, c: tuple[float, float]) -> np.ndarray:
    across = np.hypot(seen[..., 0], seen[..., 1])
    return np.array(c) + (radius(np.arctan2(across, seen[..., 2])) / np.maximum(across, 1e-12))[..., None] * seen[..., :2]


def corner_views(radius: Radius, size: tuple[int, int], c: tuple[float, float], rim: float, count: int) -> list[BoardView]:
    """Boards all around, turned at random, whole inside the image and the rim (rad)."""
    rng, views = np.random.default_rng(17), []
    while len(views) < count:
        towards = direction_from_angles(rim * np.sqrt(rng.uniform(0, 1)), rng.uniform(0, 2 * np.pi))
        x = np.cross([0.3, 1.0, 0.2], towards)
        rotation = np.stack([x, np.cross(towards, x), np.linalg.norm(x) * towards], 1) / np.linalg.norm(x)
        rotation = rotation @ rotation_xyz((rng.uniform(-35, 35), rng.uniform(-35, 35), rng.uniform(0, 360)))
        seen = np.column_stack([POINTS - POINTS.mean(0), np.zeros(len(POINTS))]) @ rotation.T + towards * rng.uniform(0.12, 0.3)
        pixels = project(seen, radius, c)
        if np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2]).max() < rim and np.all((pixels > 4) & (pixels < np.array(size) - 5)):
            views.append(BoardView(f"v{len(views)}", pixels + rng.normal(0, NOISE_PX, pixels.shape), POINTS))
    return views


@pytest.mark.parametrize("name", LENSES)
def test_a_lens_in_another_model_is_found(name: str) -> None:
    radius, size, c, rim_deg = LENSES[name]
    report = fit_lens(corner_views(radius, size, c, np.radians(rim_deg), 12), size)
    assert not report.rejected
    # noise in x and in y is 1.41 times as far off; what the polynomial cannot follow adds less than that
    assert report.rms_px < 2 * NOISE_PX
    theta, phi = np.meshgrid(np.radians(np.linspace(0, report.reach_deg, 40)), np.linspace(0, 2 * np.pi, 36))
    rays = direction_from_angles(theta, phi)
    truth = project(rays, radius, c)
    inside = np.all((truth >= 0) & (truth < np.array(size)), axis=-1)
    assert np.linalg.norm(pixel_from_direction(rays, report.lens) - truth, axis=-1)[inside].max() < 1.0
    assert report.reach_deg > 0.85 * rim_deg
    assert not report.lens.p.any()  # all of them lie on one axis


def omnidir(seen: np.ndarray) -> np.ndarray:
    """Pixels of a lens of 194 degrees in the unified model with decentring (Mei and Rives 2007), as OpenCV's omnidir fits it."""
    seen = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
    x, y = np.moveaxis(seen[..., :2] / (seen[..., 2:] + 1.6), -1, 0)
    square, p1, p2 = x * x + y * y, 0.004, -0.003
    radial = 1 - 0.2 * square + 0.05 * square**2
    u = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    v = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.stack([600.0 + 900 * u, 560.0 + 900 * v], axis=-1)


def test_a_lens_off_its_axis_is_found() -> None:
    """With decentring left out it fits to 1.5 px."""
    rng, views = np.random.default_rng(18), []
    while len(views) < 14:
        towards = direction_from_angles(np.radians(97) * np.sqrt(rng.uniform(0, 1)), rng.uniform(0, 2 * np.pi))
        x = np.cross([0.3, 1.0, 0.2], towards)
        rotation = np.stack([x, np.cross(towards, x), np.linalg.norm(x) * towards], 1) / np.linalg.norm(x)
        rotation = rotation @ rotation_xyz((rng.uniform(-35, 35), rng.uniform(-35, 35), rng.uniform(0, 360)))
        seen = np.column_stack([POINTS - POINTS.mean(0), np.zeros(len(POINTS))]) @ rotation.T + towards * rng.uniform(0.12, 0.3)
        if np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2]).max() < np.radians(97):
            views.append(BoardView(f"v{len(views)}", omnidir(seen) + rng.normal(0, NOISE_PX, (len(seen), 2)), POINTS))
    report = fit_lens(views, (1200, 1120))
    assert not report.rejected
    assert report.rms_px < 1.5 * NOISE_PX
    assert report.lens.p1 != 0
    theta, phi = np.meshgrid(np.radians(np.linspace(0, report.reach_deg, 40)), np.linspace(0, 2 * np.pi, 36))
    rays = direction_from_angles(theta, phi)
    off = pixel_from_direction(rays, report.lens) - omnidir(rays)
    assert np.linalg.norm(off, axis=-1).max() < 1.0
