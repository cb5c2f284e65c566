"""A small lamp that is carried past cameras: where each camera sees it, frame by frame, and the places at which it was held still."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NEAR_RAD = math.radians(1.5)  # two sources of one direction: a lamp's glow and a cell's size; 1 to 3 would do
STANDING = 0.2  # of the frames with a source in a direction: what is there belongs to the room. Held for one of 30 places: 0.03
STILL_RAD = math.radians(0.25)  # within which a lamp held by hand stays for a while; 0.1 to 0.5 would do
STILL_FRAMES = 3  # of a place where it was held
MIN_STILL = 20  # such places: fewer, and it was carried all the time, so that each frame is a place
APART_RAD = math.radians(2.0)  # between places that are kept, in one camera at least: nearer ones say nothing new
MAX_PLACES = 120  # 100 reach 0.025 degrees


class FrameSources(NamedTuple):
    """The compact sources of a frame: directions (n, 3) in the camera's axes, strength (n,) in luminance."""

    directions: np.ndarray
    strength: np.ndarray


def lamp_bearings(frames: Sequence[FrameSources]) -> np.ndarray:
    """Where a camera sees the lamp: the strongest source that does not stand still, (frames, 3) float64, nan where there is none."""
    from scipy.spatial import KDTree

    counts = [len(frame.strength) for frame in frames]
    found = np.full((len(frames), 3), np.nan)
    if not sum(counts):
        return found
    directions, number = np.concatenate([frame.directions for frame in frames]), np.repeat(np.arange(len(frames)), counts)
    tree = KDTree(directions)
    standing = np.array([len(set(number[near].tolist())) > max(1, STANDING * len(frames))
                         for near in tree.query_ball_point(directions, 2 * math.sin(NEAR_RAD / 2))])  # fmt: skip
    first = np.cumsum([0, *counts])
    for k, frame in enumerate(frames):
        strength = np.where(standing[first[k] : first[k + 1]], 0, frame.strength)
        if strength.size and strength.max() > 0:
            found[k] = frame.directions[strength.argmax()]
    return found


def places(bearings: np.ndarray) -> np.ndarray:
    """Bearings (cameras, places, 3) of one place each, of those of all frames (cameras, frames, 3), nan where a camera sees none.

    Where the lamp was held still in all cameras that see it for STILL_FRAMES or longer, their mean; with fewer than MIN_STILL such places
    single frames, which needs cameras that expose together. At most MAX_PLACES, as far from each other as they are.
    """
    held = _held(bearings)
    found = held if held.shape[1] >= MIN_STILL else bearings
    found = found[:, np.isfinite(found[..., 0]).sum(axis=0) >= 2]
    return _spread(found)


def _held(bearings: np.ndarray) -> np.ndarray:
    """The means of runs of frames in which the lamp stays where it was in the first of them."""
    seen, count = np.isfinite(bearings[..., 0]), bearings.shape[1]
    means, first = [], 0
    while first < count:
        end = first + 1
        while end < count and (seen[:, end] == seen[:, first]).all() and _angle(bearings[:, first], bearings[:, end]) < STILL_RAD:
            end += 1
        if end - first >= STILL_FRAMES and seen[:, first].any():
            mean = bearings[:, first:end].mean(axis=1)
            means.append(mean / np.linalg.norm(mean, axis=1, keepdims=True))
        first = end
    return np.stack(means, axis=1) if means else np.zeros((len(bearings), 0, 3))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """The largest between two bearings of a camera, rad."""
    return float(np.nanmax(np.linalg.norm(a - b, axis=-1), initial=0.0))


def _spread(bearings: np.ndarray) -> np.ndarray:
    """Places that are APART_RAD from each other in a camera that sees both, the farthest first."""
    count = bearings.shape[1]
    if not count:
        return bearings
    kept, far = [0], np.full(count, np.inf)
    while len(kept) < MAX_PLACES:
        apart = np.linalg.norm(bearings - bearings[:, kept[-1]][:, None], axis=-1)
        far = np.minimum(far, np.where(np.isfinite(apart).any(axis=0), np.nan_to_num(apart).max(axis=0), np.pi))
        if far.max() < APART_RAD:
            break
        kept.append(int(far.argmax()))
    return bearings[:, sorted(kept)]
