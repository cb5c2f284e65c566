"""Rigid animation of glTF files: nodes whose translation, rotation and scale follow keyframes (glTF 2.0, sections 3.11 and appendix C).

One of a file's animations plays, or all of them together, and begins again when the last keyframe is over. Skins and morph targets are
no rigid motion and are left out.
"""

from typing import Any, Literal, NamedTuple

import numpy as np

from vemlight.renderer.scene.gltf import GltfFile

MAX_KEYFRAMES = 1_000_000  # of a track; nine hours at 30 a second
ALL_ANIMATIONS = "*"  # in place of an animation's name


class KeyframeTrack(NamedTuple):
    """times: (k,) s, ascending. values: (k, 3, n): in-tangent, value and out-tangent of each key; "CUBICSPLINE" alone has tangents."""

    times: np.ndarray
    values: np.ndarray
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"]


class AnimatedNode(NamedTuple):
    """A node on the way from the file's root to a mesh. rest: (4, 4) as the file places it; rested: its three parts."""

    rest: np.ndarray
    rested: dict[str, np.ndarray]
    tracks: dict[str, KeyframeTrack]


class RigidMotion(NamedTuple):
    """nodes: from the root to the mesh. duration_s: of the animation, above 0. world_from_file: (4, 4)."""

    nodes: tuple[AnimatedNode, ...]
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


def node_matrix(node: AnimatedNode, time_s: float) -> np.ndarray:
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


def value_at(track: KeyframeTrack, time_s: float, turns: bool) -> np.ndarray:
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


def read_motions(file: GltfFile, wanted: str = "") -> dict[str, RigidMotion]:
    """The motion of each node that the animation named `wanted` moves, by the names that trimesh gives the nodes.

    wanted: "" is the file's first, ALL_ANIMATIONS all together, as long as the longest; where two move the same, the first does.
    Raises as gltf.py says for a file that is not as the standard has it, and ValueError that lists the names for one that it does not have.
    """
    tracks: dict[int, dict[str, KeyframeTrack]] = {}
    for animation in _chosen(file, wanted):
        for channel in animation["channels"]:
            node, moved = channel["target"].get("node"), channel["target"]["path"]
            if node is not None and moved in ("translation", "rotation", "scale") and moved not in tracks.get(node, {}):
                tracks.setdefault(node, {})[moved] = _track(file, animation["samplers"][channel["sampler"]], moved)
    duration_s = max((track.times[-1] for moving in tracks.values() for track in moving.values()), default=0.0)
    if duration_s <= 0:
        return {}
    nodes = file.document["nodes"]
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
    made = [_node(node, tracks.get(number, {})) for number, node in enumerate(nodes)]
    motions = {}
    for name, number in file.nodes().items():
        chain = _chain(number, parents, len(nodes))
        if any(passed in tracks for passed in chain):
            motions[name] = RigidMotion(tuple(made[passed] for passed in chain), float(duration_s), np.eye(4))
            if not abs(np.linalg.det(motions[name].file_from_node())) > 1e-18:  # scaled to a millionth, three times
                raise ValueError("has an animated node that is scaled to nothing where the file places it")
    return motions


def animation_names(file: GltfFile) -> list[str]:
    """What a file's animations are called; one without a name by its number, from 1."""
    return [str(animation.get("name", number)) for number, animation in enumerate(file.document.get("animations", []), 1)]


def _chosen(file: GltfFile, wanted: str) -> list[dict[str, Any]]:
    animations, names = file.document.get("animations", []), animation_names(file)
    if wanted == ALL_ANIMATIONS:
        return animations
    if wanted and wanted not in names:
        raise ValueError(f"has no animation {wanted}, but {', '.join(names)[:200] or 'none'}")
    first = names.index(wanted) if wanted else 0
    return animations[first : first + 1]


def _chain(number: int, parents: dict[int, int], most: int) -> list[int]:
    """The nodes from the root to a node."""
    chain = [number]
    while chain[0] in parents:
        chain.insert(0, parents[chain[0]])
        if len(chain) > most:
            raise ValueError("has nodes that are their own parents")
    return chain


def _node(node: dict[str, Any], tracks: dict[str, KeyframeTrack]) -> AnimatedNode:
    rested: dict[str, np.ndarray] = {
        "translation": np.array(node.get("translation", (0.0, 0.0, 0.0)), float).reshape(3),
        "rotation": np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), float).reshape(4),
        "scale": np.array(node.get("scale", (1.0, 1.0, 1.0)), float).reshape(3),
    }
    if "matrix" in node:
        return AnimatedNode(np.array(node["matrix"], float).reshape(4, 4).T, rested, {})  # section 3.5.3: such a node is not animated
    return AnimatedNode(placed(rested), rested, tracks)


def _track(file: GltfFile, sampler: dict[str, Any], path: str) -> KeyframeTrack:
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise ValueError(f"has an animation with interpolation {str(interpolation)[:20]}")
    times = file.array(sampler["input"]).reshape(-1)
    width = 4 if path == "rotation" else 3
    values = file.array(sampler["output"]).reshape(-1, 3 if interpolation == "CUBICSPLINE" else 1, width)
    if not 0 < len(times) == len(values) <= MAX_KEYFRAMES or np.any(np.diff(times) <= 0) or times[0] < 0:
        raise ValueError("has an animation whose keyframes are not in order or not as many as its values")
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise ValueError("has an animation with nan or inf")
    if path == "rotation" and np.any(np.linalg.norm(values[:, values.shape[1] // 2], axis=-1) < 1e-6):
        raise ValueError("has an animation with a rotation of length 0")
    return KeyframeTrack(times, np.repeat(values, 3, axis=1) if values.shape[1] == 1 else values, interpolation)
