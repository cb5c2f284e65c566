"""The file of a rig of cameras: where each stands, how it is turned, and what it reads.

One TOML file of frozen records, in which an unknown key is an error. Places are metres in the world of the lights. Paths in the file are
relative to it; after `read_camera_rig` they are absolute.
"""

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.runtime.instances import MAX_CAMERAS, with_absolute_paths

MIN_BASELINE_M = 0.01  # nearer to each other two lenses would touch, and see no parallax
UNIT = 1e-3  # by which the squared length of `turn` may be off: three decimals of each number are enough

Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]
Place = tuple[Metres, Metres, Metres]
Part = Annotated[float, Meta(ge=-1.001, le=1.001)]
Gain = Annotated[float, Meta(gt=0, le=1e6)]


class RigRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A table of the rig file."""


class RigCamera(RigRecord, frozen=True, kw_only=True):
    """A camera. source: folder, file, film, stream or device, as `[capture] source`. at: of its entrance pupil. turn: world_from_camera,
    unit quaternion x y z w; the map's +z is the lens's axis. gain: RGB factors that bring its radiance to the rig's unit; left out: found
    from what the cameras see in common.
    """

    name: Annotated[str, Meta(pattern=r"^[a-z0-9-]{1,32}$")]
    source: Annotated[str, Meta(min_length=1, max_length=4096)]
    lens: str = ""
    response: str = ""
    at: Place
    turn: tuple[Part, Part, Part, Part] = (0.0, 0.0, 0.0, 1.0)
    gain: tuple[Gain, Gain, Gain] | None = None

    def __post_init__(self) -> None:
        if abs(sum(part * part for part in self.turn) - 1) > UNIT:
            shown = ", ".join(f"{part:g}" for part in self.turn)
            raise ValueError(f"camera {self.name}: turn = [{shown}] is no unit quaternion x y z w; write [0, 0, 0, 1] to look up")

    @property
    def world_from_camera(self) -> np.ndarray:
        """Rotation (3, 3) float64 from the camera's map to the world; read-only."""
        return _rotation(self.turn)


@lru_cache(maxsize=64)  # it is asked for twenty times a frame
def _rotation(turn: tuple[float, float, float, float]) -> np.ndarray:
    """The rotation of a quaternion x y z w of any length; read-only. SciPy's takes a third of a second to load."""
    x, y, z, w = np.asarray(turn) / np.linalg.norm(turn)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    rotation.flags.writeable = False
    return rotation


class CameraRig(RigRecord, frozen=True, kw_only=True):
    """Cameras that see one place's light together. pose_deg, pose_m: standard deviation of each camera's turn, about each axis, and of its
    place, along each axis, by which its pose may be wrong.
    """

    pose_deg: Annotated[float, Meta(ge=0, le=10)] = 0.05  # a wand over 30 places reaches 0.04
    pose_m: Annotated[float, Meta(ge=0, le=1)] = 0.002
    camera: tuple[RigCamera, ...]

    def __post_init__(self) -> None:
        if not 2 <= len(self.camera) <= MAX_CAMERAS:
            raise ValueError(f"the rig has {len(self.camera)} cameras, and 2 to {MAX_CAMERAS} are fused; write a [[camera]] for each")
        name, times = Counter(camera.name for camera in self.camera).most_common(1)[0]
        if times > 1:
            raise ValueError(f"two cameras are called {name}; give each its own name")
        for a, b in combinations(self.camera, 2):
            apart_m = float(np.linalg.norm(np.subtract(a.at, b.at)))
            if apart_m < MIN_BASELINE_M:
                places = f"cameras {a.name} and {b.name} stand {100 * apart_m:.2g} cm from each other"
                raise ValueError(f"{places}, and light has no parallax below {100 * MIN_BASELINE_M:g} cm; correct `at` of one of them")

    @property
    def places(self) -> np.ndarray:
        """Where the cameras stand, (cameras, 3) float64, m."""
        return np.array([camera.at for camera in self.camera], np.float64)

    @property
    def centre(self) -> np.ndarray:
        """The mean of the cameras' places, (3,) float64, m: the fused map and its directions are true there."""
        return self.places.mean(axis=0)


def read_camera_rig(path: Path) -> CameraRig:
    """The rig in a TOML file, its paths absolute. Whether sources, lenses and responses are there is not asked.

    Raises UserError that names file, line and key for what is no rig: fewer than 2 cameras, two of one name, two closer to each other than
    MIN_BASELINE_M, a `turn` that is no unit quaternion, an unknown key.
    """
    rig = read_toml(path, CameraRig)
    return msgspec.structs.replace(rig, camera=tuple(with_absolute_paths(camera, path) for camera in rig.camera))


def check_one_rate(path: Path, rig: CameraRig, fps: Sequence[float]) -> None:
    """Raises UserError where the cameras' frames a second, in the order of the rig, differ: frame k of all belongs together."""
    for camera, rate in zip(rig.camera, fps, strict=True):
        if abs(rate - fps[0]) > 1e-3 * fps[0]:  # 29.97 and 30 differ by a frame in half a minute
            first = f"{rig.camera[0].name} has {fps[0]:g}"
            raise UserError(f"{path}: camera {camera.name}: has {rate:g} frames a second and {first}; record all at one rate")
