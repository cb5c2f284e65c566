"""The disc shows each direction where it should, and brightness without flicker; pictures stand on their ground."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from vemlight.light.sphere import Coverage, angles_from_direction, cell_from_direction
from vemlight.runtime import stamps, wire
from vemlight.viewer.pictures import DISC_PIXELS, GROUND, SRGB_CODES, Sky, _with_neighbours, disc_lookup, jpeg, picture_jpeg

STAMP = stamps.stamp(0, 0.0)


def decoded(jpeg: bytes) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return pixels.astype(int)


def disc(radiance: np.ndarray, coverage: Coverage = "hemisphere") -> np.ndarray:
    rows, cols, _ = radiance.shape
    return decoded(Sky().disc_jpeg(wire.MapMessage(stamp=STAMP, rows=rows, cols=cols, coverage=coverage), radiance.astype(np.float32)))


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize(
    ("direction", "right", "down"),
    [((1, 0, 0.3), -1, 0), ((0, 1, 0.3), 0, -1), ((-1, 0, 0.3), 1, 0), ((0, -1, 0.3), 0, 1), ((1, 1, 1), -1, -1), ((0.02, 0, 1), 0, 0)],
)
def test_one_lit_cell_stands_in_its_direction(direction, right, down, coverage: Coverage):
    rows, cols = (90 if coverage == "hemisphere" else 180), 360
    row, column = cell_from_direction(np.array(direction), rows, cols, coverage)
    radiance = np.full((rows, cols, 3), 1e-3)
    radiance[int(row), int(column)] = 1e3
    seen = disc(radiance, coverage).sum(axis=2)
    y, x = (np.argwhere(seen > 0.7 * seen.max()).mean(axis=0) + 0.5 - DISC_PIXELS / 2) / (DISC_PIXELS / 2)
    theta, _ = angles_from_direction(np.array(direction))
    radius = theta / (np.pi / 2 if coverage == "hemisphere" else np.pi)
    expected = radius * np.array([right, down]) / max(1, np.hypot(right, down))
    cell = np.pi / (2 * rows) + 2 / DISC_PIXELS  # half a cell and half a pixel in each direction, and JPEG's blocks
    assert np.hypot(x - expected[0], y - expected[1]) < 2 * cell


def test_the_lookup_inverts_the_layout():
    columns, rows = disc_lookup(90, 360)
    assert rows.min() > -0.5
    assert rows.max() == 89.5
    y, x = 100, 300
    right, up = (x + 0.5 - 256) / 256, -(y + 0.5 - 256) / 256
    theta, phi = (rows[y, x] + 0.5) * np.pi / 180, (columns[y, x] + 0.5) * np.pi / 180
    assert np.allclose((-theta * np.cos(phi), theta * np.sin(phi)), (right * np.pi / 2, up * np.pi / 2), atol=1e-5)


def test_black_stays_black_also_after_light():
    black, bright = np.zeros((18, 72, 3), np.float32), np.ones((18, 72, 3), np.float32)
    sky = Sky()
    assert sky.codes(black, "hemisphere").max() == 0
    sky.codes(bright, "hemisphere")
    assert sky.codes(black, "hemisphere").max() == 0


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e25])
def test_the_unit_of_radiance_does_not_matter(scale):
    radiance = np.random.default_rng(1).lognormal(size=(18, 72, 3)).astype(np.float32)
    difference = Sky().codes(radiance, "hemisphere").astype(int) - Sky().codes(radiance * np.float32(scale), "hemisphere")
    assert np.abs(difference).max() <= 1


def test_a_huge_sun_leaves_its_sky_visible():
    radiance = np.full((90, 360, 3), (0.2, 0.4, 0.8), np.float32)
    radiance[20, 100] = 1e6
    codes = Sky().codes(radiance, "hemisphere")
    assert (codes[20, 100] == 255).all()
    assert codes[50, 200, 0] > 100  # blue comes first


def test_a_jump_of_brightness_is_taken_slowly():
    sky, radiance = Sky(), np.full((18, 72, 3), 0.5, np.float32)
    sky.codes(radiance, "hemisphere")
    shown = [int(sky.codes(4 * radiance, "hemisphere")[0, 0, 0]) for _ in range(60)]
    assert shown == sorted(shown, reverse=True)
    assert max(a - b for a, b in pairwise(shown)) < 15
    assert shown[-1] == Sky().codes(radiance, "hemisphere")[0, 0, 0]


def test_a_map_larger_than_the_disc_is_scaled_down():
    assert disc(np.full((1100, 2200, 3), 0.5)).shape == (DISC_PIXELS, DISC_PIXELS, 3)


def test_jpeg_shows_a_smooth_sky_without_blocks_in_few_bytes():
    rows, cols = np.mgrid[:256, :256]
    sky = np.stack([255 - 0.3 * rows, 160 - 0.4 * rows + 0.05 * cols, 90 - 0.2 * rows], axis=-1).astype(np.uint8)
    data = jpeg(sky)
    error = decoded(data) - sky
    assert np.sqrt(np.mean(error**2)) < 1.0  # less than a code: no blocks are seen
    noise = np.random.default_rng(3).integers(0, 256, (256, 256, 3), np.uint8)
    assert len(jpeg(noise)) < 0.33 * noise.size  # of the worst picture: qualities of 70 to 92


def test_codes_are_the_standard_curve():
    assert (SRGB_CODES[0], SRGB_CODES[-1]) == (0, 255)
    assert SRGB_CODES[round(0.215861 * (len(SRGB_CODES) - 1))] == 128  # ((128 / 255 + 0.055) / 1.055) ** 2.4


def test_alpha_lets_the_ground_through():
    pixels = np.zeros((64, 64, 4), np.uint8)
    pixels[:32] = (200, 100, 50, 255)
    pixels[32:48] = (200, 100, 50, 128)
    seen = decoded(picture_jpeg(pixels))
    colour, ground = np.array((50, 100, 200)), np.array(GROUND)
    assert np.abs(seen[8] - colour).max() <= 3  # JPEG's own error
    assert np.abs(seen[40] - (colour + ground) / 2).max() <= 4
    assert np.abs(seen[60] - ground).max() <= 3


def code(level: float) -> int:
    """The sRGB code of Reinhard's curve (equation 4, white at 6) at a level, in the unit in which the log-average is 0.2."""
    display = min(level * (1 + level / 36) / (1 + level), 1)
    return round(255 * (1.055 * display ** (1 / 2.4) - 0.055))


def codes_of(levels: np.ndarray, sky: Sky | None = None) -> np.ndarray:
    """Gray codes of a map of 90 x 360 cells whose first cells at the horizon have `levels`, in units of the rest."""
    radiance = np.ones((90, 360, 3), np.float32)
    radiance[-1, : len(levels)] = np.asarray(levels)[:, None]
    return (sky or Sky()).codes(radiance, "hemisphere")[..., 0].astype(int)


def test_the_curve_is_reinhards_with_its_key_and_white():
    codes = codes_of(np.array([5.0, 15.0, 30.0, 100.0]))
    assert abs(codes[0, 0] - code(0.2)) <= 1
    assert np.abs(codes[-1, :4] - [code(1.0), code(3.0), 255, 255]).max() <= 2  # the four cells move the log-average by 0.1 %
    assert code(6.0) == 255 > code(5.5)


def test_the_eye_takes_15_percent_of_the_way_to_a_new_brightness():
    sky = Sky()
    codes_of(np.empty(0), sky)
    after = sky.codes(np.full((90, 360, 3), 4.0, np.float32), "hemisphere")[0, 0, 0]
    assert abs(int(after) - code(0.2 * 4 ** 0.85)) <= 1


def test_black_cells_count_as_a_millionth_of_the_mean():
    radiance = np.ones((90, 360, 3), np.float32)
    radiance[:, ::2] = 0
    lit = Sky().codes(radiance, "hemisphere")[0, 1, 0]
    assert abs(int(lit) - code(0.2 / np.exp((np.log(1) + np.log(0.5e-6)) / 2))) <= 1
    few = np.ones((90, 360, 3), np.float32)
    few[:, ::20] = 0  # one in 20, whose logarithm of 1e-6 lowers the mean by 0.69
    assert abs(int(Sky().codes(few, "hemisphere")[0, 1, 0]) - code(0.2 / np.exp(np.log(0.95e-6) / 20))) <= 1


def test_every_code_has_its_linear_values():
    assert len(np.unique(SRGB_CODES)) == 256


def test_the_map_goes_on_across_its_seam_and_over_the_pole():
    codes = np.arange(3 * 8).reshape(3, 8, 1).astype(np.uint8)
    wide = _with_neighbours(codes)[..., 0]
    assert wide[1:-1, 0].tolist() == codes[:, -1, 0].tolist()
    assert wide[1:-1, -1].tolist() == codes[:, 0, 0].tolist()
    assert wide[0, 1:-1].tolist() == [4, 5, 6, 7, 0, 1, 2, 3]
    assert wide[-1, 1:-1].tolist() == codes[-1, :, 0].tolist()
