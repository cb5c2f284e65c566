"""Radiance and pictures as files: there and back, and one line for what cannot be read."""

import struct
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from vemlight.errors import UserError
from vemlight.light.image_limits import LIMITS
from vemlight.light.images import read_codes, read_radiance, write_exr, write_png

RADIANCE = np.random.default_rng(0).lognormal(0, 3, (5, 7, 3)).astype(np.float32)


def test_an_exr_comes_back_with_every_bit_and_its_attributes(tmp_path):
    image = RADIANCE.copy()
    image[0, 0], image[1, 1], image[2, 2] = np.nan, np.inf, -1
    write_exr(tmp_path / "a.exr", image, {"vemlight:ns": "1099511627776"})
    found, attributes = read_radiance(tmp_path / "a.exr")
    np.testing.assert_array_equal(found, image)
    assert attributes["vemlight:ns"] == "1099511627776"
    assert attributes["colorInteropID"] == "lin_rec709_scene"


def test_gray_is_repeated_and_alpha_left_out(tmp_path):
    write_exr(tmp_path / "gray.exr", RADIANCE[..., 0])
    np.testing.assert_array_equal(read_radiance(tmp_path / "gray.exr")[0], RADIANCE[..., :1].repeat(3, axis=-1))
    write_exr(tmp_path / "rgba.exr", np.concatenate([RADIANCE, RADIANCE[..., :1]], axis=-1))
    np.testing.assert_array_equal(read_radiance(tmp_path / "rgba.exr")[0], RADIANCE)
    half = RADIANCE.astype(np.float16)
    half[0, 0], half[1, 1] = np.nan, np.inf
    write_exr(tmp_path / "half.exr", half)
    assert OpenEXR.File(str(tmp_path / "half.exr")).channels()["RGB"].pixels.dtype == np.float16
    np.testing.assert_array_equal(read_radiance(tmp_path / "half.exr")[0], half.astype(np.float32))


def with_size(path, width, height):
    """Puts another size into an EXR's header."""
    content = path.read_bytes()
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    path.write_bytes(content[:at] + struct.pack("<4i", 0, 0, width - 1, height - 1) + content[at + 16 :])


TOO_LARGE = [(LIMITS.side + 1, 1), (1, LIMITS.side + 1), (LIMITS.side, LIMITS.side // 2 + 1), (10**5, 10**5)]


@pytest.mark.parametrize(("width", "height"), TOO_LARGE)
def test_an_image_above_the_limits_is_refused_by_its_header(tmp_path, width, height):
    write_exr(tmp_path / "huge.exr", RADIANCE)
    with_size(tmp_path / "huge.exr", width, height)
    with pytest.raises(UserError, match=f"^[^ ]*huge.exr: has {width} x {height} pixels and at most 16384 on a side and 134217728 in all"):
        read_radiance(tmp_path / "huge.exr")


def test_images_up_to_the_limits_are_read(tmp_path):
    for shape in ((1, 16384), (16384, 1)):
        write_exr(tmp_path / "long.exr", np.ones(shape, np.float32))
        assert read_radiance(tmp_path / "long.exr")[0].shape == (*shape, 3)
    assert LIMITS.side * (LIMITS.side // 2) == LIMITS.pixels  # a lat-long map of the longest side


def test_what_is_too_large_for_its_bytes_is_refused():
    """A million pixels need no more than LIMITS.ratio says, and 64 MB are free."""
    stored = 2**20
    LIMITS.check(Path("a"), 4096, LIMITS.ratio * stored // 12 // 4096, stored)
    with pytest.raises(UserError, match="which no picture has"):
        LIMITS.check(Path("a"), 4096, LIMITS.ratio * stored // 12 // 4096 + 1, stored)
    LIMITS.check(Path("a"), 2048, LIMITS.free_bytes // 12 // 2048, 10)
    with pytest.raises(UserError, match="which no picture has"):
        LIMITS.check(Path("a"), 2048, LIMITS.free_bytes // 12 // 2048 + 1, 10)


def test_drawn_maps_are_not_taken_for_bombs(tmp_path):
    """One colour all over compresses best of all that is real."""
    write_exr(tmp_path / "a.exr", np.full((1024, 2048, 3), 0.5, np.float32))
    assert read_radiance(tmp_path / "a.exr")[0].shape == (1024, 2048, 3)


def test_codes_stay_where_the_sensor_has_them(tmp_path, capsys):
    codes = np.random.default_rng(2).integers(0, 256, (16, 32, 3), np.uint8)
    turned = Image.Exif()
    turned[0x0112] = 6  # to be shown a quarter turned
    Image.fromarray(codes).save(tmp_path / "a.png", exif=turned)
    np.testing.assert_array_equal(read_codes(tmp_path / "a.png"), codes)
    assert "EXIF orientation (6) is ignored" in capsys.readouterr().err


def test_an_hdr_comes_back_to_its_8_bits(tmp_path):
    cv2.imwrite(str(tmp_path / "a.hdr"), np.ascontiguousarray(RADIANCE[..., ::-1]))
    found, attributes = read_radiance(tmp_path / "a.hdr")
    np.testing.assert_allclose(found, RADIANCE, atol=float(RADIANCE.max()) / 128)
    np.testing.assert_allclose(found.max(axis=-1), RADIANCE.max(axis=-1), rtol=1 / 128)  # the brightest of three has all digits
    assert attributes == {}


def test_a_chunk_is_no_longer_than_its_png(tmp_path):
    """libpng would take the 4 GB that a file of 80 bytes says of a chunk; what follows the last one is none."""
    codes = np.arange(24, dtype=np.uint8).reshape(4, 6)
    write_png(tmp_path / "a.png", codes)
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(whole + b"\xff" * 12)
    np.testing.assert_array_equal(read_codes(tmp_path / "a.png"), codes)
    at = whole.index(b"IDAT") - 4
    (tmp_path / "a.png").write_bytes(whole[:at] + b"\xf3" + whole[at + 1 :])
    with pytest.raises(UserError, match=r"cut off in its chunk 'IDAT', of 4076"):
        read_codes(tmp_path / "a.png")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(4, 6), (4, 6, 3)])
def test_codes_of_a_png_come_back(tmp_path, dtype, shape):
    codes = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    write_png(tmp_path / "a.png", codes)
    np.testing.assert_array_equal(read_codes(tmp_path / "a.png"), codes)


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.jpg", "absent.exr", "folder.exr"])
def test_what_is_no_radiance_is_one_line_with_its_name(tmp_path, name):
    (tmp_path / "folder.exr").mkdir()
    for file in ("a.exr", "a.hdr", "a.jpg"):
        (tmp_path / file).write_bytes(b"no image at all\n" * 9)
    with pytest.raises(UserError, match=name) as raised:
        read_radiance(tmp_path / name)
    assert len(str(raised.value).splitlines()) == 1


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_damaged_file_is_an_image_or_one_line(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    for name in ("a.exr", "a.hdr"):
        path = folder / name
        if path.suffix == ".exr":
            write_exr(path, RADIANCE)
        else:
            cv2.imwrite(str(path), RADIANCE)
        content = bytearray(path.read_bytes())
        content = content[: data.draw(st.integers(0, len(content)))]
        for at in data.draw(st.lists(st.integers(0, max(len(content) - 1, 0)), max_size=4)):
            if content:
                content[at] ^= 1 << data.draw(st.integers(0, 7))
        path.write_bytes(content)
        found, message = RADIANCE, "read"
        try:
            found, _ = read_radiance(path)
        except UserError as error:
            message = str(error)
        assert len(message.splitlines()) == 1
        assert (found.ndim, found.shape[2], found.dtype) == (3, 3, np.float32)


PRINT_WHILE_ANOTHER_THREAD_READS = """
import os, sys, threading
from vemlight.light.quiet import silent
reading, printed = threading.Event(), threading.Event()
def read():
    with silent():
        reading.set()
        printed.wait()
        print("of Python's in the reader"), os.write(2, b"of C in the reader")
thread = threading.Thread(target=read)
thread.start()
reading.wait()
print("result")
print("warning", file=sys.stderr)
taken = sys.stderr
printed.set()
thread.join()
print("later", file=taken)
print("end", file=sys.stderr)
"""


def test_what_another_thread_prints_while_a_file_is_read_is_shown():
    done = subprocess.run([sys.executable, "-c", PRINT_WHILE_ANOTHER_THREAD_READS], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "result\n", "warning\nlater\nend\n")
