"""ColorCheckers found in frames."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from vemlight.capture.calibration.colorchecker import LIGHTNESS, chart_from_corners, find_chart, gray_codes
from vemlight.capture.calibration.response_fit import calibrate_response, gray_patches
from vemlight.capture.lens import Lens, direction_from_pixel
from vemlight.capture.response import Log, Response, Srgb, code_from_radiance
from vemlight.errors import UserError
from vemlight.light.images import read_codes
from vemlight.light.sphere import rotation_xyz

CELL, WIDE = 80, 66  # pixels from patch to patch, and of a patch, in the drawn chart
LOG12 = Log(bits=12, a=600.0, b=210.0, c=0.05, luminance_scale=1.0)
RNG_LEVELS = ((LIGHTNESS + 16) / 116) ** 3


def drawn(frame: float = 0.02) -> np.ndarray:
    """Reflectance (height, width) of the chart, its dark frame around it."""
    chart = np.full((CELL * 5, CELL * 7), frame)
    for row, col in np.ndindex(4, 6):
        y, x = (CELL * (n + 1) - WIDE // 2 for n in (row, col))
        chart[y : y + WIDE, x : x + WIDE] = RNG_LEVELS[row, col]
    return chart


def centres(pixel_from_chart: np.ndarray) -> np.ndarray:
    at = np.stack(np.meshgrid(np.arange(6), np.arange(4)), -1) * CELL + CELL - 0.5
    return cv2.perspectiveTransform(at.reshape(-1, 1, 2).astype(np.float64), pixel_from_chart).reshape(4, 6, 2)


def photographed(seed: int, response: Response, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A frame (600, 800) of codes in which the chart lies somewhere, and the true centres (4, 6, 2)."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0, 0], [CELL * 7, 0], [CELL * 7, CELL * 5], [0, CELL * 5]], np.float64)
    turn, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.45, 0.8)
    turned = (corners - corners.mean(0)) @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) * size
    seen = turned + rng.uniform(-25, 25, (4, 2)) + (400, 300)  # held at a slant
    pixel_from_chart = cv2.getPerspectiveTransform(corners.astype(np.float32), seen.astype(np.float32))
    wall = cv2.resize(rng.uniform(0.1, 0.6, (6, 8)), (800, 600), interpolation=cv2.INTER_CUBIC)
    chart = cv2.warpPerspective(drawn(), pixel_from_chart, (800, 600), flags=cv2.INTER_AREA)
    there = cv2.warpPerspective(np.ones((CELL * 5, CELL * 7)), pixel_from_chart, (800, 600))
    x = np.linspace(-1, 1, 800)
    light = 300 * (1 + 0.1 * x)  # a tenth more at the right
    radiance = (chart * there + wall * (1 - there)) * light
    signal = response.signal(np.maximum(radiance, 0)) + rng.normal(0, noise, radiance.shape)
    return np.clip(np.rint(signal), 0, response.top).astype(np.uint16), centres(np.asarray(pixel_from_chart, np.float64))


@pytest.mark.parametrize("seed", range(8))
def test_found_at_any_turn_and_slant(seed: int) -> None:
    codes, truth = photographed(seed, LOG12, 4.0)
    found = find_chart(codes)
    spacing = np.linalg.norm(truth[0, 1] - truth[0, 0])
    assert np.linalg.norm(found - truth, axis=-1).max() < 0.15 * spacing  # what is read stays within the patch up to 0.25
    np.testing.assert_allclose(gray_codes(codes, found), gray_codes(codes, truth), atol=4)


@pytest.mark.parametrize("seed", range(3))
def test_found_through_a_fisheye(seed: int) -> None:
    # the chart a foot before a lens that bends it, off its axis; the frame noisy
    lens = Lens(size=(800, 600), f=(260.0, 260.0), c=(399.5, 299.5), k1=-0.02, k2=0.0, k3=0.0, k4=0.0, rim_deg=100.0)
    rng = np.random.default_rng(seed)
    rotation = rotation_xyz((rng.uniform(-25, 25), rng.uniform(-25, 25), rng.uniform(0, 360)))
    rays = direction_from_pixel(np.stack(np.meshgrid(np.arange(800.0), np.arange(600.0)), -1), lens) @ rotation
    on = rays[..., 2] > 0.05
    at = rays[..., :2] / np.where(on, rays[..., 2], 1)[..., None]
    chart = drawn()
    half = np.array([CELL * 7, CELL * 5]) / 2
    x, y = np.moveaxis(at * CELL * 5.5 + half, -1, 0).astype(np.float32)  # patches of a tenth of the distance
    wall = np.float64(0.3)
    radiance = np.where(on, cv2.remap(chart, x, y, cv2.INTER_LINEAR, borderValue=float(wall)), wall) * 200
    codes = np.clip(np.rint(LOG12.signal(radiance) + rng.normal(0, 3, radiance.shape)), 0, 4095).astype(np.uint16)
    np.testing.assert_allclose(gray_codes(codes, find_chart(codes)), LOG12.signal(RNG_LEVELS[-1] * 200), atol=4)


def test_found_in_colour_of_eight_bits() -> None:
    srgb = Srgb(bits=8)
    radiance, truth = photographed(3, Log(bits=16, a=0.0, b=1.0, c=1.0), 0.0)
    levels = np.exp(radiance.astype(np.float64)) / 300
    codes = code_from_radiance(np.clip(levels[..., None] * [1.1, 1.0, 0.8], 0, 1), srgb).astype(np.uint8)
    codes = np.clip(codes + np.random.default_rng(0).normal(0, 1, codes.shape), 0, 255).astype(np.uint8)
    assert np.linalg.norm(find_chart(codes) - truth, axis=-1).max() < 8


def test_response_from_a_frame(tmp_path: Path) -> None:
    codes, _ = photographed(11, LOG12, 1.0)
    report = calibrate_response(gray_patches(codes, find_chart(codes), 300 * RNG_LEVELS[-1, 0]), tmp_path / "r.toml", bits=12)
    assert report.worst < 0.05
    assert isinstance(report.response, Log)
    assert report.response.b == pytest.approx(LOG12.b, rel=0.1)  # the light is uneven by a tenth


def test_the_chart_is_found_with_a_patch_hidden() -> None:
    codes, truth = photographed(2, LOG12, 2.0)
    for place in ((0, 1), (1, 4), (2, 0)):
        cv2.circle(codes, truth[place].astype(int).tolist(), 24, 100, -1)  # a finger
    assert np.linalg.norm(find_chart(codes)[-1] - truth[-1], axis=-1).max() < 8


BOARD = np.kron(np.indices((8, 10)).sum(0) % 2, np.ones((60, 60))) * 3000
GRID = np.pad(np.kron(np.ones((4, 6)), np.pad(np.full((60, 60), 2000.0), 10)), 40)


@pytest.mark.parametrize(
    "frame",
    [np.zeros((300, 400)), np.full((300, 400), 4095.0), np.random.default_rng(0).uniform(0, 4095, (300, 400)), BOARD, GRID],
    ids=["black", "white", "noise", "chessboard", "even patches"],
)
def test_no_chart_is_refused(frame: np.ndarray) -> None:
    with pytest.raises(UserError, match="no ColorChecker was found"):
        find_chart(frame.astype(np.uint16))


def test_corners_give_the_same() -> None:
    codes, truth = photographed(5, LOG12, 2.0)
    chart = chart_from_corners([tuple(truth[at]) for at in ((0, 0), (0, 5), (3, 5), (3, 0))])
    np.testing.assert_allclose(chart, truth, atol=0.1)
    np.testing.assert_allclose(gray_codes(codes, chart), gray_codes(codes, find_chart(codes)), atol=3)


def test_a_real_photograph() -> None:
    data = os.environ.get("VEMLIGHT_DATA")
    if not data:
        pytest.skip("VEMLIGHT_DATA names no folder of photographs")
    codes = read_codes(Path(data) / "gray" / "below_fishbox.jpg")
    gray = gray_codes(codes, find_chart(codes))
    np.testing.assert_allclose(gray, [165, 137, 109, 82, 63, 54], atol=3)  # read by hand from the passport's lower chart
