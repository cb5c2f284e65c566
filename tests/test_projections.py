"""Every projection against light whose power and direction are known in closed form: lobes e^{k (cos - 1)} from directions of all kinds."""

import msgspec
import numpy as np
import pytest

from vemlight.capture.cube import cube_directions, cube_to_polar, is_cube
from vemlight.capture.fisheye import ALL_PIXELS, fisheye_to_polar
from vemlight.capture.lens import Lens, check_lens, direction_from_pixel, pixel_angles, pixel_from_direction
from vemlight.capture.polar import latlong_bright_cells, latlong_to_polar, polar_from_latlong, used_rows
from vemlight.capture.scatter import polar_from_fisheye
from vemlight.capture.several_lenses import check_lenses, directions_of, lens_weights, lenses_to_polar
from vemlight.errors import UserError
from vemlight.light.sphere import cell_directions, cell_solid_angles, latlong_directions

ROWS, COLS = 90, 180  # of a sphere, 2 x 2 degrees
SHARPNESS = 300.0  # of a lobe: half of its light within 4 degrees
LOBE_POWER = 2 * np.pi * (1 - np.exp(-2 * SHARPNESS)) / SHARPNESS
LAMPS = np.array([[0.3, 0.5, 0.81], [0, 0, 1], [-1, 0, 0], [1, -1, 0], [0.2, 0.9, -0.4], [0.01, 0.02, -1], [1, 0, 0], [1, 1, 1]], float)
LAMPS /= np.linalg.norm(LAMPS, axis=1, keepdims=True)
UP, DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def lobe(directions, lamp):
    """(.., 3) float32 of directions (.., 3)."""
    return np.repeat(np.exp(SHARPNESS * (directions @ lamp - 1))[..., None], 3, axis=-1).astype(np.float32)


def power_and_direction(polar):
    weight = polar[..., 1] * cell_solid_angles(ROWS, COLS, "sphere")[:, None]
    mean = np.einsum("ij,ijc->c", weight, cell_directions(ROWS, COLS, "sphere"))
    return weight.sum(), mean / np.linalg.norm(mean)


def assert_is_lamp(polar, lamp, power=0.01, degrees=0.1):
    found, direction = power_and_direction(polar)
    assert found == pytest.approx(LOBE_POWER, rel=power)
    assert np.degrees(np.arccos(np.clip(direction @ lamp, -1, 1))) < degrees


def grid(width, height):
    y, x = np.mgrid[:height, :width]
    return np.stack([x, y], axis=-1).reshape(-1, 2).astype(float)


def two_lenses(rim_deg=97.0, radius=127.0):
    """A camera's two circles side by side, the left one looking up; f such that the rim lies at `radius`."""
    f = radius / np.radians(rim_deg)
    common = {"size": (512, 256), "f": (f, f), "k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.0, "rim_deg": rim_deg}
    return [Lens(c=(127.5, 127.5), world_from_camera=DOWN, **common), Lens(c=(383.5, 127.5), world_from_camera=UP, **common)]


def seen_by(lenses, light):
    """The image (height, width, 3) of the function `light` of directions (n, 3) through lenses that share a frame."""
    width, height = lenses[0].size
    image = np.zeros((height * width, 3), np.float32)
    for lens in lenses:
        inside = pixel_angles(lens).ravel() <= lens.rim
        image[inside] = light(direction_from_pixel(grid(width, height)[inside], lens) @ lens.rotation.T)
    return image.reshape(height, width, 3)


@pytest.mark.parametrize("lamp", LAMPS, ids=str)
def test_cube(lamp):
    side = 128
    directions = cube_directions(grid(3 * side, 2 * side), side)
    polar = polar_from_fisheye(lobe(directions, lamp).reshape(2 * side, 3 * side, 3), cube_to_polar(side, ROWS, COLS, "sphere"))
    assert_is_lamp(polar, lamp, power=0.002, degrees=0.05)


def test_the_faces_of_a_cube():
    """Right left up over down front back, and the edges that touch front."""
    side = 100
    middles = np.array([[side * (n % 3 + 0.5) - 0.5, side * (n // 3 + 0.5) - 0.5] for n in range(6)])
    np.testing.assert_allclose(
        cube_directions(middles, side), [[0, -1, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]], atol=1e-12
    )
    right, left, up, down, front, back = (np.array(n) * side for n in [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)])
    low, high, middle = -0.5, side - 0.5 - 1e-9, side / 2 - 0.5
    for a, at, b, touches in [
        (up, (middle, high), front, (middle, low)),
        (down, (middle, low), front, (middle, high)),
        (right, (low, middle), front, (high, middle)),
        (left, (high, middle), front, (low, middle)),
        (right, (high, middle), back, (low, middle)),
        (left, (low, middle), back, (high, middle)),
    ]:
        np.testing.assert_allclose(*cube_directions(np.array([a + at, b + touches]), side), atol=1e-6)


@pytest.mark.parametrize("side", [31, 128])
def test_even_light_in_a_cube_is_even_and_whole(side):
    polar = polar_from_fisheye(np.ones((2 * side, 3 * side, 3), np.float32), cube_to_polar(side, ROWS, COLS, "sphere"))
    assert power_and_direction(polar)[0] == pytest.approx(4 * np.pi, rel=1e-3)
    assert polar.min() > 0.7  # no cell is left empty between the pixels of a small map
    assert polar.max() < 1.25


@pytest.mark.parametrize(("size", "fits"), [((96, 64), True), ((97, 64), False), ((100, 50), False), ((64, 96), False), ((95, 63), False)])
def test_which_sizes_are_cubes(size, fits):
    assert is_cube(*size) is fits


@pytest.mark.parametrize("lamp", LAMPS, ids=str)
def test_two_lenses_keep_power_and_direction(lamp):
    """The horizon, where both lenses see, too."""
    lenses = two_lenses()
    weights = lenses_to_polar(lenses, ROWS, COLS, "sphere", ALL_PIXELS, [None, None])
    assert_is_lamp(polar_from_fisheye(seen_by(lenses, lambda d: lobe(d, lamp)), weights), lamp, power=0.01, degrees=0.2)


def test_weights_of_a_direction_add_up_to_1():
    lenses = two_lenses()
    weights = lens_weights(lenses)
    rng = np.random.default_rng(5)
    tilt = rng.uniform(-7, 7, 2000)  # degrees from the seam, which the rims at 97 degrees overlap by 7 either way
    phi = rng.uniform(0, 2 * np.pi, 2000)
    directions = np.stack(
        [np.cos(np.radians(tilt)) * np.cos(phi), np.cos(np.radians(tilt)) * np.sin(phi), np.sin(np.radians(tilt))], axis=1
    )
    total = np.zeros(2000)
    for lens, weight in zip(lenses, weights, strict=True):
        x, y = np.rint(pixel_from_direction(directions @ lens.rotation, lens)).astype(int).T
        total += weight[np.clip(y, 0, 255), np.clip(x, 0, 511)]
    # a pixel is .75 degrees of a taper of 14 degrees
    np.testing.assert_allclose(total, 1, atol=0.08)
    assert abs(total.mean() - 1) < 0.005


def test_even_light_in_two_lenses_is_even():
    lenses = two_lenses()
    weights = lenses_to_polar(lenses, ROWS, COLS, "sphere", ALL_PIXELS, [None, None])
    polar = polar_from_fisheye(seen_by(lenses, lambda d: np.ones((len(d), 3), np.float32)), weights)
    np.testing.assert_allclose(polar, 1, atol=0.05)
    assert power_and_direction(polar)[0] == pytest.approx(4 * np.pi, rel=2e-3)


def test_vignetting_of_each_lens_is_divided_out():
    plain = two_lenses()
    lenses = [plain[0], msgspec.structs.replace(plain[1], vignetting=(-0.1,))]
    image = seen_by(lenses, lambda d: np.ones((len(d), 3), np.float32))
    theta = np.minimum(pixel_angles(lenses[1]), lenses[1].rim)
    in_second = pixel_angles(lenses[1]) <= lenses[1].rim
    image[in_second] *= (1 - 0.1 * theta**2)[in_second][:, None]
    polar = polar_from_fisheye(image, lenses_to_polar(lenses, ROWS, COLS, "sphere", ALL_PIXELS, [None, None]))
    np.testing.assert_allclose(polar, 1, atol=0.05)


def test_a_lens_alone_is_as_it_was():
    lens = two_lenses(rim_deg=85.0)[0]
    alone, before = lenses_to_polar([lens], 45, 180, "hemisphere", ALL_PIXELS, [None]), fisheye_to_polar(lens, 45, 180, "hemisphere")
    np.testing.assert_array_equal(alone.pixel, before.pixel)
    np.testing.assert_array_equal(alone.weight, before.weight)


def test_directions_are_of_the_lens_whose_circle_it_is():
    lenses = two_lenses()
    found = directions_of(lenses, np.array([[127.5, 127.5], [383.5, 127.5], [10.0, 127.5]]))
    np.testing.assert_allclose(found[:2], [[0, 0, 1], [0, 0, -1]], atol=1e-12)
    assert found[2] @ lenses[0].rotation[:, 2] < 0.1


def test_a_gap_is_said_and_circles_on_each_other_are_refused(capsys):
    check_lenses(["front", "back"], two_lenses(), "sphere")
    assert not capsys.readouterr().err
    check_lenses(["front", "back"], two_lenses(rim_deg=80.0), "sphere")
    assert "front, back: 11" in (line := capsys.readouterr().err)
    assert "gap between the lenses" in line
    with pytest.raises(UserError, match=r"front, back: their circles share \d+% of their pixels"):
        check_lenses(["front", "back"], [two_lenses()[0]] * 2, "sphere")


@pytest.mark.parametrize("lamp", LAMPS[[0, 1, 4]], ids=str)
def test_an_angular_map_is_a_fisheye_of_180_degrees(lamp):
    """Debevec's light probes: radius = angle, the whole sphere in one circle."""
    side = 256
    f, c = side / 2 / np.pi, (side - 1) / 2
    lens = Lens(size=(side, side), f=(f, f), c=(c, c), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=180.0)
    weights = fisheye_to_polar(lens, ROWS, COLS, "sphere")
    assert_is_lamp(polar_from_fisheye(seen_by([lens], lambda d: lobe(d, lamp)), weights), lamp, power=0.01, degrees=0.2)


@pytest.mark.parametrize("span", [(360.0, 120.0), (180.0, 180.0), (200.0, 100.0), (90.0, 60.0)])
@pytest.mark.parametrize("lamp", LAMPS[[6, 0]], ids=str)
def test_a_part_of_the_sphere(span, lamp):
    """The middle `span` of a lat-long map alone: the map inside is the whole one's, and black outside."""
    height, width = 360, 720
    whole = lobe(latlong_directions(height, width), lamp)
    down, across = round(height * span[1] / 180), round(width * span[0] / 360)
    part = whole[(height - down) // 2 : (height + down) // 2, (width - across) // 2 : (width + across) // 2]
    masked = np.zeros_like(whole)
    masked[(height - down) // 2 : (height + down) // 2, (width - across) // 2 : (width + across) // 2] = part
    weights = latlong_to_polar(down, across, ROWS, COLS, "sphere", span)
    reference = latlong_to_polar(height, width, ROWS, COLS, "sphere")
    polar, wanted = polar_from_latlong(np.ascontiguousarray(part), weights), polar_from_latlong(masked, reference)
    np.testing.assert_allclose(polar, wanted, atol=1e-6)
    cells = np.argsort(polar[..., 1].ravel())[-3:].astype(np.int32)
    found, known = latlong_bright_cells(part, weights, cells, "sphere"), latlong_bright_cells(masked, reference, cells, "sphere")
    np.testing.assert_allclose(found.directions, known.directions, atol=1e-5)


def test_a_part_that_is_the_whole_is_the_whole():
    whole, said = latlong_to_polar(64, 128, 30, 60, "hemisphere"), latlong_to_polar(64, 128, 30, 60, "hemisphere", (360.0, 180.0))
    for a, b in zip((*whole.rows, *whole.cols), (*said.rows, *said.cols), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_hemisphere_needs_the_upper_rows_alone():
    assert used_rows(latlong_to_polar(1024, 2048, 90, 360, "hemisphere")) == 512
    assert used_rows(latlong_to_polar(1024, 2048, 180, 360, "sphere")) == 1024


@pytest.mark.parametrize("lamp", LAMPS[[0, 2, 3, 4, 6]], ids=str)
def test_a_mirror_ball(lamp):
    """The ball's own geometry: at x, y in radii the normal is (x, y, -sqrt(1 - x^2 - y^2)), and the view from afar is mirrored by it."""
    side, world_from_camera = 384, ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))  # the camera looks along +Y
    c = (side - 1) / 2
    lens = Lens(size=(side, side), f=(side / 4, side / 4), c=(c, c), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=178.0,
                model="mirrorball", reflectance=0.5, world_from_camera=world_from_camera)  # fmt: skip
    check_lens(lens)
    x, y = ((grid(side, side) - (side - 1) / 2) / (side / 2)).T
    inside = np.hypot(x, y) < 1
    normal = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=1)
    view = np.array([0.0, 0.0, 1.0])
    reflected = (view - 2 * (normal @ view)[:, None] * normal) @ np.array(world_from_camera).T
    image = np.where(inside[:, None], 0.5 * lobe(reflected, lamp), 0).astype(np.float32).reshape(side, side, 3)
    polar = polar_from_fisheye(image, fisheye_to_polar(lens, ROWS, COLS, "sphere"))
    assert_is_lamp(polar, lamp, power=0.02, degrees=0.3)


@pytest.mark.parametrize(("changes", "words"), [
    ({"k1": 0.1}, "are of a fisheye, and model is mirrorball"), ({"reflectance": 0.0}, "reflectance = 0"),
    ({"reflectance": 1.5}, "reflectance"),
    ({"model": "fisheye", "reflectance": 0.5}, "is of a mirror ball"),
])  # fmt: skip
def test_what_is_no_mirror_ball(changes, words):
    values = {"size": (64, 64), "f": (16.0, 16.0), "c": (31.5, 31.5), "k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.0, "rim_deg": 178.0}
    with pytest.raises(UserError, match=words):
        check_lens(Lens(**values | {"model": "mirrorball"} | changes))
