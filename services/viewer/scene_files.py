"""The scene for browsers: what the renderer sent, checked, as a description and a block of bytes that browsers keep by its hash."""

import hashlib
from typing import NamedTuple

import msgspec
import numpy as np

from vemlight.runtime import flat_scene, wire

HASH_BYTES = 16  # of SHA-256: nobody finds two scenes of one name
KEPT_FOR_S = 30 * 24 * 3600  # by browsers; the name never stands for other bytes. Any value from a day on does
CHUNK = 256 * 1024  # bytes sent at once: what a stalled page costs. 64 kB to 1 MB would do


class SceneFiles(NamedTuple):
    """hash: of both; empty where there is no scene, and text says why. description: JSON of it, with hash. data: the block."""

    hash: str
    description: bytes
    data: bytes
    text: str


NO_SCENE = SceneFiles("", b"", b"", "the renderer has sent no scene yet")


def scene_files(header: wire.SceneMessage, description: np.ndarray, data: np.ndarray) -> SceneFiles:
    """What pages get of a message. Raises ValueError for a description that does not fit its data."""
    if not header.description_bytes:
        return SceneFiles("", b"", b"", header.text or "the renderer sends no scene")
    scene = flat_scene.decoded(description.tobytes(), header.data_bytes)
    flat_scene.check_indices(scene, data)
    block = data.tobytes()
    name = hashlib.sha256(description.tobytes() + block).hexdigest()[: 2 * HASH_BYTES]
    return SceneFiles(name, msgspec.json.encode({"hash": name, **msgspec.structs.asdict(scene)}), block, "")
