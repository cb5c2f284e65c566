"""Small glTF files that grow: a textured square and an animated triangle."""

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any, Self

import numpy as np
from PIL import Image

CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
UPRIGHT = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # v downwards: the image's first row on top
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
COMPONENT_TYPES = {"f": 5126, "h": 5122, "H": 5123, "B": 5121, "I": 5125}
ELEMENT_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GltfFile:
    """A glTF 2.0 document with one binary buffer. `document` may be changed at will before it is written."""

    def __init__(self, **document: Any) -> None:
        self.data = b""
        head = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "accessors": [], "bufferViews": []}
        self.document: dict[str, Any] = {**head, **document}

    def accessor(self, values: np.ndarray, **more: Any) -> int:
        """The index of a new accessor of values (n,) or (n, components); `more` are further keys of it."""
        values = np.ascontiguousarray(values)
        self.document["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        count, components = values.reshape(-1, values.shape[-1] if values.ndim > 1 else 1).shape
        accessor = {"bufferView": len(self.document["bufferViews"]) - 1, "componentType": COMPONENT_TYPES[values.dtype.char]}
        self.document["accessors"].append({**accessor, "count": count, "type": ELEMENT_TYPES[components], **more})
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.document["accessors"]) - 1

    def write(self, path: Path) -> Path:
        """Writes .glb with the buffer as a chunk, anything else as JSON with the buffer as a data URI."""
        if path.suffix == ".glb":
            self.document["buffers"] = [{"byteLength": len(self.data)}]
            text = json.dumps(self.document).encode()
            text += b" " * (-len(text) % 4)
            chunks = [struct.pack("<I4s", len(text), b"JSON") + text, struct.pack("<I4s", len(self.data), b"BIN\0") + self.data]
            path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks))
            return path
        encoded = base64.b64encode(self.data).decode()
        self.document["buffers"] = [{"byteLength": len(self.data), "uri": f"data:application/octet-stream;base64,{encoded}"}]
        path.write_text(json.dumps(self.document))
        return path


class TexturedSquare(GltfFile):
    """A square of side 2 in the file's x, y."""

    def __init__(self, uv: np.ndarray | None = UPRIGHT, **material: Any) -> None:
        super().__init__(nodes=[{"mesh": 0}], materials=[{"name": "Paint", **material}], images=[], textures=[], samplers=[])
        attributes = {"POSITION": self.accessor(CORNERS)}
        indices = self.accessor(np.array([0, 1, 2, 0, 2, 3], np.uint32)[:, None])
        self.primitive: dict[str, Any] = {"attributes": attributes, "indices": indices, "material": 0}
        self.document["meshes"] = [{"name": "Square", "primitives": [self.primitive]}]
        if uv is not None:
            self.attribute("TEXCOORD_0", uv)

    @property
    def material(self) -> dict[str, Any]:
        return self.document["materials"][0]

    def attribute(self, name: str, values: np.ndarray, **more: Any) -> Self:
        self.primitive["attributes"][name] = self.accessor(values, **more)
        return self

    def image(self, pixels: np.ndarray, info: dict[str, Any] | None = None, **sampler: int) -> dict[str, Any]:
        """The textureInfo of a new texture of pixels (rows, cols, 3 or 4) uint8; `info` are further keys of it."""
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG")
        self.document["images"].append({"uri": "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()})
        self.document["samplers"].append({"magFilter": 9728, "minFilter": 9728, **sampler})
        last = len(self.document["images"]) - 1
        self.document["textures"].append({"source": last, "sampler": last})
        return {"index": last, **(info or {})}


class AnimatedTriangle(GltfFile):
    """A parent node and a child node "leaf" that carries a triangle; `child` are further keys of the child node."""

    def __init__(self, **child: Any) -> None:
        nodes = [{"children": [1]}, {"name": "leaf", "mesh": 0, **child}]
        super().__init__(nodes=nodes, animations=[{"channels": [], "samplers": []}])
        self.document["meshes"] = [{"primitives": [{"attributes": {"POSITION": self.accessor(TRIANGLE)}}]}]
        self.document["accessors"][0] |= {"min": TRIANGLE.min(axis=0).tolist(), "max": TRIANGLE.max(axis=0).tolist()}

    def move(self, node: int, path: str, times, values, interpolation: str = "LINEAR", **more: Any) -> Self:
        """Adds a channel to the first animation: `path` (translation, rotation, scale) of a node at key times in seconds."""
        values = values if isinstance(values, np.ndarray) else np.array(values, np.float32)
        animation = self.document["animations"][0]
        key_times, key_values = self.accessor(np.array(times, np.float32)), self.accessor(values, **more)
        animation["samplers"].append({"input": key_times, "output": key_values, "interpolation": interpolation})
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": path}})
        return self
