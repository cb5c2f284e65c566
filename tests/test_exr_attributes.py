"""Rendered pictures in OpenEXR: halves where they hold the picture, and number, time, rate and white as the standard has them."""

from fractions import Fraction

import numpy as np
import OpenEXR
import pytest

from vemlight.light.images import write_exr
from vemlight.renderer.output.exr_attributes import HALF_MAX, exr_pixels, time_attributes


def test_a_picture_is_in_halves_unless_it_has_more_or_floats_are_asked_for():
    picture = np.array([[[0.1, 1.0, HALF_MAX, 1.0]]], np.float32)
    assert exr_pixels(picture, "half").dtype == np.float16
    assert np.allclose(exr_pixels(picture, "half"), picture, rtol=2**-11)
    assert exr_pixels(picture, "float").dtype == np.float32
    sun = picture * np.float32(2)
    assert np.array_equal(exr_pixels(sun, "half"), sun)
    assert exr_pixels(sun, "half").dtype == np.float32
    assert exr_pixels(np.zeros((0, 4, 4), np.float32), "half").dtype == np.float16


def header_of(tmp_path, attributes: dict) -> dict:
    write_exr(tmp_path / "a.exr", np.zeros((2, 2, 4), np.float16), attributes)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        return dict(file.header())


def test_each_attribute_comes_back_from_the_file(tmp_path):
    captured_ns = 1_700_000_000_123_456_789
    header = header_of(tmp_path, {**time_attributes(2**31 + 5, 3725.48, 30000 / 1001, captured_ns), "whiteLuminance": 250.0})
    assert (header["imageCounter"], header["vemlight:sequence"], header["vemlight:time_s"]) == (5, str(2**31 + 5), "3725.48")
    assert Fraction(header["framesPerSecond"]) == Fraction(30000, 1001)
    assert (header["capDate"], header["utcOffset"], header["vemlight:time_ns"]) == ("2023:11:14 22:13:20", 0.0, str(captured_ns))
    assert header["whiteLuminance"] == 250
    assert header["colorInteropID"] == "lin_rec709_scene"


@pytest.mark.parametrize(
    ("time_s", "fps", "code"),
    [
        (0.0, 25, (0, 0, 0, 0)), (0.96, 25, (0, 0, 0, 24)), (1.0, 25, (0, 0, 1, 0)), (3725.48, 25, (1, 2, 5, 12)),
        (86400.0, 25, (0, 0, 0, 0)), (30 * 1001 / 30000, 30000 / 1001, (0, 0, 1, 0)), (59 / 60, 60, (0, 0, 0, 29)),
        (0.5, 0.2, (0, 0, 0, 0)),
    ],
)  # fmt: skip
def test_the_time_code_counts_the_source_s_frames(tmp_path, time_s, fps, code):
    found = header_of(tmp_path, time_attributes(0, time_s, fps))["timeCode"]
    assert (found.hours, found.minutes, found.seconds, found.frame) == code
    assert (found.dropFrame, found.userData) == (0, 0)


def test_what_is_not_known_is_left_out():
    assert set(time_attributes(0, 0.0)) == {"imageCounter", "vemlight:sequence", "vemlight:time_s"}
