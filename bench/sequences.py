"""Moving light with a known truth: steady and hand-held cameras, a sun, a lamp, damaged and lost frames, mains flicker.

A world is a lat-long map whose brightest pixels are single directions; each frame turns it, adds what the sequence adds, and
keeps two things: the source as it is (the reference) and the polar map that a camera delivers (noise, invalid pixels), which is
all that the methods see.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numba import njit

from bench.evaluation import BRIGHTEST, Points, Source, with_brightest
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import (
    cell_directions,
    direction_from_angles,
    latlong_directions,
    latlong_from_direction,
    latlong_solid_angles,
    rotation_xyz,
)

ROWS, COLS, FPS, FRAMES = 90, 360, 25.0, 48
NOISE = 0.02  # standard deviation of a pixel's noise, relative
SUN = 2.0  # power of the added sun, over the map's own: two thirds of all light, as in the sunny maps
LAMP = 1.0  # of the added lamp
SETTLE_S = 1.5  # flicker is looked for from the 24th frame on
RIPPLE = 0.3  # amplitude of a lamp on alternating current, relative; fluorescent tubes have 0.2 to 0.5


class World(NamedTuple):
    """brightest: the brightest pixels of the sphere. rest: (height, width, 3) float64 lat-long radiance without them. power:
    (3,), upper half.
    """

    brightest: Points
    rest: np.ndarray
    power: np.ndarray


class Frame(NamedTuple):
    """time_s: of the capture. source: the truth, its `polar` still clean. seen: (rows, cols, 3) float32, what the methods get.

    added: place (unit vector) and light of each compact source that the sequence adds.
    """

    time_s: float
    source: Source
    seen: np.ndarray
    added: tuple[tuple[np.ndarray, Points], ...] = ()


def world_from_latlong(image: np.ndarray) -> World:
    """The world of a lat-long image (height, width, 3); invalid pixels are black."""
    image = np.where(np.isfinite(image) & (image > 0), image, 0).astype(np.float64)
    height, width, _ = image.shape
    flux = image * latlong_solid_angles(height, width)[:, None, None]
    chosen = np.argpartition(luminance_from_rgb(flux).ravel(), -BRIGHTEST)[-BRIGHTEST:]
    brightest = Points(latlong_directions(height, width).reshape(-1, 3)[chosen], flux.reshape(-1, 3)[chosen])
    power = flux[: height // 2].sum(axis=(0, 1))
    image.reshape(-1, 3)[chosen] = 0
    return World(brightest, image, power)


def turned(world: World, rotation: np.ndarray, added: Points | None = None) -> Source:
    """The upper hemisphere of the world after `rotation` (3, 3), with `added` points that do not turn."""
    directions, flux = world.brightest.directions @ rotation.T, world.brightest.irradiance
    if added is not None:
        directions, flux = np.concatenate([directions, added.directions]), np.concatenate([flux, added.irradiance])
    above = directions[:, 2] > 0
    return with_brightest(Points(directions[above], flux[above]), _rest(world.rest, rotation))


def _rest(image: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The turned lat-long image on the polar grid (rows, cols, 3) float32: the mean of 2 x 2 bilinear samples in each cell."""
    height, width, _ = image.shape
    fine = cell_directions(2 * ROWS, 2 * COLS, "hemisphere") @ rotation  # of the world: transposed rotation
    row, col = latlong_from_direction(fine, height, width)
    samples = np.empty((2 * ROWS, 2 * COLS, 3))
    _bilinear(image, row - 0.5, col - 0.5, samples)
    return samples.reshape(ROWS, 2, COLS, 2, 3).mean(axis=(1, 3)).astype(np.float32)


@njit(cache=True)
def _bilinear(image, row, col, samples):
    height, width, _ = image.shape
    for i in range(row.shape[0]):
        for j in range(row.shape[1]):
            y, x = min(max(row[i, j], 0.0), height - 1.0), col[i, j]
            y0, x0 = min(int(y), height - 2), int(np.floor(x))
            v, u = y - y0, x - x0
            for c in range(3):
                top = (1 - u) * image[y0, x0 % width, c] + u * image[y0, (x0 + 1) % width, c]
                low = (1 - u) * image[y0 + 1, x0 % width, c] + u * image[y0 + 1, (x0 + 1) % width, c]
                samples[i, j, c] = (1 - v) * top + v * low


def disc(centre: np.ndarray, diameter_deg: float, irradiance: np.ndarray) -> Points:
    """An even round source of 61 points (rings of 1, 6, 12, 18, 24) round the unit vector `centre`."""
    local = [[0.0, 0.0]]
    for ring in range(1, 5):
        turn = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        local += list(ring / 4.5 * np.stack([np.cos(turn), np.sin(turn)], axis=-1))
    across = np.linalg.svd(centre[None])[2][1:]
    points = centre + np.tan(np.radians(diameter_deg / 2)) * np.array(local) @ across
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return Points(points, np.broadcast_to(irradiance / len(points), points.shape))


def _noisy(polar: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    return (polar * (1 + NOISE * generator.standard_normal(polar.shape))).astype(np.float32)


def rotation(world: World) -> Iterator[Frame]:
    """A slow turn about the vertical, 0.7 degrees a frame, with noise."""
    generator = np.random.default_rng(1)
    for k in range(FRAMES):
        source = turned(world, rotation_xyz((0, 0, 0.7 * k)))
        yield Frame(k / FPS, source, _noisy(source.polar, generator))


def hand_held(world: World) -> Iterator[Frame]:
    """A camera turned and tilted by hand, up to 4 degrees a frame, with noise."""
    generator = np.random.default_rng(2)
    for k in range(FRAMES):
        t = 2 * np.pi * k
        source = turned(world, rotation_xyz((7 * np.sin(t / 23), 6 * np.sin(t / 31 + 1), 15 * np.sin(t / 28))))
        yield Frame(k / FPS, source, _noisy(source.polar, generator))


def _sun(world: World, path: Callable[[float], np.ndarray]) -> Iterator[Frame]:
    for k in range(FRAMES):
        place = path((k - FRAMES / 2 + 0.3) * 0.5)
        sun = disc(place, 0.53, SUN * world.power)
        source = turned(world, np.eye(3), sun)
        yield Frame(k / FPS, source, source.polar, ((place, sun),))


def zenith(world: World) -> Iterator[Frame]:
    """A sun of 0.53 degrees passes the zenith at a third of a degree, half a degree a frame."""

    def path(degrees: float) -> np.ndarray:
        place = np.array([np.sin(np.radians(degrees)), np.sin(np.radians(0.33)), np.cos(np.radians(degrees))])
        return place / np.linalg.norm(place)

    return _sun(world, path)


def seam(world: World) -> Iterator[Frame]:
    """The same sun at 45 degrees crosses phi = 0."""
    return _sun(world, lambda degrees: direction_from_angles(np.pi / 4, np.radians(degrees / np.sin(np.pi / 4))))


LAMP_AT = direction_from_angles(np.radians(35.0), np.radians(120.0))
LAMP_OFF, LAMP_ON = 16, 32


def lamp(world: World) -> Iterator[Frame]:
    """A lamp of 4 degrees with half of all light goes out and on again."""
    for k in range(FRAMES):
        on = not LAMP_OFF <= k < LAMP_ON
        light = disc(LAMP_AT, 4.0, LAMP * world.power)
        source = turned(world, np.eye(3), light if on else None)
        yield Frame(k / FPS, source, source.polar, ((LAMP_AT, light),) if on else ())


def damaged_frames(world: World) -> Iterator[Frame]:
    """Every fourth frame has 1 % nan pixels, or 1 % black ones, or a black block of 12 x 40 degrees round the brightest cell,
    or of nan.
    """
    generator = np.random.default_rng(3)
    for k in range(FRAMES):
        source = turned(world, rotation_xyz((0, 0, 0.2 * k)))
        seen = _noisy(source.polar, generator)
        if k % 4 == 3:
            value = np.float32(np.nan if (k // 4) % 2 else 0.0)
            if (k // 8) % 2:
                i, j = np.unravel_index(int(luminance_from_rgb(source.polar).argmax()), (ROWS, COLS))
                rows = slice(max(int(i) - 6, 0), int(i) + 6)
                seen[rows, np.arange(int(j) - 20, int(j) + 20) % COLS] = value
            else:
                seen[generator.random((ROWS, COLS)) < 0.01] = value
        yield Frame(k / FPS, source, seen)


def black_frames(world: World) -> Iterator[Frame]:
    """A slow turn; every twelfth frame arrives black."""
    for k, frame in enumerate(rotation(world)):
        yield frame._replace(seen=np.zeros_like(frame.seen)) if k % 12 == 11 else frame


def lost_frames(world: World) -> Iterator[Frame]:
    """A sun at 45 degrees, half a degree a frame, and a third of the frames are lost on the way."""
    received = np.sort(np.random.default_rng(5).permutation(FRAMES * 3 // 2)[:FRAMES])
    for k in received:
        place = direction_from_angles(np.pi / 4, np.radians(60 + 0.5 * int(k)))
        sun = disc(place, 0.53, SUN * world.power)
        source = turned(world, np.eye(3), sun)
        yield Frame(int(k) / FPS, source, source.polar, ((place, sun),))


def mains(fps: float) -> Callable[[World], Iterator[Frame]]:
    """Half of all light from a lamp on 50 Hz, which ripples at 100 Hz; the truth is its mean. SETTLE_S to settle, then FRAMES
    frames.
    """

    def frames(world: World) -> Iterator[Frame]:
        generator = np.random.default_rng(4)
        truth = turned(world, np.eye(3), disc(LAMP_AT, 4.0, LAMP * world.power))
        for k in range(round(SETTLE_S * fps) + FRAMES):
            part = 1 + RIPPLE * np.cos(2 * np.pi * 100 * k / fps + 0.7)
            now = turned(world, np.eye(3), disc(LAMP_AT, 4.0, part * LAMP * world.power))
            yield Frame(k / fps, truth._replace(bright_cells=now.bright_cells), _noisy(now.polar, generator))

    return frames


SEQUENCES: dict[str, Callable[[World], Iterator[Frame]]] = {
    "rotation": rotation,
    "hand-held": hand_held,
    "zenith": zenith,
    "seam": seam,
    "lamp": lamp,
    "damaged frames": damaged_frames,
    "black frames": black_frames,
    "lost frames": lost_frames,
    "mains 21 fps": mains(21.0),
    "mains 25 fps": mains(25.0),
    "mains 30 fps": mains(30.0),
}
