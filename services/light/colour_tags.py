"""What a file or a camera's driver says of its colours, in the names of our settings.

The numbers are those of ITU-T H.273 (2021), tables 2 to 4, which video files and FFmpeg share.
"""

from typing import NamedTuple

TRANSFERS = {1: "bt709", 6: "bt709", 14: "bt709", 15: "bt709", 11: "bt709", 13: "srgb", 16: "pq", 18: "hlg", 8: "linear"}
PRIMARIES = {1: "bt709", 5: "bt470bg", 6: "smpte170m", 7: "smpte170m", 9: "bt2020", 11: "p3dci", 12: "p3d65"}
MATRICES = {0: "rgb", 1: "bt709", 5: "bt601", 6: "bt601", 9: "bt2020"}
RANGES = {1: "limited", 2: "full"}  # FFmpeg's numbers
UNSAID = (None, 2)  # "unspecified"; 0 and 3 are reserved
OTHERS = {  # names of what is not read, for the line that refuses it
    "transfer": {4: "gamma 2.2", 5: "gamma 2.8", 7: "SMPTE 240M", 9: "log 100", 10: "log 316", 12: "BT.1361", 17: "SMPTE 428"},
    "primaries": {4: "BT.470 M", 8: "film", 10: "CIE XYZ", 22: "EBU 3213"},
    "matrix": {4: "FCC", 7: "SMPTE 240M", 8: "YCgCo", 10: "BT.2020 constant luminance", 11: "SMPTE 2085", 12: "chromaticity-derived",
               13: "chromaticity-derived constant luminance", 14: "ICtCp"},
}  # fmt: skip


class ColourTags(NamedTuple):
    """Names of a transfer, of primaries, of a matrix and of a range; None where nothing is said, "tag N" where it is not read."""

    transfer: str | None = None
    primaries: str | None = None
    matrix: str | None = None
    range: str | None = None


def tags_from_numbers(transfer: int, primaries: int, matrix: int, range_: int) -> ColourTags:
    """The tags of H.273's numbers for transfer, primaries and matrix, and FFmpeg's for the range."""
    return ColourTags(
        _name("transfer", transfer, TRANSFERS),
        _name("primaries", primaries, PRIMARIES),
        _name("matrix", matrix, MATRICES),
        RANGES.get(range_),
    )


def _name(what: str, number: int, names: dict[int, str]) -> str | None:
    reserved = number in (3, *((0,) if what != "matrix" else ()))
    if number in UNSAID or reserved:
        return None
    return names.get(number) or f"tag {number} ({OTHERS[what].get(number, 'unknown')})"
