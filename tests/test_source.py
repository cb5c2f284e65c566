"""Image files replayed as polar maps."""

import os
from fractions import Fraction
from pathlib import Path

import msgspec
import numpy as np
import pytest

from vemlight.capture.camera_source import raw_attributes
from vemlight.capture.lens import Lens, pixel_from_direction, write_lens
from vemlight.capture.manifest import MANIFEST, manifest_entry
from vemlight.capture.recording import polar_file
from vemlight.capture.response import Log, Srgb, code_from_radiance, write_response
from vemlight.capture.source import open_source, recorded_fps
from vemlight.capture.v4l2 import RawFrame
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance, write_exr, write_png
from vemlight.light.sphere import (
    angle_between,
    cell_directions,
    direction_from_angles,
    latlong_from_direction,
    latlong_solid_angles,
    map_irradiance,
)
from vemlight.settings import Capture

LENS = Lens(size=(128, 128), f=(37.0, 37.0), c=(63.5, 63.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)
RESPONSE = Log(bits=12, a=1000.0, b=200.0, c=0.01, luminance_scale=179.0)


def capture(source: Path, **changes: object) -> Capture:
    return Capture(source=str(source), **changes)  # type: ignore[arg-type]


def peak_direction(radiance: np.ndarray) -> np.ndarray:
    rows, cols, _ = radiance.shape
    y = luminance_from_rgb(radiance)
    return cell_directions(rows, cols, "hemisphere")[np.unravel_index(int(y.argmax()), y.shape)]


def test_one_lit_pixel_of_a_latlong_file(tmp_path: Path) -> None:
    direction = direction_from_angles(0.7, 2.1)
    image = np.zeros((256, 512, 3), np.float32)
    row, col = latlong_from_direction(direction, 256, 512)
    image[int(row), int(col)] = (1.0, 2.0, 3.0)
    write_exr(tmp_path / "one.exr", image)
    frame = open_source(capture(tmp_path / "one.exr")).frame(0)
    # half a cell and half a pixel: 0.7 and 0.5 degrees across their diagonals
    assert np.degrees(angle_between(peak_direction(frame.radiance), direction)) < 1.2
    power = np.array([1, 2, 3]) * latlong_solid_angles(256, 512)[int(row)]
    np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), power, rtol=1e-6)


@pytest.mark.parametrize("raw", [False, True])
def test_one_lit_pixel_of_a_fisheye_file(tmp_path: Path, raw: bool) -> None:
    direction = direction_from_angles(0.9, 4.0)
    x, y = np.rint(pixel_from_direction(direction, LENS)).astype(int)
    image = np.zeros((128, 128, 3), np.float32)
    image[y, x] = 500.0
    write_lens(tmp_path / "lens.toml", LENS)
    if raw:
        write_response(tmp_path / "response.toml", RESPONSE)
        image = code_from_radiance(image, RESPONSE).astype(np.float32)
    write_exr(tmp_path / "one.exr", image)
    frame = open_source(capture(tmp_path / "one.exr")).frame(0)
    assert np.degrees(angle_between(peak_direction(frame.radiance), direction)) < 1.8  # a pixel is 1.5 degrees
    assert frame.luminance_scale == (179.0 if raw else None)


def test_codes_bring_counts_of_what_was_clipped(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    image = np.full((128, 128, 3), 2000.0, np.float32)
    image[0, 0] = 0  # outside the rim: not counted
    image[64, 60:63] = 4095
    image[64, 70, 1] = 0
    write_exr(tmp_path / "codes.exr", image)
    frame = open_source(capture(tmp_path / "codes.exr")).frame(0)
    assert (frame.black, frame.saturated) == (1, 9)


def test_same_frame_same_bits(sequence: Path) -> None:
    source = open_source(capture(sequence))
    first = [source.frame(k).radiance.tobytes() for k in range(3)]
    again = [source.frame(k).radiance.tobytes() for k in (2, 0, 1)]
    assert first == [again[1], again[2], again[0]]
    assert len(set(first)) == 3


def test_times_come_from_fps(sequence: Path) -> None:
    source = open_source(capture(sequence, fps=10.0))
    assert (len(source), source.fps) == (16, 10.0)
    assert source.frame(3).time_s == pytest.approx(0.3)


def test_times_come_from_the_recording(tmp_path: Path) -> None:
    for k in range(2):
        write_exr(tmp_path / f"f{k}.exr", np.ones((16, 32, 3), np.float32), {"framesPerSecond": Fraction(24000, 1001)})
    lines = [msgspec.json.encode(manifest_entry(tmp_path / f"f{k}.exr", k, 7.5 + k)) for k in range(2)]
    (tmp_path / MANIFEST).write_bytes(b"\n".join(lines))
    source = open_source(capture(tmp_path))
    assert source.fps == pytest.approx(24000 / 1001)
    assert source.frame(1).time_s == 8.5
    twice = open_source(capture(tmp_path, speed=2.0))
    assert twice.fps == pytest.approx(2 * 24000 / 1001)
    assert twice.frame(1).time_s == 4.25


def test_changed_frame_of_a_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "f0.exr"
    write_exr(path, np.ones((16, 32, 3), np.float32))
    (tmp_path / MANIFEST).write_bytes(msgspec.json.encode(manifest_entry(path, 0, 0.0)))
    write_exr(path, np.full((16, 32, 3), 2.0, np.float32))
    with pytest.raises(UserError, match=r"f0\.exr: is not what was recorded"):
        open_source(capture(tmp_path)).frame(0)


def test_sphere(tmp_path: Path) -> None:
    image = np.random.default_rng(4).lognormal(0, 2, (64, 128, 3)).astype(np.float32)
    write_exr(tmp_path / "all.exr", image)
    frame = open_source(capture(tmp_path / "all.exr", rows=180, coverage="sphere")).frame(0)
    truth = np.einsum("ijc,i->c", image.astype(np.float64), latlong_solid_angles(64, 128))
    assert frame.radiance.shape == (180, 360, 3)
    np.testing.assert_allclose(map_irradiance(frame.radiance, "sphere"), truth, rtol=1e-6)


def test_invalid_pixels_are_counted(tmp_path: Path) -> None:
    image = np.ones((64, 128, 3), np.float32)
    image[10, 10] = np.nan
    image[12, 60] = np.inf
    write_exr(tmp_path / "bad.exr", image)
    radiance = open_source(capture(tmp_path / "bad.exr", rows=32, cols=128)).frame(0).radiance
    assert np.argwhere(~np.isfinite(radiance).all(-1)).tolist() == [[10, 53], [12, 3]]


def test_black_frame(tmp_path: Path) -> None:
    write_exr(tmp_path / "black.exr", np.zeros((64, 128, 3), np.float32))
    assert not open_source(capture(tmp_path / "black.exr")).frame(0).radiance.any()


def test_polar_file_is_a_source_of_the_same_map(tmp_path: Path) -> None:
    image = np.random.default_rng(9).uniform(0, 3000, (128, 128, 3)).round().astype(np.float32)
    write_exr(tmp_path / "codes.exr", image)
    write_lens(tmp_path / "l.toml", LENS)
    write_response(tmp_path / "r.toml", RESPONSE)
    settings = capture(tmp_path / "codes.exr", lens=str(tmp_path / "l.toml"), response=str(tmp_path / "r.toml"))
    polar_file(settings, tmp_path / "map.exr")
    direct = open_source(settings).frame(0)
    through = open_source(capture(tmp_path / "map.exr")).frame(0)
    assert through.radiance.tobytes() == direct.radiance.tobytes()
    assert through.luminance_scale == direct.luminance_scale == 179.0
    with pytest.raises(UserError, match="hemisphere of 90 x 360"):
        open_source(capture(tmp_path / "map.exr", rows=45)).frame(0)


def test_truncated_files_are_named(tmp_path: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    image = rng.lognormal(0, 2, (64, 128, 3)).astype(np.float32)
    write_exr(tmp_path / "cut.exr", image)
    cv2.imwrite(str(tmp_path / "cut.hdr"), image)
    for name in ("cut.exr", "cut.hdr"):
        path = tmp_path / name
        os.truncate(path, path.stat().st_size // 2)
        with pytest.raises(UserError, match=name):
            open_source(capture(path)).frame(0)


def test_two_sizes_are_refused(tmp_path: Path) -> None:
    write_exr(tmp_path / "f1.exr", np.ones((16, 32, 3), np.float32))
    write_exr(tmp_path / "f2.exr", np.ones((32, 64, 3), np.float32))
    source = open_source(capture(tmp_path))
    source.frame(0)
    with pytest.raises(UserError, match=r"f2\.exr: is 64x32 and the frames before it 32x16"):
        source.frame(1)


def test_lens_of_another_size_is_refused(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_exr(tmp_path / "f.exr", np.ones((64, 128, 3), np.float32))
    with pytest.raises(UserError, match="the lens file is for 128x128"):
        open_source(capture(tmp_path / "f.exr")).frame(0)


def test_raw_frames_require_lens_and_response(tmp_path: Path) -> None:
    write_exr(tmp_path / "f.exr", np.ones((128, 128, 3), np.float32), {"vemlight:kind": "codes"})
    with pytest.raises(UserError, match=r"lens\.toml is not there"):
        open_source(capture(tmp_path / "f.exr")).frame(0)
    write_lens(tmp_path / "lens.toml", LENS)
    with pytest.raises(UserError, match=r"response\.toml is not there"):
        open_source(capture(tmp_path / "f.exr")).frame(0)
    write_response(tmp_path / "response.toml", RESPONSE)
    open_source(capture(tmp_path / "f.exr")).frame(0)


@pytest.mark.parametrize("value", [0.5, -1.0, 4096.0, np.nan, np.inf])
def test_what_is_no_code_is_refused(tmp_path: Path, value: float) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    write_exr(tmp_path / "f.exr", np.full((128, 128, 3), value, np.float32))
    with pytest.raises(UserError, match=r"f\.exr.*code"):
        open_source(capture(tmp_path / "f.exr")).frame(0)


def codes_of(image: np.ndarray) -> np.ndarray:
    return code_from_radiance(image.astype(np.float64), RESPONSE)


@pytest.mark.parametrize(("form", "colour"), [("", False), ("Y12", False), ("GB12", False), ("", True)])
def test_png_frames_are_the_same_as_exr_frames(tmp_path: Path, form: str, colour: bool) -> None:
    rng = np.random.default_rng(8)
    for kind in ("png", "exr"):
        (tmp_path / kind).mkdir()
        write_lens(tmp_path / kind / "lens.toml", LENS)
        write_response(tmp_path / kind / "response.toml", RESPONSE)
    write_png(tmp_path / "png" / "lens.png", np.zeros((9, 9), np.uint8))  # what a calibration draws is no frame
    mosaic = {} if colour else {"vemlight:mosaic": "GBRG" if form == "GB12" else "mono"}
    for k in range(3):
        codes = codes_of(rng.lognormal(0, 2, (128, 128, 3) if colour else (128, 128)))
        write_png(tmp_path / "png" / f"f{k}.png", codes)
        write_exr(tmp_path / "exr" / f"f{k}.exr", codes.astype(np.float32), {"vemlight:kind": "codes", **mosaic})
    png, exr = open_source(capture(tmp_path / "png", format=form)), open_source(capture(tmp_path / "exr"))
    assert len(png) == len(exr) == 3
    for k in range(3):
        a, b = png.frame(k), exr.frame(k)
        assert a.radiance.tobytes() == b.radiance.tobytes()
        assert (a.time_s, a.black, a.saturated, a.luminance_scale) == (b.time_s, b.black, b.saturated, b.luminance_scale)


def test_png_frames_play_at_a_multiple_of_the_rate_in_the_settings(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    for k in range(2):
        write_png(tmp_path / f"f{k}.png", np.zeros((128, 128), np.uint16))
    source = open_source(capture(tmp_path, fps=10.0, speed=2.0))
    assert (source.fps, source.frame(1).time_s) == (20.0, 0.05)


def test_png_of_eight_bits(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", Srgb(bits=8))
    write_png(tmp_path / "f.png", np.full((128, 128), 255, np.uint8))
    frame = open_source(capture(tmp_path / "f.png")).frame(0)
    np.testing.assert_allclose(frame.radiance, 1.0, rtol=0.02)
    assert frame.saturated > 1000


def test_png_that_cannot_be_raw_is_refused(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    write_png(tmp_path / "f.png", np.zeros((128, 128, 3), np.uint8))
    with pytest.raises(UserError, match=r"f\.png: is in colour"):
        open_source(capture(tmp_path / "f.png", format="RG12")).frame(0)
    with pytest.raises(UserError, match="format = 'XY12' is not known"):
        open_source(capture(tmp_path / "f.png", format="XY12"))
    write_png(tmp_path / "g.png", np.full((128, 128), 4096, np.uint16))
    with pytest.raises(UserError, match=r"g\.png: has code 4096 and the response 12 bits"):
        open_source(capture(tmp_path / "g.png")).frame(0)
    (tmp_path / "h.png").write_bytes((tmp_path / "g.png").read_bytes()[:40])
    with pytest.raises(UserError, match=r"h\.png: is a PNG picture that is cut off"):
        open_source(capture(tmp_path / "h.png")).frame(0)


def test_unknown_kind_is_refused(tmp_path: Path) -> None:
    write_exr(tmp_path / "f.exr", np.ones((16, 32, 3), np.float32), {"vemlight:kind": "cube"})
    with pytest.raises(UserError, match="cube"):
        open_source(capture(tmp_path / "f.exr")).frame(0)


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file or folder"):
        open_source(capture(tmp_path / "nothing"))


def test_bundled_sequence_is_the_default() -> None:
    source = open_source(Capture())
    frame = source.frame(0)
    assert len(source) == 48
    assert frame.radiance.shape == (90, 360, 3)
    assert np.isfinite(frame.radiance).all()


def test_real_map() -> None:
    data = os.environ.get("VEMLIGHT_DATA")
    if not data:
        pytest.skip("VEMLIGHT_DATA names no folder of real maps")
    path = Path(data) / "hdri" / "kloppenheim_05_1k.hdr"
    image, _ = read_radiance(path)
    frame = open_source(capture(path)).frame(0)
    truth = np.einsum("ijc,i->c", image[:256].astype(np.float64), latlong_solid_angles(512, 1024)[:256])
    np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), truth, rtol=1e-6)


def test_header_of_a_cameras_frame_survives_the_file(tmp_path: Path) -> None:
    raw = RawFrame(np.zeros((4, 6), np.uint16), "RGGB", 2**31 + 5, 2**40 + 7, 0)
    assert raw.codes is not None
    write_exr(tmp_path / "f.exr", raw.codes.astype(np.float32), raw_attributes(raw, 29.97))
    _, attributes = read_radiance(tmp_path / "f.exr")
    assert attributes["vemlight:monotonic_ns"] == str(2**40 + 7)
    assert attributes["vemlight:kernel_sequence"] == str(2**31 + 5)
    assert attributes["vemlight:mosaic"] == "RGGB"
    assert float(Fraction(attributes["framesPerSecond"])) == pytest.approx(29.97, rel=1e-5)
    assert attributes["utcOffset"] == 0


@pytest.mark.parametrize("rate", [None, 0, "x", float("nan"), -5, 1e9, 1001])
def test_rate_of_a_hostile_header(rate: object) -> None:
    assert recorded_fps({} if rate is None else {"framesPerSecond": rate}, 25.0) == 25.0


@pytest.mark.parametrize(("rate", "fps"), [(Fraction(30000, 1001), 29.97), (1000, 1000.0)])
def test_rate_of_a_header(rate: object, fps: float) -> None:
    assert recorded_fps({"framesPerSecond": rate}, 25.0) == pytest.approx(fps, rel=1e-4)


def test_hostile_header(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    write_exr(tmp_path / "m.exr", np.ones((128, 128), np.float32), {"vemlight:kind": "codes", "vemlight:mosaic": "CMYK"})
    with pytest.raises(UserError, match="CMYK"):
        open_source(capture(tmp_path / "m.exr")).frame(0)
    write_exr(tmp_path / "s.exr", np.ones((16, 32, 3), np.float32), {"vemlight:kind": "latlong", "whiteLuminance": -3.0})
    assert open_source(capture(tmp_path / "s.exr")).frame(0).luminance_scale is None


def test_a_luminance_cameras_frame_has_its_makers_illuminance(tmp_path: Path) -> None:
    data = os.environ.get("VEMLIGHT_DATA")
    if not data:
        pytest.skip("VEMLIGHT_DATA names no folder of real frames")
    f = 786 / 2 / np.radians(91)  # -vta 182: angle by radius, even
    lens = Lens(size=(786, 786), f=(f, f), c=(392.5, 392.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=91.0)
    write_lens(tmp_path / "lens.toml", lens)
    path = Path(data) / "sequence" / "fisheye_hdr_office_evalglare.hdr"
    frame = open_source(capture(path, lens=str(tmp_path / "lens.toml"))).frame(0)
    cosine = np.cos((np.arange(90) + 0.5) * np.pi / 180)[:, None, None]  # on the plane that the camera faces
    lux = luminance_from_rgb(map_irradiance(frame.radiance * cosine, "hemisphere")) * 179  # Radiance's lm/W
    assert lux == pytest.approx(6108, rel=0.01)
