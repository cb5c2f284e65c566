"""The sequences of the benchmark: those of `bench.sequences`, and light that fades, is hidden, is switched and is exposed otherwise."""

from collections.abc import Callable, Iterator

import numpy as np

from bench.evaluation import Points
from bench.sequences import FPS, FRAMES, LAMP, LAMP_AT, SEQUENCES, SUN, Frame, World, disc, turned
from vemlight.light.sphere import direction_from_angles, rotation_xyz

LAMP_DEG = 4.0  # diameter
EVERY = 12  # frames between two changes of exposure or of the strobe's beat
STOPS = (0.0, 1.0, -1.5, 0.5)


def _frame(k: int, world: World, rotation: np.ndarray, added: list[tuple[np.ndarray, Points]]) -> Frame:
    lights = Points(*(np.concatenate([getattr(light, name) for _, light in added]) for name in Points._fields)) if added else None
    source = turned(world, rotation, lights)
    return Frame(k / FPS, source, source.polar, tuple(added))


def day(world: World) -> Iterator[Frame]:
    """A day in 48 frames: a sun crosses the sky, brightens and reddens while the sky turns."""
    for k in range(FRAMES):
        turn = (k + 0.5) / FRAMES * np.pi
        place = direction_from_angles(np.pi / 2 - 1.1 * np.sin(turn), turn - np.pi / 2)
        sun = disc(place, 0.53, SUN * np.sin(turn) * world.power * [1, 0.7 + 0.2 * np.sin(turn), 0.3 + 0.5 * np.sin(turn)])
        yield _frame(k, world, rotation_xyz((0, 0, 1.5 * k)), [(place, sun)])


def clouds(world: World) -> Iterator[Frame]:
    """A sun that clouds hide for less than half a second at a time."""
    for k in range(FRAMES):
        open_ = max(np.sin(2 * np.pi * k / 20), 0.0) ** 0.5 if k > 10 else 1.0
        place = direction_from_angles(np.radians(40 + 0.05 * k), np.radians(10))
        sun = [(place, disc(place, 0.53, open_ * SUN * world.power))] if open_ else []
        yield _frame(k, world, rotation_xyz((0, 0, 0.1 * k)), sun)


def opposite_lamps(world: World) -> Iterator[Frame]:
    """Two lamps of 4 degrees opposite each other, one fading into the other."""
    for k in range(FRAMES):
        part = 0.5 + 0.5 * np.cos(2 * np.pi * k / FRAMES)
        places = [direction_from_angles(np.radians(50), azimuth) for azimuth in (0.3, 0.3 + np.pi)]
        strengths = [3 * part, 3 * (1 - part)]
        lamps = [(place, disc(place, LAMP_DEG, s * world.power)) for place, s in zip(places, strengths, strict=True) if s > 0]
        yield _frame(k, world, np.eye(3), lamps)


def strobe(world: World) -> Iterator[Frame]:
    """A lamp with half of all light that is on in every second frame, every third, every fourth and so on."""
    for k in range(FRAMES):
        on = k % (2 + k // EVERY) == 0
        lamp = [(LAMP_AT, disc(LAMP_AT, LAMP_DEG, LAMP * world.power))] if on else []
        yield _frame(k, world, np.eye(3), lamp)


def exposure(world: World) -> Iterator[Frame]:
    """A map that stands still, recorded with another exposure every EVERY frames: all light times a constant."""
    for k in range(FRAMES):
        gain = 2.0 ** STOPS[k // EVERY % len(STOPS)]
        yield _frame(k, World(world.brightest._replace(irradiance=gain * world.brightest.irradiance), gain * world.rest, world.power),
                     np.eye(3), [])  # fmt: skip


MOVING: dict[str, Callable[[World], Iterator[Frame]]] = {
    **SEQUENCES, "day": day, "clouds": clouds, "opposite lamps": opposite_lamps, "strobe": strobe, "exposure": exposure,
}  # fmt: skip
