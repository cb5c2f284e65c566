"""OpenEXR files as they come from other programs: what the header says is honoured, or refused by its cause."""

import struct
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from vemlight.errors import UserError
from vemlight.light.exr import read_exr
from vemlight.light.image_limits import ImageLimits
from vemlight.light.primaries import PRIMARIES, REC709, XYZ, rec709_from_primaries, xyz_from_primaries

REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)


@pytest.fixture
def picture():
    return np.random.default_rng(2).uniform(0.1, 9, (8, 16, 3)).astype(np.float32)


def window(left, top, width, height):
    corners = (left, top), (left + width - 1, top + height - 1)
    return tuple(np.array(corner, np.int32) for corner in corners)


def rgb(picture, prefix="", dtype=np.float32):
    return {f"{prefix}{name}": np.ascontiguousarray(picture[..., k], dtype) for k, name in enumerate("RGB")}


def write(path, channels, **header):
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, channels) as file:
        file.write(str(path))
    return path


def write_parts(path, parts):
    base = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File([OpenEXR.Part({**base, "name": name}, channels, name) for name, channels in parts.items()]).write(str(path))
    return path


def write_sampled(path, planes):
    """Uncompressed and by hand: the library writes no subsampled channels. planes: name -> ((rows, cols) float32, pixels a value)."""
    height, width = max(plane.shape for plane, _ in planes.values())
    names = sorted(planes)

    def attribute(name, kind, value):
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    channels = b"".join(name.encode() + b"\0" + struct.pack("<4i", 2, 0, planes[name][1], planes[name][1]) for name in names) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"\x76\x2f\x31\x01" + struct.pack("<I", 2) + attribute("channels", "chlist", channels)
    head += attribute("compression", "compression", b"\0") + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("dataWindow", "box2i", box) + attribute("displayWindow", "box2i", box)
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1)) + attribute("screenWindowWidth", "float", struct.pack("<f", 1))
    head += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)) + b"\0"
    rows = [b"".join(planes[n][0][y // planes[n][1]].tobytes() for n in names if y % planes[n][1] == 0) for y in range(height)]
    chunks = [struct.pack("<2i", y, len(row)) + row for y, row in enumerate(rows)]
    offsets = np.cumsum([len(head) + 8 * height, *(len(chunk) for chunk in chunks[:-1])]).astype("<u8")
    path.write_bytes(head + offsets.tobytes() + b"".join(chunks))
    return path


def read(path, layer=""):
    return read_exr(path, layer)[0]


def test_the_picture_and_its_attributes_come_back(tmp_path, picture):
    path = write(tmp_path / "a.exr", rgb(picture), owner="somebody", framesPerSecond=Fraction(24000, 1001))
    pixels, attributes = read_exr(path)
    np.testing.assert_array_equal(pixels, picture)
    assert pixels.dtype == np.float32
    assert attributes["owner"] == "somebody"
    assert attributes["framesPerSecond"] == Fraction(24000, 1001)


WINDOWS = [(0, 0, 16, 4), (3, 2, 8, 4), (-2, -1, 20, 10), (10, 5, 20, 20), (30, 30, 4, 4)]


@pytest.mark.parametrize(("left", "top", "width", "height"), WINDOWS)
def test_pixels_stay_where_the_display_window_has_them(tmp_path, left, top, width, height):
    """Cropped, overscanned, shifted and wholly outside: a pixel's place counts from the display window's corner."""
    stored = np.random.default_rng(3).uniform(1, 2, (height, width, 3)).astype(np.float32)
    path = write(tmp_path / "a.exr", rgb(stored), dataWindow=window(left, top, width, height), displayWindow=window(0, 0, 16, 8))
    shown = read(path)
    assert shown.shape == (8, 16, 3)
    for y, x in np.ndindex(8, 16):
        inside = 0 <= y - top < height and 0 <= x - left < width
        np.testing.assert_array_equal(shown[y, x], stored[y - top, x - left] if inside else 0)


def test_a_display_window_need_not_begin_at_zero(tmp_path, picture):
    both = window(100, 50, 16, 8)
    np.testing.assert_array_equal(read(write(tmp_path / "a.exr", rgb(picture), dataWindow=both, displayWindow=both)), picture)


def test_other_primaries_become_rec709(tmp_path, picture):
    in_2020 = picture @ np.linalg.inv(rec709_from_primaries(REC2020)).T
    np.testing.assert_allclose(read(write(tmp_path / "a.exr", rgb(in_2020), chromaticities=REC2020)), picture, rtol=1e-4, atol=1e-4)
    in_xyz = picture @ xyz_from_primaries(REC709).T
    path = write(tmp_path / "b.exr", rgb(in_xyz), chromaticities=(*XYZ, 1 / 3, 1 / 3))
    np.testing.assert_allclose(read(path), picture, rtol=1e-4, atol=1e-4)


def test_rec709_comes_through_to_the_bit_and_zeros_mean_not_known(tmp_path, picture):
    for stated in (REC709, (0.0,) * 8):
        np.testing.assert_array_equal(read(write(tmp_path / "a.exr", rgb(picture), chromaticities=stated)), picture)


def test_primaries_on_a_line_are_refused(tmp_path, picture):
    path = write(tmp_path / "a.exr", rgb(picture), chromaticities=(0.3,) * 8)
    with pytest.raises(UserError, match="chromaticities"):
        read(path)


def test_luminance_with_chroma_is_colour(tmp_path):
    """Chroma for blocks of 2 x 2, each block of one colour: exact."""
    rng = np.random.default_rng(4)
    picture = np.repeat(np.repeat(rng.uniform(0.1, 9, (4, 8, 3)), 2, axis=0), 2, axis=1)
    luminance = picture @ xyz_from_primaries(REC709)[1]
    chroma = [(picture[::2, ::2, k] - luminance[::2, ::2]) / luminance[::2, ::2] for k in (0, 2)]
    planes = {"Y": (luminance.astype(np.float32), 1), "RY": (chroma[0].astype(np.float32), 2), "BY": (chroma[1].astype(np.float32), 2)}
    np.testing.assert_allclose(read(write_sampled(tmp_path / "a.exr", planes)), picture, rtol=1e-4, atol=1e-4)


def test_gray_is_repeated(tmp_path, picture):
    path = write(tmp_path / "a.exr", {"Y": picture[..., 0].copy()})
    np.testing.assert_array_equal(read(path), np.repeat(picture[..., :1], 3, axis=-1))


def test_channels_of_several_types_and_alpha(tmp_path, picture):
    half = picture.astype(np.float16)
    channels = {"R": half[..., 0].copy(), "G": picture[..., 1].copy(), "B": half[..., 2].copy(), "A": np.ones((8, 16), np.float32)}
    expected = np.stack([half[..., 0], picture[..., 1], half[..., 2]], axis=-1)
    np.testing.assert_array_equal(read(write(tmp_path / "a.exr", channels)), expected)
    np.testing.assert_array_equal(read(write(tmp_path / "b.exr", {"RGBA": np.dstack([half, half[..., :1]])})), half)


def test_the_only_layer_is_taken_and_any_can_be_chosen(tmp_path, picture):
    one = write(tmp_path / "one.exr", rgb(picture, "ViewLayer.Combined."))
    np.testing.assert_array_equal(read(one), picture)
    two = write(tmp_path / "two.exr", {**rgb(picture, "A.Combined."), **rgb(2 * picture, "A.Diffuse.")})
    np.testing.assert_array_equal(read(two), picture)
    np.testing.assert_array_equal(read(two, "A.Diffuse"), 2 * picture)
    np.testing.assert_array_equal(read(two, "a.diffuse"), 2 * picture)
    with pytest.raises(UserError, match=r"no layer Glossy; choose from A\.Combined, A\.Diffuse"):
        read(two, "Glossy")


def test_layers_without_a_main_one_are_not_guessed_at(tmp_path, picture):
    path = write(tmp_path / "a.exr", {**rgb(picture, "left."), **rgb(picture, "right.")})
    with pytest.raises(UserError, match="--layer: left, right"):
        read(path)


def test_the_part_that_is_the_picture_is_taken_and_named(tmp_path, picture, capsys):
    depth = {"Z": picture[..., 0].copy()}
    path = write_parts(tmp_path / "a.exr", {"depth": depth, "beauty": rgb(picture)})
    np.testing.assert_array_equal(read(path), picture)
    assert capsys.readouterr().err == ""
    path = write_parts(tmp_path / "b.exr", {"diffuse": rgb(0 * picture), "rgba": rgb(picture)})
    np.testing.assert_array_equal(read(path), picture)
    assert "layer rgba was taken of diffuse, rgba" in capsys.readouterr().err
    np.testing.assert_array_equal(read(path, "diffuse"), 0 * picture)


@pytest.mark.parametrize(("channels", "header", "cause"), [
    ({"Z": 1}, {}, "no R, G, B and no Y"),
    ({"r": 1, "g": 1, "b": 1}, {}, "no R, G, B and no Y"),
    ({"X": 1, "Y": 1, "Z": 1}, {}, "no Y of a luminance"),
    ({"N.X": 1, "N.Y": 1, "N.Z": 1, "Z": 1}, {}, "no Y of a luminance"),
    ({"RY": 1, "Y": 1}, {}, "no Y of a luminance"),
    ({"R": 1, "G": 1, "B": 1}, {"envmap": OpenEXR.ENVMAP_CUBE}, "cube map"),
    ({"R": 1, "G": 1, "B": 1}, {"colorInteropID": "srgb_rec709_display"}, "not linear"),
    ({"R": 1, "G": 1, "B": 1}, {"colorInteropID": "lin_mine_scene"}, "primaries are not known"),
])  # fmt: skip
def test_what_holds_no_map_is_refused(tmp_path, channels, header, cause):
    path = write(tmp_path / "a.exr", {name: np.ones((8, 16), np.float32) for name in channels}, **header)
    with pytest.raises(UserError, match=cause):
        read(path)


def test_colours_in_parts_of_their_own_are_refused(tmp_path, picture):
    path = write_parts(tmp_path / "a.exr", {name: {name: picture[..., k].copy()} for k, name in enumerate("RGB")})
    with pytest.raises(UserError, match="in one part"):
        read(path)


@pytest.mark.parametrize(("header", "primaries"), [
    ({"colorInteropID": "lin_ap1_scene"}, PRIMARIES["ap1"]), ({"colorInteropID": "lin_rec2020_scene"}, PRIMARIES["bt2020"]),
    ({"colorInteropID": "lin_rec709_scene"}, REC709), ({"colorInteropID": "unknown"}, REC709),
    ({"acesImageContainerFlag": 1}, PRIMARIES["ap0"]),
    ({"colorInteropID": "lin_ap1_scene", "chromaticities": PRIMARIES["bt2020"]}, PRIMARIES["bt2020"]),
    ({"colorInteropID": "lin_mine_scene", "chromaticities": PRIMARIES["bt2020"]}, PRIMARIES["bt2020"]),
])  # fmt: skip
def test_primaries_that_are_said_by_a_name(tmp_path, picture, header, primaries):
    found, attributes = read_exr(write(tmp_path / "a.exr", rgb(picture), **header))
    np.testing.assert_allclose(found, picture @ rec709_from_primaries(primaries).T, rtol=1e-4, atol=1e-5)
    assert ("chromaticities" in attributes) == (header != {"colorInteropID": "unknown"})


def test_a_display_window_beside_the_pixels_is_said(tmp_path, picture, capsys):
    windows = {"dataWindow": window(100, 100, 16, 8), "displayWindow": window(0, 0, 16, 8)}
    assert not read(write(tmp_path / "a.exr", rgb(picture), **windows)).any()
    assert "none of its pixels lie in its display window" in capsys.readouterr().err


def test_parts_that_the_library_leaves_out_are_said(tmp_path, picture, monkeypatch):
    path = write(tmp_path / "a.exr", rgb(picture))
    monkeypatch.setattr(OpenEXR, "File", lambda *_, **__: SimpleNamespace(parts=[]))  # as it does where chunks are missing
    with pytest.raises(UserError, match="pixels of 1 of its 1 parts are missing or damaged"):
        read(path)


def test_subsampled_colour_is_refused(tmp_path):
    small = np.ones((4, 8), np.float32), 2
    with pytest.raises(UserError, match="subsampled"):
        read(write_sampled(tmp_path / "a.exr", {"G": (np.ones((8, 16), np.float32), 1), "R": small, "B": small}))


def patched(path, old, new):
    data = path.read_bytes()
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))
    return path


def test_text_that_is_not_utf8_and_a_rate_of_nothing(tmp_path, picture):
    path = write(tmp_path / "a.exr", rgb(picture), owner="Muller", framesPerSecond=Fraction(24, 1))
    patched(path, b"Muller", b"M\xfcller")
    pixels, attributes = read_exr(patched(path, struct.pack("<iI", 24, 1), struct.pack("<iI", 0, 0)))
    np.testing.assert_array_equal(pixels, picture)
    assert attributes["owner"] == "M?ller"
    assert attributes["framesPerSecond"] == 0


def test_deep_pixels_are_refused(tmp_path, picture):
    path = patched(write(tmp_path / "a.exr", rgb(picture)), b"scanlineimage", b"deepscanline\0")
    with pytest.raises(UserError, match="deep pixels"):
        read(path)


def test_sizes_are_checked_before_anything_is_read(tmp_path, picture):
    path = write(tmp_path / "a.exr", rgb(picture))
    stated, huge = struct.pack("<4i", 0, 0, 15, 7), struct.pack("<4i", 0, 0, 2**31 - 2, 2**31 - 2)
    path.write_bytes(path.read_bytes().replace(stated, huge))
    with pytest.raises(UserError, match="scale it down"):
        read(path)
    assert read_exr(write(path, rgb(picture)), limits=ImageLimits(16, 16 * 8))[0].shape == (8, 16, 3)
    for limits in (ImageLimits(15, 16 * 8), ImageLimits(16, 16 * 8 - 1)):
        with pytest.raises(UserError, match="scale it down"):
            read_exr(path, limits=limits)


@pytest.mark.parametrize(("channels", "refused"), [(1024, False), (1025, True)])
def test_a_part_has_channels_up_to_a_limit(tmp_path, picture, channels, refused):
    more = {f"z.{k}": picture[..., 0] for k in range(channels - 3)}
    path = write(tmp_path / "a.exr", rgb(picture) | more)
    if refused:
        with pytest.raises(UserError, match="more than 1024 channels"):
            read(path)
    else:
        assert read(path).shape == picture.shape


def test_all_channels_together_are_limited_by_the_bytes_that_they_are_stored_in(tmp_path):
    black = np.zeros((512, 512), np.float32)
    path = write(tmp_path / "a.exr", dict.fromkeys("RGB", black) | {f"z.{k}": black for k in range(61)})  # 64 MB decoded
    assert read(path).shape == (512, 512, 3)
    path = write(tmp_path / "a.exr", dict.fromkeys("RGB", black) | {f"z.{k}": black for k in range(62)})
    with pytest.raises(UserError, match="decode to 68157440 bytes"):
        read(path)


def test_all_parts_together_are_limited(tmp_path, picture):
    path = write_parts(tmp_path / "a.exr", {f"part{k}": rgb(picture) for k in range(4)})
    with pytest.raises(UserError, match="in its 4 parts"):
        read_exr(path, "part0", ImageLimits(16, 4 * 16 * 8 - 1))
    assert read_exr(path, "part0", ImageLimits(16, 4 * 16 * 8))[0].shape == (8, 16, 3)
    part = b"a\0int\0\4\0\0\0\0\0\0\0\0"
    path.write_bytes(path.read_bytes()[:4] + struct.pack("<I", 2 | 0x1000) + part * 1025)  # renderers write some dozens
    with pytest.raises(UserError, match="more than"):
        read(path)


def test_damage_anywhere_is_a_picture_or_one_refusal(tmp_path, picture, capfd):
    rng = np.random.default_rng(5)
    whole = np.frombuffer(write(tmp_path / "a.exr", rgb(picture), owner="somebody").read_bytes(), np.uint8)
    refused = 0
    for k in range(400):
        damaged = whole.copy()
        damaged[rng.integers(0, min(whole.size, 500), 2)] = rng.integers(0, 256, 2)
        (tmp_path / "b.exr").write_bytes(damaged[: whole.size if k % 4 else rng.integers(1, whole.size)].tobytes())
        try:
            read(tmp_path / "b.exr")
        except UserError as error:
            refused += 1
            assert "\n" not in str(error)  # noqa: PT017, most damage is refused, some is not
    assert refused > 100
    assert capfd.readouterr().err == ""
