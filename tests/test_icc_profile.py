"""ICC profiles by their numbers: what is sRGB by its name may be linear."""

import resource
import struct

import numpy as np
import pytest

from vemlight.light.colour_tags import ColourTags
from vemlight.light.icc_profile import D50, tags_of_profile
from vemlight.light.primaries import PRIMARIES, adapted_white, xyz_from_primaries
from vemlight.light.transfers import TRANSFERS


def fixed(*numbers):
    return struct.pack(f">{len(numbers)}i", *(round(number * 65536) for number in numbers))


def power(gamma):
    return b"curv\0\0\0\0" + (struct.pack(">I", 0) if gamma == 1 else struct.pack(">IH", 1, round(gamma * 256)))


def table(name, count=1024):
    values = np.rint(65535 * TRANSFERS[name].light_from_signal(np.linspace(0, 1, count))).astype(">u2")
    return b"curv\0\0\0\0" + struct.pack(">I", count) + values.tobytes()


def formula(kind, *numbers):
    return b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + fixed(*numbers)


SRGB = formula(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def profile(curve, primaries="bt709", space=b"RGB ", more=None):
    numbers = PRIMARIES[primaries]
    xyz = adapted_white(numbers[6:8], D50) @ xyz_from_primaries(numbers)
    tags = {name: b"XYZ \0\0\0\0" + fixed(*column) for name, column in zip((b"rXYZ", b"gXYZ", b"bXYZ"), xyz.T, strict=True)}
    tags |= {b"rTRC": curve, b"gTRC": curve, b"bTRC": curve, b"kTRC": curve} | (more or {})
    entries = content = b""
    for name, value in tags.items():
        entries += name + struct.pack(">II", 132 + 12 * len(tags) + len(content), len(value))
        content += value
    return b"\0" * 16 + space + b"XYZ ".ljust(108, b"\0") + struct.pack(">I", len(tags)) + entries + content


@pytest.mark.parametrize(("curve", "transfer"), [
    (SRGB, "srgb"), (table("srgb"), "srgb"), (formula(4, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0, 0), "srgb"),
    (power(1), "linear"), (formula(0, 1.0), "linear"), (power(2.4), "bt1886"), (formula(0, 2.4), "bt1886"), (table("bt709"), "bt709"),
    (power(2.2), None), (power(1.8), None), (formula(1, 2.4, 1, -0.1), None), (formula(2, 2.4, 1, 0, 0.1), None), (table("pq"), None),
])  # fmt: skip
def test_curves(curve, transfer):
    assert tags_of_profile(profile(curve)) == ColourTags(transfer, "bt709")


@pytest.mark.parametrize("primaries", ["bt709", "bt2020", "p3d65", "ap0", "ap1", "smpte170m"])
def test_primaries(primaries):
    assert tags_of_profile(profile(SRGB, primaries)) == ColourTags("srgb", primaries)


def test_what_says_nothing():
    for content in (b"", b"garbage" * 30, profile(b"mft1"), profile(SRGB, space=b"CMYK"), profile(SRGB, more={b"A2B0": b"mft2"})):
        assert tags_of_profile(content) == ColourTags()


def test_a_table_that_promises_more_than_there_is_costs_nothing():
    started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert tags_of_profile(profile(b"curv\0\0\0\0\xff\xff\xff\xff\0\0")) == ColourTags()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - started < 100_000  # kB


def test_numbers_of_h_273_and_gray():
    assert tags_of_profile(profile(SRGB, more={b"cicp": b"cicp\0\0\0\0\x09\x10\x00\x01"})) == ColourTags("pq", "bt2020")
    assert tags_of_profile(profile(power(1), space=b"GRAY")).transfer == "linear"
