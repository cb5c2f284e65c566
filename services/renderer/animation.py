"""Rigid animation of glTF files: nodes whose translation, rotation and scale follow keyframes (glTF 2.0, sections 3.11 and appendix C).

The file's first animation plays, and begins again when its last keyframe is over. Skins and morph targets are no rigid motion and are
left out.
"""

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import unquote

import numpy as np
import trimesh

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # componentType, section 3.6.2.2
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
MOST_KEYS = 1_000_000  # of a track; nine hours at 30 a second


class Track(NamedTuple):
    """times: (k,) s, ascending. values: (k, 3, n): in-tangent, value and out-tangent of each key; "CUBICSPLINE" alone has tangents."""

    times: np.ndarray
    values: np.ndarray
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"]


class Node(NamedTuple):
    """A node on the way from the file's root to a mesh. rest: (4, 4) as the file places it; rested: its three parts."""

    rest: np.ndarray
    rested: dict[str, np.ndarray]
    tracks: dict[str, Track]


class Motion(NamedTuple):
    """nodes: from the root to the mesh. duration_s: of the animation, above 0. world_from_file: (4, 4)."""

    nodes: tuple[Node, ...]
    duration_s: float
    world_from_file: np.ndarray

    def world_from_rest(self, time_s: float) -> np.ndarray:
        """Where the mesh stands at a time, (4, 4), as a transform from where the file puts it without its animation."""
        now = self.world_from_file
        for node in self.nodes:
            now = now @ node_matrix(node, time_s % self.duration_s)
        return now @ np.linalg.inv(self.world_from_file @ self.file_from_node())

    def file_from_node(self) -> np.ndarray:
        """Where the file itself puts the mesh's node, (4, 4)."""
        matrix = np.eye(4)
        for node in self.nodes:
            matrix = matrix @ node.rest
        return matrix

    def times_s(self, most: int) -> np.ndarray:
        """Moments that show where it goes: the keys, at most `most` of them, and as many evenly spread ones; all before its end."""
        keys = np.unique(np.concatenate([track.times for node in self.nodes for track in node.tracks.values()]))
        chosen = keys[np.unique(np.linspace(0, len(keys) - 1, most).round().astype(int))]
        return np.minimum(np.concatenate([chosen, np.linspace(0, self.duration_s, most)]), np.nextafter(self.duration_s, 0))


def node_matrix(node: Node, time_s: float) -> np.ndarray:
    """A node's transform (4, 4): scaled, turned, moved; as the file says where no track changes it."""
    if not node.tracks:
        return node.rest
    return placed(node.rested | {path: value_at(track, time_s, path == "rotation") for path, track in node.tracks.items()})


def placed(parts: dict[str, np.ndarray]) -> np.ndarray:
    """The transform (4, 4) that scales, turns and moves."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(parts["rotation"]) * parts["scale"]
    matrix[:3, 3] = parts["translation"]
    return matrix


def rotation_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a quaternion (4,): x, y, z, w, of any length above 0."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def value_at(track: Track, time_s: float, turns: bool) -> np.ndarray:
    """A track's value (n,) at a time, that of the nearest end outside its keys; `turns`: it holds quaternions (appendix C)."""
    after = int(np.searchsorted(track.times, time_s, side="right"))
    if after == 0 or after == len(track.times) or track.interpolation == "STEP":
        return track.values[max(after - 1, 0), 1]
    step_s = track.times[after] - track.times[after - 1]
    t = (time_s - track.times[after - 1]) / step_s
    a, b = track.values[after - 1, 1], track.values[after, 1]
    if track.interpolation == "CUBICSPLINE":
        leaving, coming = step_s * track.values[after - 1, 2], step_s * track.values[after, 0]
        made = (2 * t**3 - 3 * t**2 + 1) * a + (t**3 - 2 * t**2 + t) * leaving + (3 * t**2 - 2 * t**3) * b + (t**3 - t**2) * coming
        return a if turns and not np.linalg.norm(made) > 1e-9 else made
    return _slerp(a, b, t) if turns else (1 - t) * a + t * b


def _slerp(a: np.ndarray, b: np.ndarray, t: float) -> np.ndarray:
    """Between unit quaternions along the shorter arc (Shoemake 1985)."""
    cosine = float(a @ b)
    b, cosine = (b, cosine) if cosine >= 0 else (-b, -cosine)
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:  # the chord is the arc
        return (1 - t) * a + t * b
    return (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)


def read_motions(path: Path) -> dict[str, Motion]:
    """The motion of each node that the first animation of a .gltf or .glb file moves, by the names that trimesh gives the nodes.

    Raises ValueError, KeyError, IndexError, TypeError, OSError or struct.error for a file that is not as the standard has it.
    """
    document, binary = _document(path)
    animations = document.get("animations", [])
    if not animations:
        return {}
    read = _Accessors(document, binary, path.parent)
    tracks: dict[int, dict[str, Track]] = {}
    for channel in animations[0]["channels"]:
        node, moved = channel["target"].get("node"), channel["target"]["path"]
        if node is not None and moved in ("translation", "rotation", "scale"):
            tracks.setdefault(node, {})[moved] = _track(read, animations[0]["samplers"][channel["sampler"]], moved)
    duration_s = max((track.times[-1] for moving in tracks.values() for track in moving.values()), default=0.0)
    if duration_s <= 0:
        return {}
    nodes = document["nodes"]
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
    names: dict[str, int] = {}
    counts: dict[Any, int] = {}
    for number, node in enumerate(nodes):
        names[trimesh.util.unique_name(node.get("name", str(number)), names, counts=counts)] = number
    made = [_node(node, tracks.get(number, {})) for number, node in enumerate(nodes)]
    motions = {}
    for name, number in names.items():
        chain = _chain(number, parents, len(nodes))
        if any(passed in tracks for passed in chain):
            motions[name] = Motion(tuple(made[passed] for passed in chain), float(duration_s), np.eye(4))
            if not abs(np.linalg.det(motions[name].file_from_node())) > 1e-18:  # scaled to a millionth, three times
                raise ValueError("has an animated node that is scaled to nothing where the file places it")
    return motions


def _chain(number: int, parents: dict[int, int], most: int) -> list[int]:
    """The nodes from the root to a node."""
    chain = [number]
    while chain[0] in parents:
        chain.insert(0, parents[chain[0]])
        if len(chain) > most:
            raise ValueError("has nodes that are their own parents")
    return chain


def _node(node: dict[str, Any], tracks: dict[str, Track]) -> Node:
    rested: dict[str, np.ndarray] = {
        "translation": np.array(node.get("translation", (0.0, 0.0, 0.0)), float).reshape(3),
        "rotation": np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), float).reshape(4),
        "scale": np.array(node.get("scale", (1.0, 1.0, 1.0)), float).reshape(3),
    }
    if "matrix" in node:
        return Node(np.array(node["matrix"], float).reshape(4, 4).T, rested, {})  # section 3.5.3: such a node is not animated
    return Node(placed(rested), rested, tracks)


def _track(read: "_Accessors", sampler: dict[str, Any], path: str) -> Track:
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise ValueError(f"has an animation with interpolation {str(interpolation)[:20]}")
    times = read.array(sampler["input"]).reshape(-1)
    width = 4 if path == "rotation" else 3
    values = read.array(sampler["output"]).reshape(-1, 3 if interpolation == "CUBICSPLINE" else 1, width)
    if not 0 < len(times) == len(values) or np.any(np.diff(times) <= 0) or times[0] < 0:
        raise ValueError("has an animation whose keyframes are not in order or not as many as its values")
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise ValueError("has an animation with nan or inf")
    if path == "rotation" and np.any(np.linalg.norm(values[:, values.shape[1] // 2], axis=-1) < 1e-6):
        raise ValueError("has an animation with a rotation of length 0")
    return Track(times, np.repeat(values, 3, axis=1) if values.shape[1] == 1 else values, interpolation)


def _document(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON of a file and, of a .glb, the binary chunk (section 4)."""
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return json.loads(data), b""
    length, _ = struct.unpack_from("<II", data, 12)
    document = json.loads(data[20 : 20 + length])
    return document, data[28 + length :][: struct.unpack_from("<I", data, 20 + length)[0]] if len(data) > 28 + length else b""


class _Accessors:
    """A file's arrays of numbers (section 3.6)."""

    def __init__(self, document: dict[str, Any], binary: bytes, folder: Path) -> None:
        self._document, self._binary, self._folder = document, binary, folder

    def array(self, number: int) -> np.ndarray:
        """An accessor's numbers, (count, width) float64; normalised integers become fractions."""
        accessor = self._document["accessors"][number]
        dtype, width, count = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]], int(accessor["count"])
        if "sparse" in accessor or "bufferView" not in accessor or not 0 < count <= MOST_KEYS:
            raise ValueError(f"has an animation with keyframes that are sparse, none, or more than {MOST_KEYS}")
        view = self._document["bufferViews"][accessor["bufferView"]]
        first = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
        stride = int(view.get("byteStride", width * dtype.itemsize))
        data = self._buffer(int(view["buffer"]))
        if first < 0 or stride < width * dtype.itemsize or first + (count - 1) * stride + width * dtype.itemsize > len(data):
            raise ValueError("has an animation whose keyframes lie outside its buffer")
        numbers = np.ndarray((count, width), dtype, data, first, (stride, dtype.itemsize)).astype(np.float64)
        return np.maximum(numbers / np.iinfo(dtype).max, -1) if accessor.get("normalized") and dtype.kind in "iu" else numbers

    def _buffer(self, number: int) -> bytes:
        uri = self._document["buffers"][number].get("uri")
        if uri is None:
            return self._binary
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error as error:
                raise ValueError("has a buffer that is not base64") from error
        return (self._folder / unquote(uri)).read_bytes()
