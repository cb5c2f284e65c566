"""Portable float maps (.pfm): rows from below, float32, gray or RGB.

Paul Debevec's format: "PF" or "Pf", width and height, and a number whose sign says the byte order (negative: little-endian) and whose size
multiplies the values.
"""

import re
from pathlib import Path

import numpy as np

from vemlight.errors import UserError
from vemlight.files import read_file
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES

HEADER = re.compile(rb"P([Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]{1,40})(?:[ \t]*\r?\n|\s)")
LARGEST = float(np.finfo(np.float32).max)


def read_pfm(path: Path) -> np.ndarray:
    """(height, width, 3) float32; gray is repeated. Raises UserError for a file that is none, is too large, or is cut off."""
    data = read_file(path, MAX_IMAGE_BYTES)
    head = HEADER.match(data[:256])
    try:
        scale = float(head[4]) if head else 0.0
    except ValueError:
        scale = 0.0
    if head is None or not 0 < abs(scale) <= LARGEST:
        raise UserError(f"{path}: is no portable float map: it does not begin with PF or Pf, two sizes and a scale; write it again")
    channels, width, height = 3 if head[1] == b"F" else 1, int(head[2]), int(head[3])
    LIMITS.check(path, width, height, len(data), 4 * channels)
    count = width * height * channels
    if len(data) < head.end() + 4 * count:
        raise UserError(f"{path}: is cut off: {len(data) - head.end()} of {4 * count} bytes of pixels are there; copy it again")
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4", count, head.end()).reshape(height, width, channels)
    with np.errstate(over="ignore"):  # what is infinite then, is no light, which is said
        pixels = values[::-1].astype(np.float32) * np.float32(abs(scale))
    return np.ascontiguousarray(pixels if channels == 3 else np.repeat(pixels, 3, axis=-1))
