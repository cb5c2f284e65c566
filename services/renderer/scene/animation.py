"""Rigid animation of glTF files: nodes whose translation, rotation and scale follow keyframes (glTF 2.0, sections 3.11 and appendix C).

One of a file's animations plays, or all of them together, and starts again after the last keyframe. Skins and morph targets, which are no
rigid motion, are not read.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from vemlight.renderer.scene.gltf import GltfFile, item
from vemlight.renderer.scene.gltf_nodes import NodeTransform, NodeTree, node_transform, rest_matrix

MAX_KEYFRAMES = 2**22  # of all tracks: 500 nodes of three tracks for 90 seconds at 30 a second; 170 MB
MAX_MOVING_NODES = 768  # above all meshes that move: each takes 5 ms to find out how far it goes, and 30 microseconds a frame
MAX_MOTION_KEYFRAMES = 2**24  # above all meshes that move, each sorted for each mesh: 1.5 s
MIN_QUATERNION = 1e-6  # length of a keyframe's rotation; those of 8 bits are within 1 % of 1. Any value in 1e-9 .. 0.5 does
MIN_DETERMINANT = 1e-18  # of a node's rest transform, which is inverted: a millionth along each axis. Any value in 1e-30 .. 1e-12 does
ALL_ANIMATIONS = "*"  # in place of an animation's name

Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]
Target = Literal["translation", "rotation", "scale"]


class KeyframeTrack(NamedTuple):
    """The values that a node's translation, rotation or scale takes over time.

    times: (k,) s, ascending. values: (k, 3, n): in-tangent, value and out-tangent of each key; without CUBICSPLINE all three are the value.
    """

    times: np.ndarray
    values: np.ndarray
    interpolation: Interpolation


class AnimatedNode(NamedTuple):
    """A node between the file's root and a mesh. rest_matrix: (4, 4), where the file places it; rest: the same in parts."""

    rest_matrix: np.ndarray
    rest: NodeTransform
    tracks: Mapping[Target, KeyframeTrack]


class RigidMotion(NamedTuple):
    """How a mesh moves. nodes: from the root to the mesh's. duration_s: of the animation, above 0. world_from_file: (4, 4)."""

    nodes: tuple[AnimatedNode, ...]
    duration_s: float
    world_from_file: np.ndarray

    def world_from_rest(self, time_s: float) -> np.ndarray:
        """The transform (4, 4) from where the file places the mesh without its animation to where it is at a time."""
        return self.matrices([time_s])[0]

    def matrices(self, times_s: Iterable[float]) -> np.ndarray:
        """`world_from_rest` at each of n times, (n, 4, 4)."""
        node_from_world = np.linalg.inv(self.world_from_file @ self.file_from_node())
        found = []
        for time_s in times_s:
            matrix = self.world_from_file
            for node in self.nodes:
                matrix = matrix @ node_matrix(node, time_s % self.duration_s)
            found.append(matrix @ node_from_world)
        return np.stack(found)

    def file_from_node(self) -> np.ndarray:
        """The transform (4, 4) by which the file places the mesh's node without its animation."""
        matrix = np.eye(4)
        for node in self.nodes:
            matrix = matrix @ node.rest_matrix
        return matrix

    @property
    def begins_flat(self) -> bool:
        """Whether the file places the node without extent along some axis, such as by a scale of 0, from where no motion can be told."""
        return not abs(np.linalg.det(self.file_from_node())) > MIN_DETERMINANT

    def sample_times_s(self, count: int) -> np.ndarray:
        """Times that show where the mesh goes: at most `count` of its keyframes, evenly chosen with the first and the last, and
        `count` evenly spaced ones; all before the animation's end."""
        keys = np.unique(np.concatenate([track.times for node in self.nodes for track in node.tracks.values()]))
        chosen = keys[np.unique(np.linspace(0, len(keys) - 1, count).round().astype(int))]
        return np.minimum(np.concatenate([chosen, np.linspace(0, self.duration_s, count)]), np.nextafter(self.duration_s, 0))


def node_matrix(node: AnimatedNode, time_s: float) -> np.ndarray:
    """A node's transform (4, 4) at a time; as the file places it where no track changes it."""
    if not node.tracks:
        return node.rest_matrix
    moved = {target: track_value(track, time_s, target == "rotation") for target, track in node.tracks.items()}
    return node.rest._replace(**moved).matrix()


def track_value(track: KeyframeTrack, time_s: float, is_rotation: bool) -> np.ndarray:
    """A track's value (n,) at a time (appendix C): that of the first or last key before and after them.

    is_rotation: the values are quaternions, interpolated along the shorter arc.
    """
    after = int(np.searchsorted(track.times, time_s, side="right"))
    if after == 0 or after == len(track.times) or track.interpolation == "STEP":
        return track.values[max(after - 1, 0), 1]
    start_s, end_s = track.times[after - 1 : after + 1]
    a, b = track.values[after - 1 : after + 1, 1]
    t = (time_s - start_s) / (end_s - start_s)
    if track.interpolation == "LINEAR":
        return _slerp(a, b, t) if is_rotation else (1 - t) * a + t * b
    value = _hermite(track, after, t)
    return value if not is_rotation or np.linalg.norm(value) > 1e-9 else a  # a spline through the origin has no direction there


def _slerp(a: np.ndarray, b: np.ndarray, t: float) -> np.ndarray:
    """Spherical interpolation between unit quaternions along the shorter arc (Shoemake 1985).

    scipy's Slerp gives the same rotation and takes 15 times as long for one at a time, as each animated node of a frame needs it.
    """
    cosine = float(a @ b)
    b, cosine = (b, cosine) if cosine >= 0 else (-b, -cosine)
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:  # the chord is the arc, to 1e-13 of it; any value in 1e-7 .. 1e-4 does
        return (1 - t) * a + t * b
    return (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)


def _hermite(track: KeyframeTrack, after: int, t: float) -> np.ndarray:
    """The cubic spline between keys after - 1 and after, at the fraction t of the way (appendix C.5)."""
    step_s = track.times[after] - track.times[after - 1]
    (_, a, out_tangent), (in_tangent, b, _) = track.values[after - 1 : after + 1]
    return (
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * step_s * out_tangent
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * step_s * in_tangent
    )


def read_motions(file: GltfFile, tree: NodeTree, name: str = "") -> list[RigidMotion | None]:
    """How the animation named `name` moves each of the tree's mesh nodes; None for those that it leaves where they are.

    name: "" is the file's first animation, ALL_ANIMATIONS all of them, as long as the longest; where two move the same, the first does.
    Raises as gltf.py says for a file that is not as the standard has it, and ValueError with the names for one that it does not have.
    """
    tracks: dict[int, dict[Target, KeyframeTrack]] = {}
    keyframes = 0
    for animation in _chosen(file, name):
        for channel in animation["channels"]:
            number, target = channel["target"].get("node"), channel["target"]["path"]
            if number is not None and target in ("translation", "rotation", "scale") and target not in tracks.get(number, {}):
                sampler = item(animation["samplers"], channel["sampler"], "samplers")
                track = tracks.setdefault(number, {})[target] = _read_track(file, sampler, target)
                keyframes += len(track.times)
                if keyframes > MAX_KEYFRAMES:
                    raise ValueError(f"has animations of more than {MAX_KEYFRAMES} keyframes; leave some out")
    duration_s = max((float(track.times[-1]) for moved in tracks.values() for track in moved.values()), default=0.0)
    if duration_s <= 0:
        return [None] * len(tree.mesh_nodes)
    # A node with a matrix is never animated (section 3.5.3).
    nodes = [
        AnimatedNode(rest_matrix(node), node_transform(node), {} if "matrix" in node else tracks.get(number, {}))
        for number, node in enumerate(file.document["nodes"])
    ]
    motions: list[RigidMotion | None] = []
    for path in (tree.path(node.number) for node in tree.mesh_nodes):
        moves = not tracks.keys().isdisjoint(path)
        motions.append(RigidMotion(tuple(nodes[number] for number in path), duration_s, np.eye(4)) if moves else None)
    _check_work([motion for motion in motions if motion is not None])
    return motions


def _check_work(motions: list[RigidMotion]) -> None:
    """Raises ValueError for motions that take too long to follow: their nodes and keyframes are those of each mesh anew."""
    nodes = sum(len(motion.nodes) for motion in motions)
    keyframes = sum(len(track.times) for motion in motions for node in motion.nodes for track in node.tracks.values())
    if nodes > MAX_MOVING_NODES or keyframes > MAX_MOTION_KEYFRAMES:
        raise ValueError(f"moves meshes by {nodes} nodes and {keyframes} keyframes, too many to follow; join the meshes")


def animation_names(file: GltfFile) -> list[str]:
    """The names of a file's animations; for one without a name its number, from 1."""
    return [str(animation.get("name", number)) for number, animation in enumerate(file.document.get("animations", []), 1)]


def _chosen(file: GltfFile, name: str) -> list[dict[str, Any]]:
    animations, names = file.document.get("animations", []), animation_names(file)
    if name == ALL_ANIMATIONS:
        return animations
    if name and name not in names:
        raise ValueError(f"has no animation {name}, but {', '.join(names)[:200] or 'none'}")
    first = names.index(name) if name else 0
    return animations[first : first + 1]


def _read_track(file: GltfFile, sampler: dict[str, Any], target: Target) -> KeyframeTrack:
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise ValueError(f"has an animation with interpolation {str(interpolation)[:20]}")
    times = file.array(sampler["input"]).reshape(-1)
    width = 4 if target == "rotation" else 3
    values = file.array(sampler["output"]).reshape(-1, 3 if interpolation == "CUBICSPLINE" else 1, width)
    if not 0 < len(times) == len(values) or np.any(np.diff(times) <= 0) or times[0] < 0:
        raise ValueError("has an animation whose keyframes are not in order or not as many as its values")
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise ValueError("has an animation with nan or inf")
    if target == "rotation" and np.any(np.linalg.norm(values[:, values.shape[1] // 2], axis=-1) < MIN_QUATERNION):
        raise ValueError("has an animation with a rotation of length 0")
    return KeyframeTrack(times, np.broadcast_to(values, (len(times), 3, width)), interpolation)
