"""PNG, JPEG, TIFF, PFM and raw photographs as sources of light: what they say of themselves, what is stated, and what is refused."""

import struct
import warnings

import msgspec
import numpy as np
import pytest
from PIL import Image, ImageCms

from tests.support.films import lamp_room
from tests.support.photographs import dng, with_chunk
from vemlight.capture.polar import latlong_to_polar, polar_from_latlong
from vemlight.capture.source import open_files
from vemlight.errors import UserError
from vemlight.light.images import write_exr, write_png
from vemlight.light.pfm import read_pfm
from vemlight.light.primaries import PRIMARIES, rec709_from_primaries
from vemlight.light.sphere import map_irradiance
from vemlight.light.transfers import TRANSFERS
from vemlight.settings import Capture

HEIGHT = 128
LENS = "size = [128, 128]\nf = [40.0, 40.0]\nc = [63.5, 63.5]\nk1 = 0.0\nk2 = 0.0\nk3 = 0.0\nk4 = 0.0\nrim_deg = 90.0\n"


def room():
    noise = np.random.default_rng(1).uniform(0.9, 1.0, (HEIGHT, 2 * HEIGHT, 1))
    return lamp_room(HEIGHT) * noise


def codes_of(light, transfer, bits, primaries="bt709"):
    signals = np.linspace(0, 1, 2**18)
    coded = light @ np.linalg.inv(rec709_from_primaries(PRIMARIES[primaries])).T
    return np.rint(np.interp(coded, TRANSFERS[transfer].light_from_signal(signals), signals) * (2**bits - 1)).astype(
        np.uint8 if bits == 8 else np.uint16
    )


def irradiance_of(path, **settings):
    return map_irradiance(open_files(Capture(source=str(path), **settings)).frame(0).radiance, "hemisphere")


def truth():
    weights = latlong_to_polar(HEIGHT, 2 * HEIGHT, 90, 360, "hemisphere")
    return map_irradiance(polar_from_latlong(room().astype(np.float32), weights), "hemisphere")


@pytest.mark.parametrize(("suffix", "bits", "transfer", "tolerance"), [
    (".png", 8, "srgb", 0.02), (".png", 16, "srgb", 0.002), (".png", 16, "linear", 0.002), (".tif", 16, "linear", 0.002),
    (".tiff", 8, "bt1886", 0.02), (".png", 16, "slog3", 0.01),
])  # fmt: skip
def test_a_stated_transfer(tmp_path, suffix, bits, transfer, tolerance):
    import cv2

    primaries = TRANSFERS[transfer].primaries or "bt709"
    path = tmp_path / f"sky{suffix}"
    cv2.imwrite(str(path), codes_of(room(), transfer, bits, primaries)[..., ::-1])
    np.testing.assert_allclose(irradiance_of(path, transfer=transfer), truth(), rtol=tolerance)


def test_what_does_not_say_how_codes_become_light_is_refused(tmp_path):
    """Neither 8 nor 16 bits are taken for anything; a setting says it, and a response file that they are raw codes."""
    for bits, suffix in ((8, ".png"), (16, ".png")):
        write_png(tmp_path / f"sky{suffix}", codes_of(room(), "srgb", bits))
        with pytest.raises(UserError, match=r"sky\.png: does not say how its codes become light; say --transfer"):
            irradiance_of(tmp_path / f"sky{suffix}")


def test_jpeg_is_srgb_and_a_line_says_so(tmp_path, capsys):
    Image.fromarray(codes_of(room(), "srgb", 8)).save(tmp_path / "sky.jpg", quality=98, subsampling=0)
    np.testing.assert_allclose(irradiance_of(tmp_path / "sky.jpg"), truth(), rtol=0.03)
    assert "sky.jpg: does not say its transfer (taken as srgb) and primaries (taken as bt709)" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "data", "transfer", "primaries"), [
    (b"sRGB", b"\0", "srgb", "bt709"), (b"gAMA", struct.pack(">I", 100_000), "linear", "bt709"),
    (b"cICP", bytes((16, 1, 0, 1)), None, None), (b"cICP", bytes((12, 13, 0, 1)), "srgb", "p3d65"),
    (b"cICP", bytes((9, 18, 0, 1)), "hlg", "bt2020"),
])  # fmt: skip
def test_chunks_of_a_png_are_obeyed(tmp_path, name, data, transfer, primaries):
    write_png(tmp_path / "sky.png", codes_of(room(), transfer or "srgb", 16, primaries or "bt709"))
    (tmp_path / "sky.png").write_bytes(with_chunk((tmp_path / "sky.png").read_bytes(), name, data))
    if transfer is None:  # BT.709's curve is named by 1; 16 as primaries is unknown
        with pytest.raises(UserError, match="primaries is tag 16"):
            irradiance_of(tmp_path / "sky.png")
        return
    np.testing.assert_allclose(irradiance_of(tmp_path / "sky.png"), truth(), rtol=0.005)


def test_a_cicp_chunk_counts_where_it_is_one(tmp_path):
    """Behind any length of text, and not inside one."""
    write_png(tmp_path / "plain.png", codes_of(room(), "srgb", 16))
    plain = (tmp_path / "plain.png").read_bytes()
    in_text = with_chunk(plain, b"tEXt", b"a\0\0\0\0\4cICP\x09\x10\0\1zzzz")
    (tmp_path / "in_text.png").write_bytes(with_chunk(in_text, b"sRGB", b"\0"))
    behind = with_chunk(with_chunk(plain, b"cICP", bytes((1, 13, 0, 1))), b"tEXt", b"a\0" + b"x" * 70_000)
    (tmp_path / "behind.png").write_bytes(behind)
    for name in ("in_text.png", "behind.png"):
        np.testing.assert_allclose(irradiance_of(tmp_path / name), truth(), rtol=0.005)


def test_chromaticities_and_gamma_of_a_png(tmp_path, capsys):
    def said(gamma, primaries):
        x = PRIMARIES[primaries] if primaries else (0.6, 0.3, 0.3, 0.6, 0.2, 0.1, 0.3, 0.3)
        chromaticities = struct.pack(">8I", *(round(100_000 * value) for value in (*x[6:], *x[:6])))
        data = with_chunk((tmp_path / "plain.png").read_bytes(), b"cHRM", chromaticities)
        (tmp_path / "sky.png").write_bytes(with_chunk(data, b"gAMA", struct.pack(">I", gamma)))
        return irradiance_of(tmp_path / "sky.png")

    write_png(tmp_path / "plain.png", codes_of(room(), "linear", 16, "p3d65"))
    np.testing.assert_allclose(said(100_000, "p3d65"), truth(), rtol=0.005)
    assert not capsys.readouterr().err
    with pytest.raises(UserError, match=r"primaries is tag cHRM 0\.6 0\.3"):
        said(100_000, None)
    with pytest.raises(UserError, match=r"transfer is tag gAMA 0\.45455"):
        said(45_455, "bt709")


@pytest.mark.parametrize("mark", [b'hdrgm:Version="1.0"', b"urn:iso:std:iso:ts:21496:-1\0"])
def test_a_gain_map_that_is_not_read_is_said(tmp_path, capsys, mark):
    Image.fromarray(codes_of(room(), "srgb", 8)).save(tmp_path / "sky.jpg", comment=mark)
    irradiance_of(tmp_path / "sky.jpg")
    assert "gain map, which is not read" in capsys.readouterr().err


@pytest.mark.parametrize(("settings", "said"), [
    (Capture(layer="A"), "layer: is of EXR files"), (Capture(controls={"gain": 5}), "controls: is for cameras"),
])  # fmt: skip
def test_what_says_nothing_of_a_picture_is_refused(tmp_path, settings, said):
    write_png(tmp_path / "sky.png", codes_of(room(), "srgb", 8))
    with pytest.raises(UserError, match=said):
        open_files(msgspec.structs.replace(settings, source=str(tmp_path / "sky.png")))


def test_colours_for_print_are_refused(tmp_path):
    Image.fromarray(codes_of(room(), "srgb", 8)).convert("CMYK").save(tmp_path / "sky.jpg")
    with pytest.raises(UserError, match="CMYK"):
        irradiance_of(tmp_path / "sky.jpg")


def test_profiles_are_read_by_their_numbers(tmp_path, capsys):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(codes_of(room(), "srgb", 8)).save(tmp_path / "sky.png", icc_profile=srgb)
    np.testing.assert_allclose(irradiance_of(tmp_path / "sky.png"), truth(), rtol=0.02)
    assert not capsys.readouterr().err
    other = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    Image.fromarray(codes_of(room(), "srgb", 8)).save(tmp_path / "lab.jpg", icc_profile=other)
    irradiance_of(tmp_path / "lab.jpg")
    assert "lab.jpg: its colour profile, Lab" in capsys.readouterr().err


def test_a_stated_transfer_makes_a_fisheye_picture_light(tmp_path):
    (tmp_path / "lens.toml").write_text(LENS)
    write_png(tmp_path / "a.png", np.full((128, 128, 3), 188, np.uint8))
    frame = open_files(Capture(source=str(tmp_path / "a.png"), transfer="srgb")).frame(0)
    assert frame.radiance[:80].mean() == pytest.approx(TRANSFERS["srgb"].light_from_signal(np.array(188 / 255)), rel=1e-3)


def test_a_folder_of_pictures(tmp_path):
    for k in range(3):
        write_png(tmp_path / f"sky_{k}.png", codes_of(room() * (k + 1) / 3, "srgb", 16))
    source = open_files(Capture(source=str(tmp_path), transfer="srgb"))
    power = [map_irradiance(source.frame(k).radiance, "hemisphere")[1] for k in range(len(source))]
    np.testing.assert_allclose(power, truth()[1] * np.array([1, 2, 3]) / 3, rtol=1e-3)


@pytest.mark.parametrize(("scale", "order", "end"), [
    (-1.0, "<f4", "\n"), (1.0, ">f4", "\n"), (-2.5, "<f4", "\n"), (-1.0, "<f4", "\r\n"), (-1.0, "<f4", " \n"), (-1.0, "<f4", " "),
])  # fmt: skip
def test_portable_float_maps(tmp_path, scale, order, end):
    header = f"PF\n{2 * HEIGHT} {HEIGHT}\n{scale}{end}".encode()
    (tmp_path / "sky.pfm").write_bytes(header + room()[::-1].astype(order).tobytes())
    np.testing.assert_allclose(irradiance_of(tmp_path / "sky.pfm"), truth() * abs(scale), rtol=1e-5)
    (tmp_path / "gray.pfm").write_bytes(f"Pf 2 1 {scale} ".encode() + np.array([1.0, 3.0], order).tobytes())
    np.testing.assert_allclose(read_pfm(tmp_path / "gray.pfm")[0, :, 1], np.array([1.0, 3.0]) * abs(scale))
    with warnings.catch_warnings(action="error"):
        (tmp_path / "gray.pfm").write_bytes(f"Pf 2 1 {scale * 1e20} ".encode() + np.array([1e20, 0.0], order).tobytes())
        assert read_pfm(tmp_path / "gray.pfm")[0, :, 1].tolist() == [np.inf, 0]


@pytest.mark.parametrize(("content", "words"), [
    (b"PF\n4 4\n-1.0\n" + bytes(10), "cut off: 10 of 192"), (b"PF\n4 4\n0\n" + bytes(192), "no portable float map"),
    (b"P6\n4 4\n255\n" + bytes(48), "no portable float map"), (b"PF\n99999 99999\n-1.0\n", "99999 x 99999 pixels"),
    (b"PF\n16384 8192\n-1.0\n" + bytes(99), "which no picture has"),
    (b"", "no portable float map"), (b"PF\n4 4\n-nan\n", "no portable float map"),
    (b"PF\n4 4\n-1e39\n" + bytes(192), "no portable float map"),
])  # fmt: skip
def test_what_is_no_portable_float_map(tmp_path, content, words):
    (tmp_path / "sky.pfm").write_bytes(content)
    with pytest.raises(UserError, match=words):
        read_pfm(tmp_path / "sky.pfm")


def test_primaries_of_radiance_that_states_none(tmp_path):
    """A header's chromaticities win; without them the setting holds, and without it Rec. 709."""
    from_ap1 = (room() @ np.linalg.inv(rec709_from_primaries(PRIMARIES["ap1"])).T).astype(np.float32)
    (tmp_path / "sky.pfm").write_bytes(f"PF\n{2 * HEIGHT} {HEIGHT}\n-1\n".encode() + from_ap1[::-1].tobytes())
    np.testing.assert_allclose(irradiance_of(tmp_path / "sky.pfm", primaries="ap1"), truth(), rtol=1e-4)
    write_exr(tmp_path / "sky.exr", from_ap1, {"chromaticities": PRIMARIES["ap1"]})
    np.testing.assert_allclose(irradiance_of(tmp_path / "sky.exr", primaries="p3d65"), truth(), rtol=1e-4)


@pytest.mark.parametrize(
    "settings", [{"transfer": "pq"}, {"range": "full"}, {"matrix": "bt709"}, {"light": "scene"}, {"stereo": "top-bottom"}]
)
def test_settings_of_codes_are_refused_for_radiance(tmp_path, settings):
    write_exr(tmp_path / "sky.exr", room().astype(np.float32))
    with pytest.raises(UserError, match=f"sky.exr: holds radiance, of which --{next(iter(settings))} says nothing"):
        irradiance_of(tmp_path / "sky.exr", **settings)


def test_raw_photographs_are_linear(tmp_path):
    """Grays of two levels: a quarter of the sensor's range above black, and a half of it."""
    pytest.importorskip("rawpy", reason="rawpy is not installed: pip install 'vemlight[raw]'")
    black, white, found = 512, 16_383, []
    (tmp_path / "lens.toml").write_text(LENS)
    for level in (0.25, 0.5):
        mosaic = np.array([[0.9505, 1.0], [1.0, 1.0888]])  # of a camera whose channels are X, Y and Z, before D65
        codes = np.rint(black + (white - black) * level * np.tile(mosaic, (64, 64)))
        (tmp_path / f"{level}.dng").write_bytes(dng(codes, black, white))
        frame = open_files(Capture(source=str(tmp_path / f"{level}.dng"))).frame(0)
        found.append(frame.radiance[:80].mean(axis=(0, 1)))
    np.testing.assert_allclose(found[1] / found[0], 2, rtol=0.01)
    np.testing.assert_allclose(found[0] / found[0][1], 1, atol=0.03)  # D65 is white


def test_raw_photographs_need_their_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rawpy", None)
    (tmp_path / "a.dng").write_bytes(b"II*\0")
    with pytest.raises(UserError, match=r"pip install 'vemlight\[raw\]'"):
        open_files(Capture(source=str(tmp_path / "a.dng"))).frame(0)


def test_a_damaged_raw_photograph_is_one_line(tmp_path):
    pytest.importorskip("rawpy", reason="rawpy is not installed: pip install 'vemlight[raw]'")
    (tmp_path / "a.dng").write_bytes(b"II*\0" + bytes(range(256)))
    with pytest.raises(UserError, match=r"a\.dng: cannot be read as a raw photograph"):
        open_files(Capture(source=str(tmp_path / "a.dng"))).frame(0)
