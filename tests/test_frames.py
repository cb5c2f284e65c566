"""One image made into one frame."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from vemlight.capture import fisheye, pixel_overlap, scatter
from vemlight.capture import lens as lens_module
from vemlight.capture.fisheye import colour_lattices
from vemlight.capture.frames import FrameMaker, brightest_cells
from vemlight.capture.lens import Lens, direction_from_pixel, pixel_angles, pixel_solid_angles, vignetting_from_angle, write_lens
from vemlight.capture.response import Linear, Log, code_from_radiance, write_response
from vemlight.capture.simulation.environment import Environment, SunDisc
from vemlight.capture.simulation.optics import fisheye_radiance
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import write_exr
from vemlight.light.sphere import angle_between, cell_directions, direction_from_angles, map_irradiance
from vemlight.settings import Capture

LENS = Lens(size=(512, 512), f=(151.0, 151.0), c=(255.3, 255.8), k1=-0.008, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)
B = 65535 / np.log(1e10)
RESPONSE = Log(bits=16, a=float(-B * np.log(1e-3)), b=float(B), c=1e-3)  # 16 bits: what is tested here is geometry
SMALL = Lens(size=(100, 100), f=(29.0, 29.0), c=(49.5, 49.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)
DARK = np.zeros((16, 32, 3))


@pytest.fixture(scope="module")
def maker(tmp_path_factory: pytest.TempPathFactory) -> FrameMaker:
    folder = tmp_path_factory.mktemp("camera")
    write_lens(folder / "lens.toml", LENS)
    write_response(folder / "response.toml", RESPONSE)
    return FrameMaker(Capture(), folder)


def light_centre(frame) -> np.ndarray:
    """Direction to the centre of all light, bright cells by their own samples."""
    where = cell_directions(90, 360, "hemisphere").reshape(-1, 3).copy()
    inside = np.zeros((len(where), 3))
    np.add.at(inside, frame.bright_cells.cells, frame.bright_cells.directions * frame.bright_cells.weights[:, None])
    where[frame.bright_cells.cells] = inside[frame.bright_cells.cells]
    rings = 2 * np.pi / 360 * -np.diff(np.cos(np.arange(91) * np.pi / 180))
    total = (luminance_from_rgb(frame.radiance.astype(np.float64)) * rings[:, None]).ravel() @ where
    return total / np.linalg.norm(total)


@pytest.mark.parametrize("changed", [{"rim_deg": 0.2}, {"c": (900.0, 49.5)}])
def test_a_lens_that_sees_nothing_of_the_map_is_refused(tmp_path, changed):
    write_lens(tmp_path / "lens.toml", msgspec.structs.replace(SMALL, **changed))
    with pytest.raises(UserError, match=r"lens\.toml: no pixel of the frame looks into the hemisphere"):
        FrameMaker(Capture(), tmp_path).frame("a", np.ones((100, 100, 3), np.float32), {}, 0.0)


def test_sun_keeps_power_and_place_at_any_position(maker: FrameMaker) -> None:
    rng = np.random.default_rng(12)
    for _ in range(25):
        direction = direction_from_angles(np.arccos(rng.uniform(0.02, 1)), rng.uniform(0, 2 * np.pi))
        sun = SunDisc(direction, np.radians(0.135), np.array([4.0, 4.0, 4.0]))
        codes = code_from_radiance(fisheye_radiance(Environment(DARK, [sun]), np.eye(3), LENS), RESPONSE)
        frame = maker.frame_from_codes("sun", codes, None, 0.0)
        np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), 4.0, rtol=0.005)
        # a pixel is 0.38 degrees here and a sun inside one has that pixel's place: half of its diagonal
        assert np.degrees(angle_between(light_centre(frame), direction)) < 0.27
        assert len(frame.bright_cells.cells) >= 1


def test_bright_cells_are_few_and_in_order() -> None:
    radiance = np.ones((90, 360, 3), np.float32)
    assert len(brightest_cells(radiance, "hemisphere")) == 0
    radiance[30, 40], radiance[60, 80], radiance[10, 10] = 1e6, 1e6, np.nan
    assert brightest_cells(radiance, "hemisphere").tolist() == [60 * 360 + 80, 30 * 360 + 40]
    assert len(brightest_cells(np.zeros((90, 360, 3), np.float32), "hemisphere")) == 0
    radiance[:] = 0
    radiance[40, :200] = 1
    assert len(brightest_cells(radiance, "hemisphere")) == 64


def test_centres_of_a_latlong_map_are_finer_than_its_cells(tmp_path: Path) -> None:
    maker = FrameMaker(Capture(), tmp_path)
    rng = np.random.default_rng(3)
    for _ in range(20):
        image = np.full((512, 1024, 3), 0.1, np.float32)
        row, col = rng.integers(5, 250), rng.integers(0, 1024)
        image[row, col] = 1e5
        frame = maker.frame("map", image, {}, 0.0)
        truth = direction_from_angles((row + 0.5) * np.pi / 512, np.pi - (col + 0.5) * 2 * np.pi / 1024)
        cells, centres, weights = frame.bright_cells
        flux = weights * luminance_from_rgb(frame.radiance.reshape(-1, 3)[cells]) * np.sin((cells // 360 + 0.5) * np.pi / 180)
        centre = (flux[:, None] * centres).sum(0)
        # parts of the pixel in two cells each have their own middle; together they make the pixel's
        assert np.degrees(angle_between(centre / np.linalg.norm(centre), truth)) < 0.02
        np.testing.assert_allclose(np.linalg.norm(centres, axis=1), 1, atol=1e-6)


def mosaic_of(codes: np.ndarray, bayer: str) -> np.ndarray:
    mosaic = np.empty(codes.shape[:2], codes.dtype)
    for n, colour in enumerate(bayer):
        mosaic[n // 2 :: 2, n % 2 :: 2] = codes[n // 2 :: 2, n % 2 :: 2, "RGB".index(colour)]
    return mosaic


@pytest.mark.parametrize("bayer", ["RGGB", "GBRG"])
def test_bayer_mosaic_gives_the_colours_of_three_full_channels(tmp_path: Path, bayer) -> None:
    y, x = np.mgrid[:512, :512]
    smooth = np.stack([1 + 0.5 * np.sin(x / 90), 2 + np.cos(y / 70), 1 + 0.3 * np.sin((x + y) / 80)], -1)
    codes = code_from_radiance(smooth * np.array([1.0, 3.0, 0.4]), RESPONSE)
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    full = FrameMaker(Capture(rows=45, cols=180), tmp_path).frame_from_codes("f", codes, None, 0.0)
    raw = FrameMaker(Capture(rows=45, cols=180), tmp_path).frame_from_codes("m", mosaic_of(codes, bayer), bayer, 0.0)
    np.testing.assert_allclose(map_irradiance(raw.radiance, "hemisphere"), map_irradiance(full.radiance, "hemisphere"), rtol=5e-4)
    # cells at the horizon are seen through the coarser lattice's edge
    np.testing.assert_allclose(raw.radiance[:43], full.radiance[:43], rtol=0.03)


def test_lattices_cover_every_pixel_once() -> None:
    for colour, lattices in zip("RGB", colour_lattices("GRBG"), strict=True):
        seen = np.zeros((4, 4), int)
        for (x, y), (dx, dy), (w, h) in lattices:
            seen[y::dy, x::dx] += w * h
        assert seen.sum() == 16
        assert np.count_nonzero(seen) == (8 if colour == "G" else 4)


def test_gray_camera_gives_gray_maps(maker: FrameMaker, tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    codes = np.full((512, 512), code_from_radiance(np.array(0.7), RESPONSE), np.uint16)
    frame = FrameMaker(Capture(), tmp_path).frame_from_codes("gray", codes, "mono", 1.5)
    # 16 bits over ten decades: a code is 3.5e-4; the weights are even to 5e-3
    np.testing.assert_allclose(frame.radiance, 0.7, rtol=8e-3)
    assert (frame.time_s, frame.black, frame.saturated) == (1.5, 0, 0)


def test_code_above_the_response_is_refused(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", msgspec.structs.replace(RESPONSE, bits=12))
    codes = np.full((512, 512), 5000, np.uint16)
    with pytest.raises(UserError, match="code 5000 and the response 12 bits"):
        FrameMaker(Capture(), tmp_path).frame_from_codes("raw", codes, "mono", 0.0)


def test_flat_field_takes_the_place_of_vignetting(tmp_path: Path) -> None:
    shade = vignetting_from_angle(pixel_angles(LENS), msgspec.structs.replace(LENS, vignetting=(-0.1,)))
    spots = 1 + 0.05 * np.random.default_rng(0).standard_normal(shade.shape)
    flat = np.where(pixel_solid_angles(LENS) > 0, shade * spots, 0)
    write_exr(tmp_path / "flat.exr", (40 * flat).astype(np.float32))
    write_lens(tmp_path / "lens.toml", msgspec.structs.replace(LENS, flat_field="flat.exr"))
    image = np.repeat((0.3 * flat)[..., None], 3, -1).astype(np.float32)
    frame = FrameMaker(Capture(), tmp_path).frame("even", image, {}, 0.0)
    # the axis itself is known from some hundred pixels with 5 % spots
    np.testing.assert_allclose(frame.radiance, 0.3, rtol=0.015)
    write_exr(tmp_path / "flat.exr", np.ones((4, 4), np.float32))
    with pytest.raises(UserError, match="flat"):
        FrameMaker(Capture(), tmp_path).frame("even", image, {}, 0.0)


@pytest.mark.parametrize("mosaic", ["mono", "RGGB"])
def test_nothing_is_left_to_compile_after_a_dark_frame(tmp_path: Path, mosaic) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    maker = FrameMaker(Capture(), tmp_path)
    maker.frame_from_codes("dark", np.zeros((512, 512), np.uint16), mosaic, 0.0)
    modules = (fisheye, scatter, pixel_overlap, lens_module)
    compiled = [loop for module in modules for loop in vars(module).values() if hasattr(loop, "signatures")]
    before = [len(loop.signatures) for loop in compiled]
    codes = np.zeros((512, 512), np.uint16)
    codes[200:204, 300:304] = 60000
    assert len(maker.frame_from_codes("lit", codes, mosaic, 0.0).bright_cells.cells)
    assert [len(loop.signatures) for loop in compiled] == before


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("position", range(4))
def test_a_lit_pixel_of_a_mosaic_lights_its_colour_alone(tmp_path: Path, pattern, position: int) -> None:
    write_lens(tmp_path / "lens.toml", SMALL)
    write_response(tmp_path / "response.toml", Linear(bits=12, a=0.0, b=1.0))
    x, y = 60 + position % 2, 52 + position // 2
    codes = np.zeros((100, 100), np.uint16)
    codes[y, x] = 1000
    frame = FrameMaker(Capture(rows=20, cols=60), tmp_path).frame_from_codes("one", codes, pattern, 0.0)
    # a red or blue pixel represents 2 x 2 pixels, a green one 2 x 1
    colour = pattern[position]
    area = {"R": (4, 0, 0), "G": (0, 2, 0), "B": (0, 0, 4)}[colour]
    np.testing.assert_allclose(
        map_irradiance(frame.radiance, "hemisphere"), 1000 * pixel_solid_angles(SMALL)[y, x] * np.array(area), rtol=1e-5
    )
    # luminance is that of the green pixels: only their light is located inside a cell
    assert bool(len(frame.bright_cells.cells)) == (colour == "G")
    if colour == "G":
        towards = direction_from_pixel(np.array([x, y]), SMALL)
        np.testing.assert_allclose(frame.bright_cells.directions, np.broadcast_to(towards, frame.bright_cells.directions.shape), atol=1e-6)


def test_clipped_codes_of_all_colours_are_counted(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", SMALL)
    write_response(tmp_path / "response.toml", Linear(bits=12, a=0.0, b=1.0))
    codes = np.full((100, 100), 1000, np.uint16)
    codes[50:52, 50:52] = 4095  # a pixel each of red and blue, and two of green
    codes[40:42, 40:42] = 0
    frame = FrameMaker(Capture(rows=20, cols=60), tmp_path).frame_from_codes("four", codes, "RGGB", 0.0)
    assert (frame.black, frame.saturated) == (4, 4)


@pytest.mark.parametrize(("fraction", "count"), [(1 / 550, 0), (1 / 450, 1)])
def test_a_cell_with_a_five_hundredth_of_the_power_is_bright(fraction: float, count: int) -> None:
    radiance = np.ones((90, 360, 3), np.float32)
    solid = 2 * np.pi / 360 * -np.diff(np.cos(np.arange(91) * np.pi / 180))
    radiance[45, 7] = fraction / (1 - fraction) * (2 * np.pi - solid[45]) / solid[45]
    assert len(brightest_cells(radiance, "hemisphere")) == count


@pytest.mark.parametrize("name", ["/etc/passwd", "../flat.exr", "http://host/flat.exr"])
def test_the_flat_field_lies_beside_its_lens(tmp_path: Path, name: str) -> None:
    write_lens(tmp_path / "lens.toml", msgspec.structs.replace(LENS, flat_field=name))
    maker = FrameMaker(Capture(lens=str(tmp_path / "lens.toml")), tmp_path)
    with pytest.raises(UserError, match=r"lens\.toml: flat_field: .*(leads out|is an address)"):
        maker.frame("a.exr", np.ones((LENS.size[1], LENS.size[0], 3), np.float32), {}, 0.0)
