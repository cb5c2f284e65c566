"""Gains that bring a rig's cameras to one radiance unit, from what they see in common.

Roughly, from the walls: two cameras' ratio in a channel is the median over blocks of the world that both see whole. Walls are nearer to
one camera than to another, so it is believed only beyond ROUGH_LN, or ROUGH_COLOUR between channels, and beyond what the blocks' own
scatter makes of it: a gain is the same in all, walls are not. Then from lights that several cameras
see: flux times squared distance is the same for all. A gain that the rig file states stands; one that is not surely another than 1 stays 1.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vemlight.fuse.matching import Matches
from vemlight.fuse.rest import Layout, block_radiance
from vemlight.fuse.rig_file import CameraRig
from vemlight.fuse.triangulation import FLUX_SIGMA
from vemlight.light.environment_map import EnvironmentMap

BLOCKS = Layout(12, 24, "sphere")  # of 15 degrees: as wide as a wall's parallax, small enough that two fisheyes' common rim has a dozen
MIN_BLOCKS = 6  # that two cameras must have in common
ROUGH_LN = 0.7  # of a ratio: cameras a metre apart in small rooms see walls differ by 0.5
ROUGH_COLOUR = 0.15  # of a channel's over another's: walls of other colours make 0.05
WALLS = 5  # that look different, over the hemisphere: blocks of one wall are alike, and their number counts for nothing
ROUGH_SIGMA, FINE_SIGMA = 0.4, 0.05  # of ln of a gain by walls and by lights
SURE_SIGMAS = 4.0  # from 1 and more, a gain by lights is believed
MIN_LIGHTS = 2  # one alone may shine more to one side
MEMORY = 16  # frames whose mean is taken


class Gains(NamedTuple):
    """ln: (cameras, 3) of the factors. sigma: (cameras,) of ln, 0 where it was not found but given or taken to be 1. frames: (cameras,)
    int64, in which lights had a say, -1 before the camera's first map and while it is silent.
    """

    ln: np.ndarray
    sigma: np.ndarray
    frames: np.ndarray


def initial_gains(rig: CameraRig) -> Gains:
    """As the rig file says, else 1."""
    given = [np.log(camera.gain) if camera.gain else np.zeros(3) for camera in rig.camera]
    return Gains(np.array(given), np.zeros(len(given)), np.full(len(given), -1))


def gains_by_walls(before: Gains, rig: CameraRig, maps: Sequence[EnvironmentMap | None]) -> Gains:
    """What is known once a camera has its first map, or the first after a silence: it may have another unit then. As before when none has.

    maps: of a moment, None where a camera is silent.
    """
    new = [each is not None and frames < 0 for each, frames in zip(maps, before.frames, strict=True)]
    gone = [each is None and frames >= 0 for each, frames in zip(maps, before.frames, strict=True)]
    if not any(new) and not any(gone):
        return before
    ln, sigma, frames = (array.copy() for array in before)
    frames[gone] = -1
    frames[new] = 0
    reference = _reference(rig, [each is not None for each in maps], before.frames)
    blocks = [
        block_radiance(each, camera.world_from_camera, BLOCKS) if each is not None and (is_new or k == reference) else None
        for k, (each, camera, is_new) in enumerate(zip(maps, rig.camera, new, strict=True))
    ]
    for k, own in enumerate(blocks):
        first = blocks[reference]
        if k == reference or own is None or first is None or rig.camera[k].gain:
            continue
        both = (own > 0).all(axis=1) & (first > 0).all(axis=1)  # nan where a block is not seen whole
        ratio, sigma_of_ratio = _median_ratio(own[both], first[both])
        off = ratio + ln[k] - ln[reference]  # with the gain before a silence, 1 at first
        sure = SURE_SIGMAS * sigma_of_ratio
        if np.abs(off).max() > max(ROUGH_LN, sure) or np.ptp(off) > max(ROUGH_COLOUR, sure):
            ln[k], sigma[k] = ln[reference] - ratio, ROUGH_SIGMA
    return Gains(ln, sigma, frames)


def _median_ratio(own: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, float]:
    """Medians (3,) of ln of own / first (blocks, 3), and their standard deviation, of the channel that has the greatest; 0 of too few.

    The deviation of a median is 1.25 that of a value over the root of their number, and of a value 1.48 times the median of the absolute
    ones (Huber 1981, sections 1.2 and 5.1).
    """
    if len(own) < MIN_BLOCKS:
        return np.zeros(3), 0.0
    ratios = np.log(own) - np.log(first)
    ratio = np.median(ratios, axis=0)
    scatter = 1.48 * float(np.median(np.abs(ratios - ratio), axis=0).max())
    return ratio, 1.25 * scatter / np.sqrt(WALLS * len(own) / (BLOCKS.rows * BLOCKS.cols / 2))


def gains_by_lights(before: Gains, rig: CameraRig, matched: Matches, fluxes: Sequence[np.ndarray], offsets: np.ndarray) -> Gains:
    """What is known after a moment's lights.

    fluxes: of each camera's sources (n, 3), with the gains before; nan where they are unknown. offsets: as SeenSources has them.
    """
    sent = np.full((*matched.sources.shape, 3), np.nan)  # ln of intensity, of each light to each camera
    for k, flux in enumerate(fluxes):
        light = np.flatnonzero(matched.sources[:, k] >= 0)
        p = matched.fit[light, :3] + matched.fit[light, 3:4] * offsets[k]
        own = flux[matched.sources[light, k]]
        own = np.where((own > 0).all(axis=1, keepdims=True), own, np.nan)
        sent[light, k] = np.log(own) + np.log((p * p).sum(axis=1))[:, None]
    known = np.isfinite(sent[:, :, 0])
    if not known.any():
        return before
    ln, sigma, frames = (array.copy() for array in before)
    seen = known.sum(axis=0) >= MIN_LIGHTS
    reference = _reference(rig, seen, frames)
    frames[reference] += 1
    for k in np.flatnonzero(seen & np.array([each.gain is None for each in rig.camera])):
        both = known[:, k] & known[:, reference]
        if k == reference or both.sum() < MIN_LIGHTS:
            continue
        ratio = np.median(sent[both, k] - sent[both, reference], axis=0)
        if sigma[k] > 0 or np.abs(ratio).max() > SURE_SIGMAS * FLUX_SIGMA * np.sqrt(2 / both.sum()):
            frames[k] += 1
            ln[k] -= ratio / min(frames[k], MEMORY)
            sigma[k] = FINE_SIGMA
    return Gains(ln, sigma, frames)


def _reference(rig: CameraRig, here: Sequence[bool] | np.ndarray, frames: np.ndarray) -> int:
    """The camera that the others are compared with: of those that are here the first with a gain, else the one whose own is known longest,
    so that a first camera that comes late, or comes back, changes nobody's unit. frames: as Gains has them.
    """
    given = [k for k, camera in enumerate(rig.camera) if camera.gain and here[k]]
    return given[0] if given else int(np.argmax(np.where(here, np.minimum(frames, MEMORY), -2)))
