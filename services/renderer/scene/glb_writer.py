"""A glTF 2.0 file (.glb) put together piece by piece."""

import json
import struct
from typing import Any

import numpy as np

COMPONENTS = {np.dtype("<f4"): 5126, np.dtype("<u4"): 5125}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GlbWriter:
    """The document, whose lists may be added to, and the bytes behind it."""

    def __init__(self) -> None:
        self.document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self._pieces: list[bytes] = []
        self._length = 0

    def add(self, kind: str, row: dict[str, Any]) -> int:
        """Adds a row to a list of the document; its number."""
        rows = self.document.setdefault(kind, [])
        rows.append(row)
        return len(rows) - 1

    def view(self, content: bytes) -> int:
        """Adds bytes; the number of their buffer view."""
        number = self.add("bufferViews", {"buffer": 0, "byteOffset": self._length, "byteLength": len(content)})
        content += bytes(-len(content) % 4)
        self._pieces.append(content)
        self._length += len(content)
        return number

    def accessor(self, values: np.ndarray) -> int:
        """Adds numbers (count,) or (count, 1 to 4): floats as float32, whole numbers as uint32; the number of their accessor."""
        rows = np.ascontiguousarray(values, "<f4" if values.dtype.kind == "f" else "<u4").reshape(len(values), -1)
        view, kind = self.view(rows.tobytes()), TYPES[rows.shape[1]]
        return self.add("accessors", {"bufferView": view, "componentType": COMPONENTS[rows.dtype], "count": len(rows), "type": kind})

    def image(self, content: bytes) -> int:
        """Adds an image file; the number of its texture, to which a sampler may be added."""
        kind = "image/jpeg" if content[:2] == b"\xff\xd8" else "image/png"
        return self.add("images", {"bufferView": self.view(content), "mimeType": kind})

    def content(self) -> bytes:
        """The file."""
        self.document["buffers"] = [{"byteLength": self._length}]
        text = json.dumps(self.document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + self._length
        head = struct.pack("<4sII", b"glTF", 2, length) + struct.pack("<I4s", len(text), b"JSON")
        return b"".join([head, text, struct.pack("<I4s", self._length, b"BIN\0"), *self._pieces])
