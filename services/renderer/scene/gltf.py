"""glTF 2.0 files as their JSON and the numbers and bytes that it speaks of; what they mean is read elsewhere.

A fault of a file is a ValueError, LookupError, TypeError, AttributeError, OverflowError, OSError or struct.error.
"""

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # componentType, section 3.6.2.2
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
ROOT = "world"
MOST_ROWS = 50_000_000  # of an accessor; as many places are 1.2 GB
DRAWN_MODES = (4, 5)  # triangles and strips
NAMED_MODES = (0, 1, *DRAWN_MODES)  # to which trimesh gives names: points and lines too, no loops and fans
READ_EXTENSIONS = frozenset(
    {
        "EXT_texture_webp", "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_unlit", "KHR_mesh_quantization", "KHR_texture_transform",
    }
)  # fmt: skip


class GltfFile:
    """A .gltf or .glb file. document: its JSON. Raises ValueError for one that needs an extension which is not read here."""

    def __init__(self, path: Path) -> None:
        self.document, self._binary = _document(path)
        self._folder = path.parent
        self._read: dict[str, bytes] = {}
        if missing := sorted(set(self.document.get("extensionsRequired", [])) - READ_EXTENSIONS):
            raise ValueError(f"needs the extension {str(missing[0])[:60]}, which is not read here")

    def primitives(self) -> dict[str, dict[str, Any]]:
        """Each mesh primitive by the name that trimesh gives it."""
        found: dict[str, dict[str, Any]] = {}
        counts: dict[Any, int] = {}
        for mesh in self.document.get("meshes", []):
            for primitive in mesh["primitives"]:
                name = trimesh.util.unique_name(mesh.get("name", "GLTF"), found, counts=counts)
                if primitive.get("mode", 4) in NAMED_MODES:
                    found[name] = primitive
        return found

    def nodes(self) -> dict[str, int]:
        """Each node's number by the name that trimesh gives it."""
        names: dict[str, int] = {}
        counts: dict[Any, int] = {}
        for number, node in enumerate(self.document.get("nodes", [])):
            names[trimesh.util.unique_name(node.get("name", str(number)), names, counts=counts)] = number
        if ROOT in names:  # of trimesh's own graph, which calls that node otherwise
            other = trimesh.util.unique_name(ROOT, names)
            names[other] = names.pop(ROOT)
        return names

    def array(self, number: int) -> np.ndarray:
        """An accessor's numbers (section 3.6), (count, width) float64; normalised integers become fractions."""
        accessor = at(self.document["accessors"], number, "accessors")
        dtype, width, count = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]], int(accessor["count"])
        if not 0 < count <= MOST_ROWS:
            raise ValueError(f"has {count} rows in accessor {number}")
        numbers = np.zeros((count, width))
        if "bufferView" in accessor:
            numbers[:] = self._strided(accessor, dtype, width, count)
        if sparse := accessor.get("sparse"):
            places, replaced = sparse["indices"], int(sparse["count"])
            if not 0 < replaced <= count:
                raise ValueError(f"has {replaced} sparse rows for {count} in accessor {number}")
            rows = self._strided(places, np.dtype(TYPES[places["componentType"]]), 1, replaced)[:, 0]
            numbers[rows] = self._strided(sparse["values"], dtype, width, replaced)
        return np.maximum(numbers / np.iinfo(dtype).max, -1) if accessor.get("normalized") and dtype.kind in "iu" else numbers

    def _strided(self, where: dict[str, Any], dtype: np.dtype, width: int, count: int) -> np.ndarray:
        """`count` rows of `width` numbers at `where`, which names a buffer view and perhaps an offset in it."""
        view = at(self.document["bufferViews"], where["bufferView"], "buffer views")
        first = int(view.get("byteOffset", 0)) + int(where.get("byteOffset", 0))
        stride = int(view.get("byteStride", width * dtype.itemsize))
        data = self._buffer(int(view["buffer"]))
        if first < 0 or stride < width * dtype.itemsize or first + (count - 1) * stride + width * dtype.itemsize > len(data):
            raise ValueError("has numbers that lie outside their buffer")
        return np.ndarray((count, width), dtype, data, first, (stride, dtype.itemsize))

    def image(self, number: int) -> bytes:
        """An image's file. Raises FileNotFoundError when it is not there."""
        image = at(self.document["images"], number, "images")
        if "uri" in image:
            return self._resource(image["uri"])
        view = at(self.document["bufferViews"], image["bufferView"], "buffer views")
        first = int(view.get("byteOffset", 0))
        return self._buffer(int(view["buffer"]))[first : first + int(view["byteLength"])]

    def _buffer(self, number: int) -> bytes:
        uri = at(self.document["buffers"], number, "buffers").get("uri")
        if uri is None:
            return self._binary
        if uri not in self._read:
            self._read[uri] = self._resource(uri)
        return self._read[uri]

    def _resource(self, uri: str) -> bytes:
        if not uri.startswith("data:"):
            return (self._folder / unquote(uri)).read_bytes()
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except binascii.Error as error:
            raise ValueError("has data that is not base64") from error


def at(rows: list[Any], number: int, what: str) -> Any:
    """A row by its number. Raises IndexError outside; a file cannot count from the end."""
    if not 0 <= number < len(rows):
        raise IndexError(f"speaks of number {number} of its {len(rows)} {what}")
    return rows[number]


def _document(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON of a file and, of a .glb, the binary chunk (section 4)."""
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return json.loads(data, parse_constant=_no_number), b""
    length, _ = struct.unpack_from("<II", data, 12)
    document = json.loads(data[20 : 20 + length], parse_constant=_no_number)
    return document, data[28 + length :][: struct.unpack_from("<I", data, 20 + length)[0]] if len(data) > 28 + length else b""


def _no_number(constant: str) -> float:
    raise ValueError(f"has {constant} where a number must be")
