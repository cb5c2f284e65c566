"""How the light rotates about the virtual camera: at a constant rate, or from keyframe to keyframe."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from scipy.spatial.transform import Rotation, Slerp

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.light.sphere import rotation_xyz

Motion = Callable[[float], np.ndarray]  # world_from_map (3, 3) at a time in s


class Keyframe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rotation of the light at one moment."""

    time_s: Annotated[float, Meta(ge=0, le=1e9)]  # 30 years; only nan, inf and nonsense lie outside
    rotate_deg: tuple[float, float, float]  # about x, then y, then z


class KeyframeFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A file of keyframes."""

    key: Annotated[list[Keyframe], Meta(min_length=1)]


def swaying(steady: Motion, degrees: float, hz: float) -> Motion:
    """A motion as a camera sees it that sways by so many degrees about two axes, at a rate and at four fifths of it."""

    def swayed(time_s: float) -> np.ndarray:
        turn = 2 * np.pi * hz * time_s
        return rotation_xyz((degrees * np.sin(turn), degrees * np.cos(0.8 * turn), 0.0)) @ steady(time_s)

    return swayed if degrees else steady


def motion(degrees_per_s: float, keyframes: Path | None) -> Motion:
    """The rotation over time: about +Z at a constant rate, or along `keyframes`.

    Between two keys the rotation is uniform and takes the shorter way; before the first and after the last it rests.
    Raises UserError for a keyframe file that cannot be read or whose times do not rise.
    """
    if keyframes is None:
        return lambda time_s: rotation_xyz((0.0, 0.0, degrees_per_s * time_s))
    keys = read_toml(keyframes, KeyframeFile).key
    times = [key.time_s for key in keys]
    if any(after <= before for before, after in itertools.pairwise(times)):
        raise UserError(f"{keyframes}: time_s must rise from key to key; put them in order")
    rotations = Rotation.from_matrix([rotation_xyz(key.rotate_deg) for key in keys])
    if len(keys) == 1:
        return lambda time_s: rotations[0].as_matrix()
    between = Slerp(times, rotations)
    return lambda time_s: between(np.clip(time_s, times[0], times[-1])).as_matrix()
