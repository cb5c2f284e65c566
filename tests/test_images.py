"""Radiance and pictures as files: there and back, and one line for what cannot be read."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vemlight.errors import UserError
from vemlight.light.images import read_codes, read_radiance, write_exr, write_png

RADIANCE = np.random.default_rng(0).lognormal(0, 3, (5, 7, 3)).astype(np.float32)


def test_an_exr_comes_back_with_every_bit_and_its_attributes(tmp_path):
    spoilt = RADIANCE.copy()
    spoilt[0, 0], spoilt[1, 1], spoilt[2, 2] = np.nan, np.inf, -1
    write_exr(tmp_path / "a.exr", spoilt, {"vemlight:ns": "1099511627776"})
    found, attributes = read_radiance(tmp_path / "a.exr")
    np.testing.assert_array_equal(found, spoilt)
    assert attributes["vemlight:ns"] == "1099511627776"
    assert attributes["colorInteropID"] == "lin_rec709_scene"


def test_gray_is_repeated_and_alpha_left_out(tmp_path):
    write_exr(tmp_path / "gray.exr", RADIANCE[..., 0])
    np.testing.assert_array_equal(read_radiance(tmp_path / "gray.exr")[0], RADIANCE[..., :1].repeat(3, axis=-1))
    write_exr(tmp_path / "rgba.exr", np.concatenate([RADIANCE, RADIANCE[..., :1]], axis=-1))
    np.testing.assert_array_equal(read_radiance(tmp_path / "rgba.exr")[0], RADIANCE)
    half = RADIANCE.astype(np.float16)
    write_exr(tmp_path / "half.exr", half)
    np.testing.assert_array_equal(read_radiance(tmp_path / "half.exr")[0], half.astype(np.float32))


def test_an_hdr_comes_back_to_its_8_bits(tmp_path):
    cv2.imwrite(str(tmp_path / "a.hdr"), np.ascontiguousarray(RADIANCE[..., ::-1]))
    found, attributes = read_radiance(tmp_path / "a.hdr")
    np.testing.assert_allclose(found, RADIANCE, atol=float(RADIANCE.max()) / 128)
    np.testing.assert_allclose(found.max(axis=-1), RADIANCE.max(axis=-1), rtol=1 / 128)  # the brightest of three has all digits
    assert attributes == {}


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
    with pytest.raises(UserError, match=name) as told:
        read_radiance(tmp_path / name)
    assert len(str(told.value).splitlines()) == 1


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
        found, told = RADIANCE, "read"
        try:
            found, _ = read_radiance(path)
        except UserError as error:
            told = str(error)
        assert len(told.splitlines()) == 1
        assert (found.ndim, found.shape[2], found.dtype) == (3, 3, np.float32)
