"""Cameras in colour: what their drivers say of colours, and their bytes in every format against one picture."""

import io

import numpy as np
import pytest
from PIL import Image

from vemlight.capture.colour_coding import colour_coding
from vemlight.capture.jpeg_frames import JpegDecoder
from vemlight.capture.pixel_formats import FORMATS, MJPEG, PICTURES, codes_from_bytes, planes_from_bytes
from vemlight.capture.planes import layout_of, linear_from_planes
from vemlight.capture.scatter import ONE_THREAD
from vemlight.capture.v4l2_colour import defaults_of_driver, tags_from_driver
from vemlight.errors import UserError
from vemlight.light.colour import linear_from_srgb
from vemlight.light.colour_tags import ColourTags
from vemlight.settings import Capture

BY_NAME = {form.name: form for form in FORMATS.values()}
WIDTH, HEIGHT = 24, 8
LUMA = {"bt601": (0.299, 0.587, 0.114), "bt709": (0.2126, 0.7152, 0.0722)}


@pytest.mark.parametrize(("colorspace", "is_rgb", "is_jpeg", "wanted"), [
    (0, False, False, ("srgb", "bt709", "bt601", "limited")), (0, True, False, ("srgb", "bt709", "bt601", "full")),
    (0, False, True, ("srgb", "bt709", "bt601", "full")), (8, False, False, ("srgb", "bt709", "bt601", "limited")),
    (7, False, False, ("srgb", "bt709", "bt601", "full")), (3, False, False, ("bt709", "bt709", "bt709", "limited")),
    (10, False, False, ("bt709", "bt709", "bt2020", "limited")), (11, True, False, ("linear", "bt709", "bt601", "full")),
])  # fmt: skip
def test_what_default_stands_for(colorspace, is_rgb, is_jpeg, wanted):
    assert defaults_of_driver(colorspace, is_rgb, is_jpeg) == ColourTags(*wanted)


def test_what_a_driver_states():
    assert tags_from_driver(0, 0, 0, 0) == ColourTags()
    assert tags_from_driver(10, 6, 2, 7) == ColourTags("pq", "bt2020", "bt2020", "limited")
    assert tags_from_driver(3, 2, 1, 1) == ColourTags("bt709", "bt709", "bt709", "full")
    assert tags_from_driver(9, 8, 0, 3).primaries == "tag 9 (colorspace of the driver)"


def picture():
    """Blocks of 8 x 8 pixels of one colour, signals (HEIGHT, WIDTH, 3) 0 to 1."""
    return np.random.default_rng(6).uniform(0.2, 0.9, (1, 3, 3)).repeat(8, axis=0).repeat(8, axis=1)


def bytes_of(name, signals, matrix, padding):
    """The bytes of a picture as a camera sends it, in buffers; rows have `padding` bytes more."""
    form = BY_NAME[name]
    layout = layout_of(form.layout)
    assert layout is not None
    bits, unit = layout.bits, 2 ** (layout.bits - 8)
    if layout.is_rgb:
        components = [255 * signals[..., n] for n in range(3)]
    else:
        luma = signals @ LUMA[matrix]
        blue, red = ((signals[..., n] - luma) / (2 - 2 * LUMA[matrix][n]) for n in (2, 0))
        components = [unit * (16 + 219 * luma), unit * (128 + 224 * blue), unit * (128 + 224 * red)]
    planes = {}
    for component, values in zip(layout.components, components, strict=True):
        width, height = -(-WIDTH // 2**component.across), -(-HEIGHT // 2**component.down)
        pad = padding * component.step // layout.components[0].step >> component.across
        dtype = np.uint8 if layout.item == 1 else np.dtype("<u2")
        plane = planes.setdefault(component.plane, np.zeros((height, width * component.step + pad // layout.item), dtype))
        codes = np.rint(values[:: 2**component.down, :: 2**component.across]).astype(dtype) << layout.shift
        plane[:, component.offset : width * component.step : component.step] = codes
    assert bits in (8, 10)
    order = sorted(planes)
    if form.is_swapped:
        order[1:] = order[:0:-1]
    parts = [planes[n].tobytes() for n in order]
    strides = [planes[n].shape[1] * layout.item for n in order]
    return (parts, strides) if form.planes_apart else ([b"".join(parts)], strides[:1])


@pytest.mark.parametrize("padding", [0, 16])
@pytest.mark.parametrize("name", [name for name, layout, *_ in PICTURES if layout != MJPEG])
def test_every_format_is_the_same_picture(name, padding):
    signals, form = picture(), BY_NAME[name]
    data, strides = bytes_of(name, signals, "bt601", padding)
    planes = planes_from_bytes(data, form, WIDTH, HEIGHT, strides)
    coding = colour_coding(Capture(), name, ColourTags(), defaults_of_driver(0, planes.layout.is_rgb, False))
    got = linear_from_planes(planes, coding, np.tile([0, WIDTH], (HEIGHT, 1)), ONE_THREAD).pixels
    np.testing.assert_allclose(got, linear_from_srgb(signals), rtol=0.035, atol=2e-3)
    np.testing.assert_allclose(got.mean(axis=(0, 1)), linear_from_srgb(signals).mean(axis=(0, 1)), rtol=0.02)
    with pytest.raises(ValueError, match="no frame of 24x8"):
        planes_from_bytes([buffer[: len(buffer) // 2] for buffer in data], form, WIDTH, HEIGHT, strides)


def test_jpeg_frames():
    pixels = np.rint(255 * picture()).astype(np.uint8)
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=98, subsampling=1)
    decoder = JpegDecoder()
    for _ in range(2):
        planes = decoder.planes("camera", data.getvalue(), WIDTH, HEIGHT)
        assert planes is not None
        coding = colour_coding(Capture(), "mjpg", ColourTags(), defaults_of_driver(0, False, True))
        got = linear_from_planes(planes, coding, np.tile([0, WIDTH], (HEIGHT, 1)), ONE_THREAD).pixels
        np.testing.assert_allclose(got.mean(axis=(0, 1)), linear_from_srgb(picture()).mean(axis=(0, 1)), rtol=0.02)
    assert decoder.planes("camera", b"\xff\xd8 no picture", WIDTH, HEIGHT) is None
    with pytest.raises(UserError, match="sent a picture of 24x8 and had agreed to 48x8"):
        decoder.planes("camera", data.getvalue(), 48, HEIGHT)


@pytest.mark.parametrize("name", ["Y10P", "Y12P", "pRAA", "pGCC"])
@pytest.mark.parametrize(("width", "padding"), [(8, 0), (8, 7), (7, 1), (5, 0)])
def test_packed_codes(name, width, padding):
    """MIPI CSI-2's RAW10 and RAW12, packed bit by bit as the standard draws them."""
    form = BY_NAME[name]
    codes = np.random.default_rng(8).integers(0, 2**form.bits, (3, width)).astype(np.uint16)
    group = 4 if form.bits == 10 else 2
    rows = []
    for row in codes:
        row_bytes = b""
        for first in range(0, width, group):
            some = np.pad(row[first : first + group], (0, group))[:group]
            low = sum((int(code) & (2 ** (form.bits - 8) - 1)) << place * (form.bits - 8) for place, code in enumerate(some))
            row_bytes += bytes(int(code) >> (form.bits - 8) for code in some) + bytes([low])
        rows.append(row_bytes + b"\xee" * padding)
    stride = len(rows[0])
    got = codes_from_bytes(b"".join(rows), form, width, 3, stride)
    np.testing.assert_array_equal(got, codes)
