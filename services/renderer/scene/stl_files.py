"""STL files, binary and text.

A file is binary when the triangles that its header counts are in it, whatever its first word: many binary files begin with "solid", and
some have bytes behind the last triangle. Library readers take one or the other for damage.
"""

import re
import struct

import numpy as np

from vemlight.renderer.scene.meshes import VertexAttributes
from vemlight.renderer.scene.source_mesh import FileMeshes, SourceMesh

HEADER_BYTES = 84  # 80 of text, and the number of triangles
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
NUMBER = rb"[-+]?(?:\d[\d.]*|\.\d+|nan|inf)(?:e[-+]?\d+)?"
VERTEX = re.compile(rb"\bvertex[ \t\n]+(%b)[ \t\n]+(%b)[ \t\n]+(%b)(?=[ \t\n]|$)" % (NUMBER, NUMBER, NUMBER), re.IGNORECASE)
NAMES = re.compile(rb"^[ \t]*(?:end)?solid\b(?![^\n]*\bvertex[ \t]+[-+.\d])[^\n]*$", re.MULTILINE | re.IGNORECASE)
TEXT = re.compile(rb"\s*solid\b", re.IGNORECASE)
FACET = re.compile(rb"\bfacet\b", re.IGNORECASE)
END = re.compile(rb"\bendsolid\b", re.IGNORECASE)


def read_stl(content: bytes) -> FileMeshes:
    """The triangles of a file, all solids together. Raises ValueError for what is no STL, or is cut off."""
    left_out: list[str] = []
    (count,) = struct.unpack_from("<I", content, HEADER_BYTES - 4) if len(content) >= HEADER_BYTES else (0,)
    if 0 < count <= (len(content) - HEADER_BYTES) // TRIANGLE.itemsize:
        corners = np.frombuffer(content, TRIANGLE, count, HEADER_BYTES)["corners"].astype(np.float64)
    elif TEXT.match(content):
        corners = _text_corners(content)
        if len(corners) and not END.search(content):
            left_out.append("it ends without endsolid: it may be cut off")
    else:
        raise ValueError(f"has {len(content)} bytes and its header counts {count} triangles: it was cut off, or is no STL")
    if not len(corners):
        return FileMeshes([], left_out)
    triangles = np.arange(3 * len(corners)).reshape(-1, 3)
    return FileMeshes([SourceMesh(VertexAttributes(corners.reshape(-1, 3)), triangles, np.eye(4), None)], left_out)


def _text_corners(content: bytes) -> np.ndarray:
    """The corners (m, 3, 3) of a text file's facets."""
    text = NAMES.sub(b"", content.replace(b"\r", b"\n").replace(b"\f", b" "))
    facets = sum(1 for _ in FACET.finditer(text))
    numbers = np.fromiter((float(number) for found in VERTEX.finditer(text) for number in found.groups()), np.float64)
    if len(numbers) != 9 * facets:
        raise ValueError(f"has {facets} facets and {len(numbers) // 3} vertices with three numbers, which is not three a facet")
    return numbers.reshape(-1, 3, 3)
