"""Small glTF files for tests, written by hand: a square with whatever its material needs."""

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
UPRIGHT = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # v downwards: the image's first row on top
CODES = {"f": 5126, "H": 5123, "B": 5121, "I": 5125}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Sheet:
    """A square of side 2 in the file's x, y that grows: `document` may be changed at will before it is written."""

    def __init__(self, uv: np.ndarray | None = UPRIGHT, **material: Any) -> None:
        self.data = b""
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "accessors": [], "bufferViews": [],
            "materials": [{"name": "Paint", **material}], "images": [], "textures": [], "samplers": [],
        }  # fmt: skip
        attributes = {"POSITION": self.accessor(CORNERS)}
        indices = self.accessor(np.array([0, 1, 2, 0, 2, 3], np.uint32)[:, None])
        self.primitive: dict[str, Any] = {"attributes": attributes, "indices": indices, "material": 0}
        self.document["meshes"] = [{"name": "Square", "primitives": [self.primitive]}]
        if uv is not None:
            self.attribute("TEXCOORD_0", uv)

    @property
    def material(self) -> dict[str, Any]:
        return self.document["materials"][0]

    def accessor(self, values: np.ndarray, **more: Any) -> int:
        values = np.ascontiguousarray(values)
        self.document["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        accessor = {"bufferView": len(self.document["bufferViews"]) - 1, "componentType": CODES[values.dtype.char], "count": len(values)}
        self.document["accessors"].append({**accessor, "type": WIDTHS[values.shape[1]], **more})
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.document["accessors"]) - 1

    def attribute(self, name: str, values: np.ndarray, **more: Any) -> "Sheet":
        self.primitive["attributes"][name] = self.accessor(values, **more)
        return self

    def image(self, pixels: np.ndarray, info: dict[str, Any] | None = None, **sampler: int) -> dict[str, Any]:
        """A texture of (h, w, 3 or 4) uint8, as materials speak of it, with `info` beside its index."""
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG")
        self.document["images"].append({"uri": "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()})
        self.document["samplers"].append({"magFilter": 9728, "minFilter": 9728, **sampler})
        last = len(self.document["images"]) - 1
        self.document["textures"].append({"source": last, "sampler": last})
        return {"index": last, **(info or {})}

    def write(self, path: Path) -> Path:
        coded = base64.b64encode(self.data).decode()
        self.document["buffers"] = [{"byteLength": len(self.data), "uri": f"data:application/octet-stream;base64,{coded}"}]
        path.write_text(json.dumps(self.document))
        return path
