"""How large an image may be, decided by what its header says before memory is allocated for it."""

import struct
from pathlib import Path
from typing import NamedTuple

from vemlight.errors import UserError

MAX_IMAGE_BYTES = 2**31  # the largest image below, 2^27 pixels, uncompressed as float32 RGBA
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_CHUNK = struct.Struct(">I4s")  # length and name (PNG, third edition, 5.3)


class ImageLimits(NamedTuple):
    """side, pixels: of the image. free_bytes: what any file may decode to; ratio: beyond that, bytes decoded for a byte stored.

    Photographs and their maps are stored in a quarter to all of their bytes, drawn ones in a hundredth; a thousandth is a bomb.
    """

    side: int = 16384  # the largest lat-long maps are 16384 x 8192, above any camera's; a larger number is damage or an attack
    pixels: int = 2**27  # such a map: 1.6 GB as float32 RGB
    free_bytes: int = 64 * 2**20  # a 2048 x 2048 map of any colour, or of none
    ratio: int = 200

    def most_bytes(self, stored_bytes: int) -> int:
        """How much so many stored bytes may decode to."""
        return max(self.free_bytes, self.ratio * stored_bytes)

    def check(self, path: Path | str, width: int, height: int, stored_bytes: int, pixel_bytes: int = 12) -> None:
        """Raises UserError for an image that is too large, in itself or for the bytes that it is stored in."""
        if min(width, height) < 1:
            raise UserError(f"{path}: has {width} x {height} pixels, which is no picture; make it again")
        if not (0 < width <= self.side and 0 < height <= self.side and width * height <= self.pixels):
            limits = f"at most {self.side} on a side and {self.pixels} in all are read"
            raise UserError(f"{path}: has {width} x {height} pixels and {limits}; scale it down")
        if width * height * pixel_bytes > self.most_bytes(stored_bytes):
            raise UserError(f"{path}: has {width} x {height} pixels in {stored_bytes} bytes, which no picture has; copy it again")


LIMITS = ImageLimits()


def check_chunks(path: Path | str, data: bytes) -> None:
    """Raises UserError for a PNG that says of a chunk that it is longer than the rest of the file: libpng would take as much memory.

    Data of other formats pass.
    """
    at = len(PNG_SIGNATURE) if data.startswith(PNG_SIGNATURE) else len(data)
    while at + PNG_CHUNK.size <= len(data):
        length, name = PNG_CHUNK.unpack_from(data, at)
        at += PNG_CHUNK.size + length + 4  # a checksum follows
        if at > len(data):
            raise UserError(f"{path}: is cut off in its chunk {name.decode('latin-1')!a}, of {length} bytes; copy it again")
        if name == b"IEND":  # what follows is nobody's
            return
