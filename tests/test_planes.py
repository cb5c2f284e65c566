"""Planes of codes: each layout against FFmpeg's own conversion and against numpy, strides, spans, and counts of white."""

import itertools

import av
import numpy as np
import pytest

from vemlight.capture.colour_coding import VIDEO, colour_coding, signal_from_codes
from vemlight.capture.planes import layout_of, linear_from_planes, planes_from_image, planes_from_video_frame
from vemlight.capture.scatter import ONE_THREAD, Threads
from vemlight.errors import UserError
from vemlight.light.colour_tags import ColourTags
from vemlight.light.transfers import TRANSFERS
from vemlight.settings import Capture

BLOCK = 32  # pixels of one colour on a side: FFmpeg's filters reach over less than a third of it
WIDTH, HEIGHT = 2 * BLOCK + 8, BLOCK  # no multiple of FFmpeg's alignment, so that lines are padded
FULL_RGB = ColourTags("srgb", "bt709", "rgb", "full")
_names = map("frame {}".format, itertools.count())


def whole(planes):
    return np.tile([0, planes.width], (planes.height, 1))


def linear(planes, tags, threads=ONE_THREAD, **settings):
    return linear_from_planes(planes, colour_coding(Capture(**settings), next(_names), tags), whole(planes), threads)


def picture(rng):
    """Blocks of colours, (HEIGHT, WIDTH, 3) uint16 of 16 bits."""
    colours = rng.integers(8000, 56_000, (HEIGHT // BLOCK, WIDTH // BLOCK + 1, 3))
    return np.repeat(np.repeat(colours, BLOCK, axis=0), BLOCK, axis=1)[:, :WIDTH].astype(np.uint16)


def frame_as(rgb16, name):
    """FFmpeg's own conversion to the pixel format `name`, in BT.709 and limited range where it is Y'CbCr."""
    frame = av.VideoFrame.from_ndarray(rgb16, "rgb48le")
    return frame.reformat(format=name, dst_colorspace="ITU709", src_color_range="JPEG", dst_color_range="MPEG")


LAYOUTS = [
    "yuv420p",
    "yuv422p",
    "yuv444p",
    "yuv440p",
    "yuv411p",
    "yuv410p",
    "yuv420p10le",
    "yuv422p10le",
    "yuv444p12le",
    "yuv444p16le",
    "yuva444p10le",
    "nv12",
    "nv21",
    "nv16",
    "nv24",
    "p010le",
    "p016le",
    "p210le",
    "yuyv422",
    "uyvy422",
    "yvyu422",
    "rgb24",
    "bgr24",
    "rgba",
    "bgra",
    "argb",
    "abgr",
    "rgb0",
    "0bgr",
    "rgb48le",
    "bgr48le",
    "rgba64le",
    "gbrp",
    "gbrp10le",
    "gbrap12le",
    "gbrp16le",
]


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_is_the_same_picture(name):
    rgb16 = picture(np.random.default_rng(3))
    frame = frame_as(rgb16, name)
    planes = planes_from_video_frame("film", frame)
    assert (planes.width, planes.height) == (WIDTH, HEIGHT)
    tags = FULL_RGB if planes.layout.is_rgb else VIDEO._replace(transfer="srgb")
    got = linear(planes, tags).pixels
    wanted = TRANSFERS["srgb"].light_from_signal(rgb16 / 65535)
    # two steps of 8 bits, or half a one of 10, at the slope of sRGB; swscale rounds luma and chroma to codes
    for left in (0, BLOCK):
        middle = np.s_[BLOCK * 3 // 8 : BLOCK * 5 // 8, left + BLOCK * 3 // 8 : left + BLOCK * 5 // 8]
        np.testing.assert_allclose(got[middle], wanted[middle], atol=0.03 if planes.layout.bits == 8 else 0.008)


@pytest.mark.parametrize(("name", "bits"), [("gray", 8), ("gray10le", 10), ("gray16le", 16)])
def test_gray_has_no_matrix(name, bits):
    codes = np.arange(256, dtype=np.uint16).reshape(8, 32) << (bits - 8)
    planes = planes_from_image(codes.astype(np.uint8) if bits == 8 else codes, bits)
    assert planes.layout == layout_of(name)
    got = linear(planes, FULL_RGB).pixels
    np.testing.assert_allclose(got[..., 0], TRANSFERS["srgb"].light_from_signal(codes / (2**bits - 1)), atol=1e-5)
    np.testing.assert_array_equal(got[..., 0], got[..., 2])


@pytest.mark.parametrize("name", ["pal8", "gbrpf32le", "yuv420p10be", "rgb565le", "bayer_rggb8", "monob", "xyz12le"])
def test_other_layouts_are_none(name):
    assert layout_of(name) is None


def test_a_frame_of_another_layout_is_refused_by_its_name():
    frame = av.VideoFrame.from_ndarray(np.zeros((4, 4, 3), np.uint8), "rgb24").reformat(format="rgb565le")
    with pytest.raises(UserError, match="film: its pixels are rgb565le"):
        planes_from_video_frame("film", frame)


def test_16_bits_of_linear_light_keep_their_darkest_codes():
    codes = np.array([[1, 2, 5, 100, 65535]], np.uint16).repeat(3).reshape(1, 5, 3)
    got = linear(planes_from_image(codes, 16), FULL_RGB._replace(transfer="linear")).pixels
    np.testing.assert_allclose(got, codes / 65535, rtol=2e-2, atol=1e-7)


def test_any_number_of_threads_gives_the_same_bytes():
    rng = np.random.default_rng(1)
    planes = planes_from_image(rng.integers(0, 256, (40, 30, 3)).astype(np.uint8), 8)
    one = linear(planes, FULL_RGB)
    for count in (2, 3, 8):
        several = linear(planes, FULL_RGB, Threads(count))
        np.testing.assert_array_equal(one.pixels, several.pixels)
        assert one.saturated == several.saturated


def test_only_spans_are_read_and_counted():
    planes = planes_from_image(np.full((4, 6, 3), 255, np.uint8), 8)
    spans = np.array([[0, 0], [1, 3], [0, 6], [5, 6]])
    coding = colour_coding(Capture(), "spans", FULL_RGB)
    picture_ = linear_from_planes(planes, coding, spans, ONE_THREAD)
    assert picture_.saturated == 3 * (0 + 2 + 6 + 1)
    inside = np.zeros((4, 6), bool)
    inside[1, 1:3] = inside[2] = inside[3, 5] = True
    np.testing.assert_array_equal(picture_.pixels[..., 1] > 0.99, inside)
    assert not picture_.pixels[~inside].any()


@pytest.mark.parametrize(("code", "count"), [(234, 0), (235, 3), (255, 3)])
def test_white_is_the_code_of_signal_1(code, count):
    planes = planes_from_image(np.full((1, 1, 3), code, np.uint8), 8)
    assert linear(planes, FULL_RGB._replace(range="limited")).saturated == count


def test_light_of_an_hlg_display():
    """L = 1000 Y_s^0.2 E (ITU-R BT.2100-2, table 5): of gray, and of a pure blue, whose luminance is a small part."""
    hlg = ColourTags("hlg", "bt2020", "rgb", "full")
    signals = np.array([[[0.5, 0.5, 0.5], [0.0, 0.0, 0.8]]])
    planes = planes_from_image(np.rint(signals * 65535).astype(np.uint16), 16)
    got = linear(planes, hlg, light="display").pixels
    scene = TRANSFERS["hlg"].light_from_signal(signals)
    shown = 1000 * (scene @ (0.2627, 0.6780, 0.0593))[..., None] ** 0.2 * scene
    np.testing.assert_allclose(got, shown @ colour_coding(Capture(), "hlg", hlg).rec709_from_light.T, rtol=2e-3, atol=0.05)


@pytest.mark.parametrize("name", ["yuv420p", "nv12"])
def test_colour_of_a_block_stays_the_blocks_mean(name):
    """Odd sizes, too: the last column's colour is that of its own block."""
    rng = np.random.default_rng(2)
    frame = av.VideoFrame(7, 5, name)
    for plane in frame.planes:
        samples = np.frombuffer(plane, np.uint8)  # type: ignore[call-overload]  # PyAV's types leave out that a plane is a buffer
        samples[:] = rng.integers(60, 200, plane.buffer_size)
    planes = planes_from_video_frame("odd", frame)
    signals = signal_from_codes(colour_coding(Capture(), "odd", VIDEO), 8, is_rgb=False)
    luma, *chroma = planes.samples
    blue, red = chroma if name == "yuv420p" else (chroma[0][:, 0::2], chroma[0][:, 1::2])
    y, x = np.mgrid[:5, :7]
    codes = np.stack([luma[:5, :7], blue[y // 2, x // 2], red[y // 2, x // 2], np.ones((5, 7))], axis=-1).astype(float)
    wanted = TRANSFERS["linear"].light_from_signal(np.clip(codes @ signals.T, -0.125, 1.125))
    np.testing.assert_allclose(linear(planes, VIDEO._replace(transfer="linear")).pixels, wanted, atol=1e-5)
