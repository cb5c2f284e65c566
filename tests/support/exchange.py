"""Reads back what other programs are given, by the formulas of their formats."""

import struct

import numpy as np


def turned(rotations: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector (3,) or (1, 3) turned by unit quaternions (n, 4) x, y, z, w: v + 2 q x (q x v + w v)."""
    axis, w = rotations[:, :3], rotations[:, 3:]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)


def messages_of(bundle: bytes) -> list[tuple[str, list]]:
    """Address and arguments of each element of an OSC bundle, by the specification's text."""
    assert bundle[:16] == b"#bundle\0" + bytes(7) + b"\1"
    at, found = 16, []
    while at < len(bundle):
        (length,) = struct.unpack_from(">i", bundle, at)
        assert length % 4 == 0
        element = bundle[at + 4 : at + 4 + length]
        address, place = _text(element, 0)
        tags, place = _text(element, place)
        assert tags[0] == ","
        arguments = [struct.unpack_from(f">{tag}", element, place + 4 * k)[0] for k, tag in enumerate(tags[1:])]
        assert place + 4 * len(arguments) == length
        found.append((address, arguments))
        at += 4 + length
    return found


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(0, at)
    return data[at:end].decode(), end + 4 - end % 4
