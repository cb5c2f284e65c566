"""Levels of real fixtures from tracked lights, beside averaging a region of the picture for each lamp: error, flicker and time.

Rigs of our own times maps: the folder VEMLIGHT_DATA/hdri, and procedural ones. Of each the error of irradiance at the target, over 200
normals and RGB, relative, against the map itself. The others have their best overall gain, no bounds and no primaries. Writes
docs/charts/fixtures.csv, fixtures_coarse.csv, fixtures_moving.csv and fixtures_time.csv.

    VEMLIGHT_DATA=... python -m bench.fixtures [still|moving|time ...]
"""

import csv
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.optimize import nnls

from bench.rivals.cells import cells
from vemlight.capture.simulation.environment import Environment
from vemlight.capture.simulation.simulate import open_scene
from vemlight.fixtures.irradiance_kernel import fibonacci_normals
from vemlight.fixtures.levels import initial_state, step
from vemlight.fixtures.rig import Emitter, Fixture, Rig
from vemlight.fixtures.rig_system import RigSystem
from vemlight.light.images import read_radiance
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import (
    angles_from_direction,
    cell_directions,
    cell_solid_angles,
    direction_from_angles,
    latlong_directions,
    latlong_from_direction,
    latlong_solid_angles,
    rotation_xyz,
)
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state as initial_sampler
from vemlight.sampler.step import step as sampler_step
from vemlight.settings import Sampler

CHARTS = Path(__file__).parents[1] / "docs" / "charts"
ROWS, COLS = 90, 180  # of the polar map of the whole sphere
LIGHTS = 72
SETTLED = 8  # frames of a still map before it is judged
FRAMES, FPS = 60, 25.0
BRIGHTEST = 256  # pixels that are turned by themselves
CONE_RAD = math.radians(15.0)  # half of a cone of 30 degrees
TARGET = np.array([0.0, 0.0, 1.6])
DIRECTIONS = cell_directions(ROWS, COLS, "sphere").reshape(-1, 3)
SOLID_ANGLES = np.repeat(cell_solid_angles(ROWS, COLS, "sphere"), COLS)
COSINES = np.maximum(fibonacci_normals() @ DIRECTIONS.T, 0)
OTHERS = ("region mean", "region sum", "cone")
RGB = (
    Emitter(name="red", xy=(0.690, 0.308), share=0.24), Emitter(name="green", xy=(0.190, 0.720), share=0.66),
    Emitter(name="blue", xy=(0.140, 0.050), share=0.10),
)  # fmt: skip
RGBW = (*RGB, Emitter(name="white", xy=(0.313, 0.329), share=0.8))
RGBAL = (*RGB, Emitter(name="amber", xy=(0.57, 0.42), share=0.3), Emitter(name="lime", xy=(0.40, 0.54), share=0.5))
BICOLOUR = (Emitter(name="warm", xy=(0.4578, 0.4101)), Emitter(name="cold", xy=(0.3127, 0.3290)))


def beam(number: int, direction: np.ndarray, emitters=RGB, metres: float = 4.0) -> Fixture:
    at = TARGET + metres * np.asarray(direction)
    return Fixture(name=f"beam {number}", at=tuple(at.tolist()), candela=20_000.0, beam_deg=25.0, emitters=emitters, bits=16, address=1)


def panel(number: int, direction: np.ndarray, size: tuple[float, float] = (1.0, 1.0), emitters=RGB, metres: float = 2.5) -> Fixture:
    at = TARGET + metres * np.asarray(direction)
    return Fixture(name=f"panel {number}", at=tuple(at.tolist()), candela=6_000.0, size=size, emitters=emitters, bits=16, address=1)


def spiral(count: int, least_z: float) -> list[np.ndarray]:
    """Directions on a golden spiral from the zenith down to least_z."""
    z = 1 - (1 - least_z) * (np.arange(count) + 0.5) / count
    phi = np.arange(count) * math.pi * (3 - math.sqrt(5))
    return list(np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1))


def ring(count: int, elevation_deg: float, first_deg: float = 0.0, arc_deg: float = 360.0) -> list[np.ndarray]:
    theta = math.radians(90 - elevation_deg)
    return [direction_from_angles(theta, math.radians(first_deg + arc_deg * k / count)) for k in range(count)]


def rigs() -> dict[str, Rig]:
    """The rigs; the last two are kept aside: nothing was chosen by them."""
    dome = spiral(16, 0.0)
    floor = ring(5, -35)
    wall = [*ring(12, 5), *ring(2, 75, 45)]
    made = {
        "ring of 8 overhead": [beam(k, d) for k, d in enumerate(ring(8, 50))],
        "dome of 16": [beam(k, d) for k, d in enumerate(dome)],
        "dome of 27 + 5 floor": [beam(k, d) for k, d in enumerate([*spiral(27, -0.1), *floor])],
        "wall: 12 panels + 4": [
            *(panel(k, d, (1.2, 2.4)) for k, d in enumerate(wall[:12])), *(panel(20 + k, d) for k, d in enumerate(wall[12:])),
            *(beam(k, d, RGBW) for k, d in enumerate(ring(2, 35, 40, 120))),
        ],
        "aside: cyclorama": [
            *(panel(k, d, (0.9, 2.0), metres=3.0) for k, d in enumerate(ring(9, 10, -80, 180))),
            *(beam(k, d, RGBAL) for k, d in enumerate([*ring(4, 55, 20), *ring(2, 30, 110, 70)])), panel(30, np.array([0, 0, 1.0])),
            *(panel(40 + k, d, (1.5, 0.5), metres=2.0) for k, d in enumerate(ring(3, -30, -60, 180))),
        ],
        "aside: two trusses": [
            *(beam(k, d / np.linalg.norm(d), RGBW, 4.5) for k, d in enumerate(
                [np.array([x, y, 2.6]) for y in (-2.0, 2.0) for x in (-4, -2, 0, 2, 4)])),
            *(beam(20 + k, d, RGBAL) for k, d in enumerate(ring(6, 8, 30))),
        ],
    }  # fmt: skip
    return {name: Rig(target=tuple(TARGET.tolist()), gain=1.0, fixture=tuple(fixtures)) for name, fixtures in made.items()}


def latlong_maps() -> Iterator[tuple[str, np.ndarray]]:
    """Names and lat-long images: real ones where VEMLIGHT_DATA is set, and procedural ones."""
    for name in ("sky", "interior"):
        yield name, with_discs(open_scene((name,), 0).environment(0, 0.0, 0.0))
    yield "grey", np.ones((128, 256, 3))
    if folder := os.environ.get("VEMLIGHT_DATA"):
        for path in sorted(Path(folder, "hdri").glob("*_1k.hdr")):
            image, _ = read_radiance(path)
            yield path.stem.removesuffix("_1k"), image.astype(np.float64).reshape(256, 2, 512, 2, 3).mean(axis=(1, 3))


def with_discs(environment: Environment) -> np.ndarray:
    """The lat-long image with each sun in one pixel."""
    image = environment.image.copy()
    solid_angles = latlong_solid_angles(*image.shape[:2])
    for disc in environment.discs:
        row, col = (int(each) for each in latlong_from_direction(disc.direction, *image.shape[:2]))
        image[row, col] += disc.irradiance / solid_angles[row]
    return image


def polar(image: np.ndarray, turn: np.ndarray | None = None) -> np.ndarray:
    """(ROWS, COLS, 3) float32: the lat-long image turned by (3, 3): the mean of 3 x 3 nearest pixels a cell, and the brightest pixels by
    themselves, their flux divided among the four nearest cells, so that no sun is lost between samples."""
    turn = np.eye(3) if turn is None else turn
    height, width, _ = image.shape
    flux = image * latlong_solid_angles(height, width)[:, None, None]
    brightest = np.argpartition(flux.sum(axis=2).ravel(), -BRIGHTEST)[-BRIGHTEST:]
    rest = image.copy()
    rest.reshape(-1, 3)[brightest] = np.median(image.reshape(-1, 3), axis=0)
    fine = cell_directions(3 * ROWS, 3 * COLS, "sphere") @ turn
    row, col = latlong_from_direction(fine, height, width)
    samples = rest[np.clip(row.astype(int), 0, height - 1), col.astype(int) % width]
    made = samples.reshape(ROWS, 3, COLS, 3, 3).mean(axis=(1, 3))
    solid_angles = cell_solid_angles(ROWS, COLS, "sphere")
    theta, phi = angles_from_direction(latlong_directions(height, width).reshape(-1, 3)[brightest] @ turn.T)
    i, j = theta / np.pi * ROWS - 0.5, phi / (2 * np.pi) * COLS - 0.5
    for di in (0, 1):
        for dj in (0, 1):
            rows, cols = np.floor(i).astype(int) + di, np.floor(j).astype(int) + dj
            weight = np.abs(1 - di - (i - np.floor(i))) * np.abs(1 - dj - (j - np.floor(j)))
            rows = np.clip(rows, 0, ROWS - 1)
            np.add.at(made, (rows, cols % COLS), flux.reshape(-1, 3)[brightest] * (weight / solid_angles[rows])[:, None])
    return made.astype(np.float32)


class Truth(NamedTuple):
    """A frame's cells. irradiance: (cells, 3). wanted: (normals, 3), what planes receive for a gain of 1."""

    irradiance: np.ndarray
    wanted: np.ndarray

    @staticmethod
    def of(radiance: np.ndarray) -> "Truth":
        flux = cells(radiance, "sphere").flux.reshape(-1, 3)
        return Truth(flux, COSINES @ flux)


class Averaged:
    """Lamps that each have a mean or sum of the picture: over the region that is nearest to it, or a cone."""

    def __init__(self, system: RigSystem, how: str) -> None:
        count = len(system.rig.fixture)
        centres = np.array([system.pieces.directions[system.pieces.fixtures == k].mean(axis=0) for k in range(count)])
        cosines = DIRECTIONS @ (centres / np.linalg.norm(centres, axis=1, keepdims=True)).T
        nearest = cosines.argmax(axis=1)[:, None] == np.arange(count)
        weights = (cosines > math.cos(CONE_RAD) if how == "cone" else nearest).T.astype(float)
        self.weights = weights if how == "region sum" else weights / np.maximum(weights @ SOLID_ANGLES, 1e-12)[:, None]
        self.response = system.response / np.bincount(system.pieces.fixtures, system.pieces.strengths)

    def given(self, truth: Truth) -> np.ndarray:
        """(normals, 3): what the rig gives, without its best gain."""
        return self.response @ (self.weights @ truth.irradiance)


def error(given: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(given - wanted) / np.linalg.norm(wanted))


def best_gain(given: np.ndarray, wanted: np.ndarray) -> float:
    return float((given * wanted).sum() / max((given * given).sum(), 1e-300))


def least(system: RigSystem, wanted: np.ndarray) -> float:
    """The least error that levels of 0 and more can have at these normals."""
    matrix = np.einsum("nf,fc->ncf", system.response[:, system.owners], np.ones((len(system.owners), 3)))
    matrix = (matrix * system.colours.T[None]).reshape(-1, len(system.owners))
    scale = float(np.abs(wanted).max())
    _, rest = nnls(matrix, wanted.ravel() / scale, maxiter=20_000)
    return float(rest * scale / np.linalg.norm(wanted))


def lights_of(frames: Iterable[np.ndarray]) -> list[LightSet]:
    """The sampler's lights of each frame."""
    state, made, settings = initial_sampler(), [], Sampler(count=LIGHTS)
    for k, radiance in enumerate(frames):
        state, lights, _ = sampler_step(settings, state, SamplerInput(radiance, "sphere", k / FPS))
        made.append(lights)
    return made


def given_by(system: RigSystem, lights: Sequence[LightSet]) -> tuple[list[np.ndarray], list[float]]:
    """What the rig gives (normals, 3) for each frame's lights, and the processor time of each step, s."""
    state, given, spent_s = initial_state(system), [], []
    for k, each in enumerate(lights):
        started_s = time.process_time()
        state, levels = step(system, state, each, k / FPS)
        spent_s.append(time.process_time() - started_s)
        given.append(levels.given)
    return given, spent_s


def with_gain(rig: Rig, truth: Truth) -> RigSystem:
    """The system of a rig whose strongest level is far below full for this map: errors are the geometry's, not the power's."""
    system = RigSystem.of(rig)
    gain = 0.02 * system.response.max() / truth.wanted.max()
    return system._replace(rig=msgspec.structs.replace(rig, gain=float(gain)))


def still() -> Iterator[dict[str, object]]:
    """One row a rig and map."""
    for name, image in latlong_maps():
        radiance = polar(image)
        truth, lights = Truth.of(radiance), lights_of(SETTLED * [radiance])
        for rig_name, rig in rigs().items():
            system = with_gain(rig, truth)
            assert isinstance(system.rig.gain, float)
            wanted = truth.wanted * system.rig.gain
            row = {"rig": rig_name, "map": name, "solved": error(given_by(system, lights)[0][-1], wanted), "least": least(system, wanted)}
            for how in OTHERS:
                made = Averaged(system, how).given(truth)
                row[how] = error(made * best_gain(made, wanted), wanted)
            yield row


def hand_held(image: np.ndarray) -> Iterator[np.ndarray]:
    for k in range(FRAMES):
        t = 2 * math.pi * k
        turn = rotation_xyz((7 * math.sin(t / 23), 6 * math.sin(t / 31 + 1), 15 * math.sin(t / 28)))
        yield polar(image, turn)


def sun(image: np.ndarray) -> Iterator[np.ndarray]:
    """A sun with half of all light goes through azimuth 0 at 40 degrees, half a degree a frame."""
    still_map = polar(image)
    made = cells(still_map, "sphere")
    power = made.flux.sum(axis=(0, 1))
    for k in range(FRAMES):
        radiance = still_map.copy()
        row, col = 50 / 180 * ROWS, ((k - FRAMES / 2 + 0.3) * 0.5 / 360 * COLS) % COLS
        first, part = int(col), col % 1
        for column, weight in ((first, 1 - part), ((first + 1) % COLS, part)):
            radiance[int(row), column] += weight * power / made.solid_angles[int(row)]
        yield radiance


SEQUENCES: dict[str, Callable[[np.ndarray], Iterator[np.ndarray]]] = {"hand-held": hand_held, "sun": sun}


def moving() -> Iterator[dict[str, object]]:
    """One row a rig, map and sequence: mean error, and RMS of its change from frame to frame, relative to the mean size of the target."""
    for name, image in latlong_maps():
        if name == "grey":
            continue
        for sequence, play in SEQUENCES.items():
            frames = list(play(image))
            lights = lights_of(SETTLED * [frames[0]] + frames)
            truths = [Truth.of(frame) for frame in frames]
            for rig_name, rig in rigs().items():
                system = with_gain(rig, truths[0])
                assert isinstance(system.rig.gain, float)
                wanted = np.array([truth.wanted for truth in truths]) * system.rig.gain
                size = float(np.linalg.norm(wanted, axis=(1, 2)).mean())
                made = {"solved": np.array(given_by(system, lights)[0][SETTLED:])}
                for how in OTHERS:
                    given = Averaged(system, how)
                    made[how] = np.array([given.given(truth) for truth in truths])
                    made[how] *= best_gain(made[how], wanted)
                row: dict[str, object] = {"rig": rig_name, "map": name, "sequence": sequence}
                for how, given in made.items():
                    rest = given - wanted
                    row[f"{how} error"] = float(np.linalg.norm(rest, axis=(1, 2)).mean()) / size
                    row[f"{how} flicker"] = float(np.sqrt((np.diff(rest, axis=0) ** 2).sum(axis=(1, 2)).mean())) / size
                yield row


def times() -> Iterator[dict[str, object]]:
    """Processor time of a step from 72 soft lights that move, warm."""
    frames = list(hand_held(with_discs(open_scene(("interior",), 0).environment(0, 0.0, 0.0))))
    lights, truth = lights_of(frames), Truth.of(frames[0])
    for name, emitters, fixtures in (
        ("16 beams RGB", RGB, [beam(k, d) for k, d in enumerate(spiral(16, 0))]),
        ("16 beams of 5", RGBAL, [beam(k, d, RGBAL) for k, d in enumerate(spiral(16, 0))]),
        ("32 beams of 5", RGBAL, [beam(k, d, RGBAL) for k, d in enumerate(spiral(32, -0.3))]),
        ("16 panels of 5", RGBAL, [panel(k, d, emitters=RGBAL) for k, d in enumerate(spiral(16, 0))]),
        ("16 beams of 5, 8 bits", RGBAL, [msgspec.structs.replace(beam(k, d, RGBAL), bits=8) for k, d in enumerate(spiral(16, 0))]),
    ):
        system = with_gain(Rig(target=tuple(TARGET.tolist()), gain=1.0, fixture=tuple(fixtures)), truth)
        spent = np.array(given_by(system, lights)[1][5:]) * 1e3
        yield {"rig": name, "emitters": len(fixtures) * len(emitters), "median ms": float(np.median(spent)), "most ms": float(spent.max())}


TOP_STEPS = 6  # of 255: the strongest level of fixtures of 8 bits near their lower end


def coarse() -> Iterator[dict[str, object]]:
    """One row a rig and map: the error where the strongest level is TOP_STEPS of 255, each level rounded by itself and searched."""
    for name, image in latlong_maps():
        radiance = polar(image)
        truth, lights = Truth.of(radiance), lights_of(SETTLED * [radiance])
        for rig_name in ("dome of 16", "dome of 27 + 5 floor", "aside: cyclorama"):
            system = with_gain(rigs()[rig_name], truth)
            state, exact = step(system, initial_state(system), lights[-1], 0.0)
            gain = state.gain * TOP_STEPS / 255 / exact.levels.max()
            fine = system._replace(rig=msgspec.structs.replace(system.rig, gain=float(gain)))
            bytes_ = RigSystem.of(msgspec.structs.replace(
                fine.rig, fixture=tuple(msgspec.structs.replace(fixture, bits=8) for fixture in fine.rig.fixture)
            ))  # fmt: skip
            wanted = truth.wanted * gain
            _, exact = step(fine, initial_state(fine), lights[-1], 0.0)
            _, searched = step(bytes_, initial_state(bytes_), lights[-1], 0.0)
            made = Averaged(system, "region mean").given(truth)
            yield {
                "rig": rig_name, "map": name, "16 bits": error(exact.given, wanted), "searched": error(searched.given, wanted),
                "rounded": error(fine.irradiance_of(np.rint(exact.levels * 255) / 255), wanted),
                "region mean": error(made * best_gain(made, wanted), wanted),
            }  # fmt: skip


PARTS = {
    "still": (still, "fixtures"), "coarse": (coarse, "fixtures_coarse"), "moving": (moving, "fixtures_moving"),
    "time": (times, "fixtures_time"),
}  # fmt: skip


def main(names: Sequence[str]) -> None:
    for name in names or PARTS:
        make, file = PARTS[name]
        rows = []
        for row in make():
            rows.append(row)
            print("  ".join(f"{value:.4f}" if isinstance(value, float) else f"{value!s:22}" for value in row.values()), flush=True)
        with open(CHARTS / f"{file}.csv", "w", newline="") as out:
            writer = csv.DictWriter(out, rows[0].keys(), lineterminator="\n")
            writer.writeheader()
            writer.writerows({key: round(value, 5) if isinstance(value, float) else value for key, value in row.items()} for row in rows)


if __name__ == "__main__":
    main(sys.argv[1:])
