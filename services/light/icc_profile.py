"""ICC profiles of pictures (ICC.1:2022, the same in version 2): their curve and primaries, by the numbers in them and not by their names.

The names lie: "sRGB IEC61966-2.1 (Linear RGB Profile)" and "GIMP built-in Linear sRGB" are linear.
"""

import struct

import numpy as np

from vemlight.light.colour_tags import ColourTags, tags_from_numbers
from vemlight.light.primaries import PRIMARIES, adapted_white, xyz_from_primaries
from vemlight.light.transfers import TRANSFERS

HEADER_BYTES = 128
D50 = (0.3457, 0.3585)  # white of the space in which profiles tell colours
CURVES = ("srgb", "linear", "bt709", "bt1886")  # of profiles; the others are told by numbers of H.273
SIGNAL = np.linspace(0, 1, 65)
CURVE_TOLERANCE = 0.002  # of light: sRGB and gamma 2.2 are 0.008 apart, tables of sRGB 1e-4
PRIMARIES_TOLERANCE = 0.004  # of XYZ: bt709 and smpte170m are 0.02 apart, roundings 5e-4
PARAMETERS = (1, 3, 4, 5, 7)  # of the five kinds of curve by formula


def tags_of_profile(profile: bytes) -> ColourTags:
    """What an RGB or gray profile says, with None for a curve or primaries that have no name here, and for what is no profile."""
    try:
        return _said(profile)
    except (struct.error, KeyError, ValueError, IndexError):
        return ColourTags()


def _said(profile: bytes) -> ColourTags:
    with np.errstate(all="ignore"):  # a damaged curve has any numbers
        tags = _tags(profile)
        if number := tags.get(b"cicp"):
            primaries, transfer, *_ = struct.unpack_from("4B", number, 8)
            return tags_from_numbers(transfer, primaries, 2, 2)._replace(range=None)
        if profile[16:20] == b"GRAY":
            return ColourTags(_curve_name([tags[b"kTRC"]]), "bt709")
        if profile[16:20] != b"RGB " or b"A2B0" in tags:
            return ColourTags()
        colorants = np.stack([np.array(struct.unpack_from(">3i", tags[name], 8)) / 65536 for name in (b"rXYZ", b"gXYZ", b"bXYZ")], axis=1)
        return ColourTags(_curve_name([tags[b"rTRC"], tags[b"gTRC"], tags[b"bTRC"]]), _primaries_name(colorants))


def _tags(profile: bytes) -> dict[bytes, bytes]:
    """The tags of a profile, each from its type on."""
    (count,) = struct.unpack_from(">I", profile, HEADER_BYTES)
    found = {}
    for k in range(min(count, 100)):
        name, at, size = struct.unpack_from(">4sII", profile, HEADER_BYTES + 4 + 12 * k)
        found[name] = profile[at : at + size]
    return found


def _curve_name(curves: list[bytes]) -> str | None:
    light = [_light(curve) for curve in curves]
    for name in CURVES:
        if all(np.abs(values - TRANSFERS[name].light_from_signal(SIGNAL)).max() < CURVE_TOLERANCE for values in light):
            return name
    return None


def _light(curve: bytes) -> np.ndarray:
    """The light of SIGNAL by a curve: a table, a power, or a formula (ICC.1:2022, 10.6 and 10.18)."""
    if curve[:4] == b"curv":
        (count,) = struct.unpack_from(">I", curve, 8)
        if 12 + 2 * count > len(curve):
            raise ValueError("a table that is longer than its tag")
        values = np.array(struct.unpack_from(f">{count}H", curve, 12), np.float64)
        if count == 0:
            return SIGNAL
        return SIGNAL ** (values[0] / 256) if count == 1 else np.interp(SIGNAL, np.linspace(0, 1, count), values / 65535)
    if curve[:4] != b"para":
        raise ValueError("another kind of curve")
    (kind,) = struct.unpack_from(">H", curve, 8)
    g, a, b, c, d, e, f = (np.array(struct.unpack_from(f">{PARAMETERS[kind]}i", curve, 12)) / 65536).tolist() + [0.0] * (
        7 - PARAMETERS[kind]
    )
    if kind == 0:
        a, d = 1.0, 0.0
    elif kind in (1, 2):  # c is what is added, and the foot is flat
        e = f = c if kind == 2 else 0.0
        c, d = 0.0, -b / a
    return np.where(d <= SIGNAL, np.maximum(a * SIGNAL + b, 0) ** g + e, c * SIGNAL + f)


def _primaries_name(colorants: np.ndarray) -> str | None:
    for name, primaries in PRIMARIES.items():
        xyz = adapted_white(primaries[6:8], D50) @ xyz_from_primaries(primaries)
        if np.abs(colorants - xyz).max() < PRIMARIES_TOLERANCE:
            return name
    return None
