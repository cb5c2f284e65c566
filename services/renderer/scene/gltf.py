"""glTF 2.0 files: the JSON document, and the numbers, triangles and bytes that it refers to. What they mean is read elsewhere.

pygltflib takes 10 to 35 ms for the documents of small files, which json and the checks here read in 0.1 ms, and reads no accessors;
trimesh, which reads all that there is, knows neither sparse nor normalised accessors, nor animations, nor how textures are sampled.

A faulty file raises ValueError, LookupError, TypeError, AttributeError, OverflowError, OSError or struct.error; a reference out of its
folder UserError. What would take much memory is counted before it is made.
"""

import base64
import binascii
import codecs
import os
import struct
from errno import ENOENT
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from vemlight.files import contained_path, decoded_json, read_file
from vemlight.renderer.scene.polygons import strip_triangles

DTYPE_OF_COMPONENT = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # section 3.6.2.2
COMPONENTS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
MAX_ACCESSOR_ROWS = 50_000_000  # positions of as many vertices are 1.2 GB as float64
MAX_ROWS_WITHOUT_DATA = 2**20  # zeros that no bytes stand for, for sparse values to replace; a few bytes must not ask for gigabytes
MAX_BYTES = 2**30  # of a file and of all that it refers to: 10 million vertices of 48 bytes, and as much in textures
MAX_JSON_VALUES = 2**21  # 100,000 nodes of 20 values; each takes 32 to 88 bytes
FREE_NUMBERS = 2**24  # in all accessors: 134 MB as float64. More only from as many bytes: accessors may lie on top of each other
TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = MODES = 4, 5, 6  # of a primitive's triangles, section 5.24.4
READ_EXTENSIONS = frozenset(
    {
        "EXT_mesh_gpu_instancing", "EXT_texture_webp", "KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_ior",
        "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_unlit", "KHR_mesh_quantization", "KHR_node_visibility", "KHR_texture_transform",
    }
)  # fmt: skip


class GltfFile:
    """A .gltf or .glb file.

    document: its JSON. stored_bytes: of the file and the buffers read. where: for messages about references out of its folder. Raises
    ValueError for one that requires an extension which is not read here.
    """

    def __init__(self, path: Path, where: str = "", content: bytes | None = None, stored_bytes: int = 0) -> None:
        """content: of a .glb that was made of other files, which have so many bytes; None: of the file itself."""
        self.stored_bytes = stored_bytes
        if content is None:
            content = read_file(path, MAX_BYTES)
            self.stored_bytes = len(content)
        self.document, self._binary = _document(content)
        self._folder, self._where = path.parent, where or str(path)
        self._read: dict[str, bytes] = {}
        self._counted: set[Path] = set()
        self._arrays: dict[int, np.ndarray] = {}
        self._numbers = 0
        if not str(self.document["asset"]["version"]).startswith("2."):
            raise ValueError("is of another version than glTF 2")
        if (least := str(self.document["asset"].get("minVersion", "2.0"))) != "2.0":
            raise ValueError(f"needs glTF {least[:10]}, and 2.0 is read here")
        if missing := sorted(set(self.document.get("extensionsRequired", [])) - READ_EXTENSIONS):
            raise ValueError(f"needs the extension {str(missing[0])[:60]}, which is not read here")

    def array(self, number: int) -> np.ndarray:
        """An accessor's numbers (section 3.6), (count, components) float64, read-only; normalised integers become fractions."""
        if number not in self._arrays:
            self._arrays[number] = self._array(number)
            self._arrays[number].flags.writeable = False
        return self._arrays[number]

    def _array(self, number: int) -> np.ndarray:
        accessor = item(self.document["accessors"], number, "accessors")
        dtype = np.dtype(DTYPE_OF_COMPONENT[accessor["componentType"]])
        width, count = COMPONENTS_OF_TYPE[accessor["type"]], int(accessor["count"])
        if not 0 < count <= MAX_ACCESSOR_ROWS:
            raise ValueError(f"has {count} rows in accessor {number}")
        if "bufferView" not in accessor and count > MAX_ROWS_WITHOUT_DATA:
            raise ValueError(f"has {count} rows without data in accessor {number}")
        stored = self._strided(accessor, dtype, width, count) if "bufferView" in accessor else None
        self._numbers += count * width
        if self._numbers > max(FREE_NUMBERS, 2 * self.stored_bytes):
            raise ValueError(f"has {self._numbers} numbers in accessors that lie on top of each other")
        numbers = np.zeros((count, width)) if stored is None else stored.astype(np.float64)
        if sparse := accessor.get("sparse"):
            places, replaced = sparse["indices"], int(sparse["count"])
            if not 0 < replaced <= count:
                raise ValueError(f"has {replaced} sparse rows for {count} in accessor {number}")
            rows = self._strided(places, np.dtype(DTYPE_OF_COMPONENT[places["componentType"]]), 1, replaced)[:, 0]
            numbers[rows] = self._strided(sparse["values"], dtype, width, replaced)
        return np.maximum(numbers / np.iinfo(dtype).max, -1) if accessor.get("normalized") and dtype.kind in "iu" else numbers

    def is_empty(self, primitive: dict[str, Any]) -> bool:
        """Whether a primitive names no positions, or arrays without rows, which the standard forbids and exporters write."""
        numbers = [primitive["attributes"].get("POSITION"), primitive.get("indices", primitive["attributes"].get("POSITION"))]
        return any(number is None or item(self.document["accessors"], number, "accessors")["count"] == 0 for number in numbers)

    def triangles(self, primitive: dict[str, Any], vertex_count: int) -> np.ndarray:
        """The vertex numbers (m, 3) int64 of a primitive of one of MODES; vertices in their order where it has no indices."""
        indices = self.array(primitive["indices"]).astype(np.int64).reshape(-1) if "indices" in primitive else np.arange(vertex_count)
        mode = primitive.get("mode", TRIANGLES)
        if mode == TRIANGLE_STRIP:
            return strip_triangles(indices)
        if mode == TRIANGLE_FAN:
            return np.column_stack([np.full(max(len(indices) - 2, 0), indices[0]), indices[1:-1], indices[2:]])
        if len(indices) % 3:
            raise ValueError(f"has {len(indices)} indices, which is no number of triangles")
        return indices.reshape(-1, 3)

    def image(self, number: int) -> bytes:
        """An image's file. Raises FileNotFoundError when it is not there."""
        image = item(self.document["images"], number, "images")
        if "uri" in image:
            return self._resource(image["uri"])
        view = item(self.document["bufferViews"], image["bufferView"], "buffer views")
        first = int(view.get("byteOffset", 0))
        return self._buffer(int(view["buffer"]))[first : first + int(view["byteLength"])]

    def _strided(self, where: dict[str, Any], dtype: np.dtype, width: int, count: int) -> np.ndarray:
        """`count` rows of `width` numbers in the buffer view that `where` names, from its offset there on."""
        view = item(self.document["bufferViews"], where["bufferView"], "buffer views")
        data = self._buffer(int(view["buffer"]))
        first = int(view.get("byteOffset", 0)) + int(where.get("byteOffset", 0))
        stride = int(view.get("byteStride", width * dtype.itemsize))
        end = int(where.get("byteOffset", 0)) + (count - 1) * stride + width * dtype.itemsize
        if first < 0 or stride < width * dtype.itemsize or int(view.get("byteOffset", 0)) + end > len(data):
            raise ValueError("has numbers that lie outside their buffer")
        if end > int(view["byteLength"]):  # what lies behind are other numbers
            raise ValueError("has numbers that lie outside their buffer view")
        return np.ndarray((count, width), dtype, data, first, (stride, dtype.itemsize))

    def _buffer(self, number: int) -> bytes:
        uri = item(self.document["buffers"], number, "buffers").get("uri")
        if uri is None:
            return self._binary
        if uri not in self._read:
            self._read[uri] = self._resource(uri)
        return self._read[uri]

    def _resource(self, uri: str) -> bytes:
        if not uri.startswith("data:"):
            path = contained_path(self._folder, unquote(uri), self._where)
            if not os.path.exists(path):
                raise FileNotFoundError(ENOENT, "there is no such file", str(path))
            if path in self._counted:
                return read_file(path, MAX_BYTES)
            content = read_file(path, MAX_BYTES - self.stored_bytes)
            self._counted.add(path)
            self.stored_bytes += len(content)
            return content
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except binascii.Error as error:
            raise ValueError("has data that is not base64") from error


def item(rows: list[Any], number: int, what: str) -> Any:
    """A row by its number. Raises IndexError outside; a negative number does not count from the end."""
    if not 0 <= number < len(rows):
        raise IndexError(f"refers to number {number} of its {len(rows)} {what}")
    return rows[number]


def _document(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON of a file and, of a .glb, the binary chunk (section 4)."""
    if content[:4] != b"glTF":
        return _json(content.removeprefix(codecs.BOM_UTF8)), b""
    length, _ = struct.unpack_from("<II", content, 12)
    document = _json(content[20 : 20 + length])
    binary = content[28 + length :]
    return document, binary[: struct.unpack_from("<I", content, 20 + length)[0]] if binary else b""


def _json(text: bytes) -> dict[str, Any]:
    if sum(text.count(mark) for mark in (b",", b"[", b"{")) > MAX_JSON_VALUES:
        raise ValueError(f"has more than {MAX_JSON_VALUES} values in its JSON; join its nodes")
    return decoded_json(text, Any)
