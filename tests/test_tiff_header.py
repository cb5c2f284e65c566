"""TIFF files whose header says how samples are stored, where decoders go by it silently or not at all."""

import struct

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.light.images import read_codes, read_picture

BITS, COMPRESSION, PHOTOMETRIC, ORIENTATION, PLANAR, EXTRA, SAMPLE_FORMAT = 258, 259, 262, 274, 284, 338, 339


def tiff(pixels, order="<", big=False, more=False, **changed):
    """An uncompressed TIFF of one strip. changed: tags by name, in place of those that the pixels have."""
    height, width, channels = (*pixels.shape, 1)[:3]
    data = pixels.astype(pixels.dtype.newbyteorder(order)).tobytes()
    number, wide = ("Q", 8) if big else ("I", 4)
    tags = {
        256: width, 257: height, BITS: (8 * pixels.itemsize,) * channels, COMPRESSION: 1, PHOTOMETRIC: 2 if channels == 3 else 1,
        273: 16, ORIENTATION: 1, 277: channels, 278: height, 279: len(data), PLANAR: 1, SAMPLE_FORMAT: 1,
    }  # fmt: skip
    tags |= {globals()[name]: value for name, value in changed.items()}
    first = 16 + len(data) + len(data) % 2
    long_at = first + (8 if big else 2) + len(tags) * (20 if big else 12) + wide
    entries = longer = b""
    for tag, value in sorted(tags.items()):
        values = value if isinstance(value, tuple) else (value,)
        kind, form = (4, "I") if tag in (273, 279) else (3, "H")
        packed = struct.pack(f"{order}{len(values)}{form}", *values)
        if len(packed) > wide:
            packed, longer = struct.pack(order + number, long_at + len(longer)), longer + packed
        entries += struct.pack(order + "HH" + number, tag, kind, len(values)) + packed.ljust(wide, b"\0")
    head = {"<": b"II", ">": b"MM"}[order] + struct.pack(order + "H", 43 if big else 42)
    head += struct.pack(order + "HHQ", 8, 0, first) if big else struct.pack(order + "I", first)
    count = struct.pack(order + ("Q" if big else "H"), len(tags))
    following = struct.pack(order + number, first if more else 0)
    return head.ljust(16, b"\0") + data + b"\0" * (len(data) % 2) + count + entries + following + longer


def pixels_of(dtype, gray):
    shape = (6, 8) if gray else (6, 8, 3)
    return np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(("dtype", "gray"), [(np.uint8, False), (np.uint16, False), (np.uint16, True)])
def test_pixels_stay_where_the_sensor_has_them(tmp_path, capsys, orientation, dtype, gray):
    pixels = pixels_of(dtype, gray)
    (tmp_path / "a.tif").write_bytes(tiff(pixels, ORIENTATION=orientation))
    assert np.array_equal(read_codes(tmp_path / "a.tif"), pixels)
    assert ("orientation" in capsys.readouterr().err) == (orientation != 1)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_to_be_seen_is_turned(tmp_path, orientation):
    upright = pixels_of(np.uint8, False)
    stored = {
        1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1], 5: upright.transpose(1, 0, 2), 6: np.rot90(upright),
        7: upright[::-1, ::-1].transpose(1, 0, 2), 8: np.rot90(upright, -1),
    }[orientation]  # fmt: skip
    (tmp_path / "a.tif").write_bytes(tiff(stored, ORIENTATION=orientation))
    assert np.array_equal(read_picture(tmp_path / "a.tif"), upright)


@pytest.mark.parametrize(("order", "big"), [("<", False), (">", False), ("<", True)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_white_that_is_0(tmp_path, order, big, dtype):
    pixels = pixels_of(dtype, gray=True)
    (tmp_path / "a.tif").write_bytes(tiff(np.iinfo(dtype).max - pixels, order, big, PHOTOMETRIC=0))
    assert np.array_equal(read_codes(tmp_path / "a.tif"), pixels)


def test_the_first_of_several_pictures_is_taken_with_a_line(tmp_path, capsys):
    (tmp_path / "a.tif").write_bytes(tiff(pixels_of(np.uint16, False), more=True))
    read_codes(tmp_path / "a.tif")
    assert "more than one picture" in capsys.readouterr().err


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(("kind", "is_said"), [(0, False), (1, True), (2, False)])
def test_colours_beside_alpha_are_those_of_the_file_and_said_where_it_has_darkened_them(tmp_path, capsys, kind, is_said, dtype):
    pixels = np.dstack([pixels_of(dtype, False), np.full((6, 8), np.iinfo(dtype).max // 2, dtype)])
    (tmp_path / "a.tif").write_bytes(tiff(pixels, PHOTOMETRIC=2, EXTRA=kind))
    assert np.array_equal(read_codes(tmp_path / "a.tif")[..., :3], pixels[..., :3])
    assert ("multiplied by its alpha" in capsys.readouterr().err) == is_said


@pytest.mark.parametrize(("changed", "said"), [
    ({"SAMPLE_FORMAT": 3}, "floating-point"), ({"SAMPLE_FORMAT": 2}, "signed"), ({"BITS": (12, 12, 12)}, "12 bits"),
    ({"BITS": (8, 16, 16)}, "8 and 16 bits"), ({"PHOTOMETRIC": 5}, "CMYK"), ({"PHOTOMETRIC": 8}, r"L\*a\*b"),
    ({"PHOTOMETRIC": 77}, "kind 77"),
    ({"PLANAR": 2}, "planes of their own"), ({"COMPRESSION": 50000}, "Zstandard"), ({"COMPRESSION": 77}, "method 77"),
])  # fmt: skip
def test_samples_that_are_not_read_are_named(tmp_path, changed, said):
    (tmp_path / "a.tif").write_bytes(tiff(pixels_of(np.uint16, False), **changed))
    with pytest.raises(UserError, match=said):
        read_codes(tmp_path / "a.tif")


def test_a_header_that_is_cut_off_is_said(tmp_path):
    data = tiff(pixels_of(np.uint16, False))
    far = bytearray(tiff(pixels_of(np.uint16, False), big=True))
    far[8:16] = b"\xff" * 8
    (tmp_path / "far.tif").write_bytes(far)
    with pytest.raises(UserError, match="header is cut off"):
        read_codes(tmp_path / "far.tif")
    for length in (5, 16, len(data) - 40):
        (tmp_path / "a.tif").write_bytes(data[:length])
        with pytest.raises(UserError, match="header is cut off"):
            read_codes(tmp_path / "a.tif")
