"""How well near lights are located, on rooms whose light is known: `python -m bench.near_lights [ROOMS] [--seeds FIRST:LAST]`.

ROOMS: `tuned` (default), on which constants may be looked at, or `kept`, on which none was. For rigs of 2, 3 and 4 cameras a metre apart,
with pose errors as declared, it prints the place's error relative to the distance, the intensity's, error over sigma (of lamps that stand
alone, and of all: two that look like one are at neither's place), what is missed and what is false a frame, lit patches of walls that are
located, whether ids stay, and the error of the irradiance a metre away of the first camera's map and of points and rest. `speed` in place
of ROOMS: what a step of 4 cameras with 12 lamps each takes, level ones and turned ones.
"""

import argparse
import os
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tests.support.analytic_rooms import (
    PAIR,
    SQUARE,
    TRIANGLE,
    Lamp,
    Room,
    kept_room,
    maps_of,
    noisy,
    random_room,
    rig_of,
    room_map,
)
from tests.support.lamp_maps import Bulb, lamp_maps
from vemlight.fuse.fusing import FuseState, fuse_step
from vemlight.fuse.rig_file import CameraRig
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.near_lights import NearLightSet
from vemlight.light.sphere import cell_directions, cell_solid_angles, quaternion_xyz

RIGS = {"2 cameras": PAIR, "3 cameras": TRIANGLE, "4 cameras": SQUARE}
# Of the trial that the method began with: position median and p90, % of the distance; intensity median, %; irradiance 1 m away, points and
# rest over the first camera's map; error over sigma of single frames.
TRIAL = {"2 cameras": ".44-.80 / 1.6-2.0", "3 cameras": ".38-.50 / 1.1-1.2", "4 cameras": ".23-.38 / 0.6-1.4"}
FRAMES, FIRST = 8, 1  # of a rig; those from the second on are scored
ALONE_RAD = np.radians(6.0)  # two lamps with 4 degrees between their rims, of 1 degree each, on a map of a degree a cell
WALL_M = 0.1  # from a wall, within which a point is light that the wall sends back: a lamp is two or three radii from it
FALSE_SHARE = 0.01  # of the lamps' irradiance at the centre, above which a point that is no lamp counts
SAME = 0.1  # of the distance, within which a point stands for a lamp
TURNS = [quaternion_xyz((3.0, -2.0 * k, 80.0 * k)) for k in range(4)]  # of cameras as somebody sets them up


class Score(NamedTuple):
    """Of one rig in one room; lists over lamps and frames."""

    place: list[float]  # error relative to the distance
    intensity: list[float]
    over_sigma: list[float]
    alone: list[bool]  # no other lamp within ALONE_RAD
    missed: float  # lamps a frame
    false: float  # points a frame
    patches: float  # of them no lamps but lit walls, which are not counted as false
    changed_ids: int
    map_error: float  # irradiance 1 m away, relative RMSE
    point_error: float
    cpu_ms: float


def score(room: Room, places: np.ndarray, seed: int, error: float = 1.0) -> Score:
    """One rig in one room over FRAMES frames of noise. error: of the poses, in units of what the rig declares."""
    rng = np.random.default_rng(seed)
    rig = rig_of(places)
    still = maps_of(room, rig, rng, error)
    state, found = FuseState.start(rig), Score([], [], [], [], 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0)
    missed, false, patches, changed, ids, cpu = 0, 0, 0, 0, dict[int, int](), []
    ways = np.array([(lamp.at - rig.centre) / np.linalg.norm(lamp.at - rig.centre) for lamp in room.lamps])
    alone = (ways @ ways.T > np.cos(ALONE_RAD)).sum(axis=1) == 1
    frames = FRAMES - FIRST
    for k in range(FRAMES):
        maps = [noisy(each, rng) for each in still]
        start = time.process_time()
        state, rest, points, _ = fuse_step(state, maps)
        cpu.append(1e3 * (time.process_time() - start))
        if k < FIRST:
            continue
        pairs, others = matched(room.lamps, points, rig.centre)
        missed += len(room.lamps) - len(pairs)
        total = sum(luminance_from_rgb(lamp.intensity_to(rig.centre)) / np.sum((lamp.at - rig.centre) ** 2) for lamp in room.lamps)
        strong = others & (luminance_from_rgb(points.irradiance_at(rig.centre)) > FALSE_SHARE * total)
        on_wall = is_on_wall(room, points.at)
        false, patches = false + int(np.count_nonzero(strong & ~on_wall)), patches + int(np.count_nonzero(strong & on_wall))
        for lamp, point in pairs.items():
            off = float(np.linalg.norm(points.at[point] - room.lamps[lamp].at))
            found.place.append(off / float(np.linalg.norm(room.lamps[lamp].at - rig.centre)))
            found.over_sigma.append(off / float(points.sigma[point]))
            found.alone.append(bool(alone[lamp]))
            true = luminance_from_rgb(room.lamps[lamp].intensity_to(rig.centre))
            found.intensity.append(abs(float(luminance_from_rgb(points.intensity[point]) / true) - 1))
            changed += lamp in ids and ids[lamp] != points.ids[point]
            ids[lamp] = int(points.ids[point])
    map_error, point_error = irradiance_errors(room, rig.centre, still[0], rest, points)
    found = found._replace(missed=missed / frames, false=false / frames, patches=patches / frames, changed_ids=changed)
    return found._replace(map_error=map_error, point_error=point_error, cpu_ms=float(np.median(cpu)))


def matched(lamps: Sequence[Lamp], points: NearLightSet, centre: np.ndarray) -> tuple[dict[int, int], np.ndarray]:
    """The point of each lamp that has one, and the points that are no lamp's."""
    pairs, others = dict[int, int](), np.ones(len(points.ids), bool)
    off = np.array([np.linalg.norm(points.at - lamp.at, axis=1) / np.linalg.norm(lamp.at - centre) for lamp in lamps])
    while off.size and off.min() < SAME:
        lamp, point = np.unravel_index(int(np.argmin(off)), off.shape)
        pairs[int(lamp)], others[point] = int(point), False
        off[lamp], off[:, point] = np.inf, np.inf
    return pairs, others


def is_on_wall(room: Room, places: np.ndarray) -> np.ndarray:
    """Which places (n, 3) are on a wall of the room."""
    low, high = np.array([-room.size[0] / 2, -room.size[1] / 2, 0.0]), np.array([room.size[0] / 2, room.size[1] / 2, room.size[2]])
    return np.minimum(np.abs(places - low), np.abs(places - high)).min(axis=1, initial=np.inf) < WALL_M


def irradiance_errors(
    room: Room, centre: np.ndarray, first: EnvironmentMap, rest: EnvironmentMap, points: NearLightSet
) -> tuple[float, float]:
    """Relative RMSE over normals above the horizon, a metre from the centre, of the first camera's map and of the rest with the points."""
    normals = cell_directions(8, 8, "hemisphere").reshape(-1, 3)
    errors = np.zeros(2)
    for angle in (0.3, 2.4, 4.5):
        place = centre + np.array([np.cos(angle), np.sin(angle), 0.0])
        truth = irradiance(room_map(room, place), normals)
        away = points.at - place
        distance = np.maximum(np.linalg.norm(away, axis=1), np.maximum(points.radius, 1e-3))
        cosines = np.maximum(normals @ away.T, 0) / distance
        near = (cosines * (points.at[:, 2] > place[2])) @ (luminance_from_rgb(points.intensity) / distance**2)
        for n, given in enumerate((irradiance(first, normals), irradiance(rest, normals) + near)):
            errors[n] += np.mean((given - truth) ** 2) / np.mean(truth**2)
    return float(np.sqrt(errors[0] / 3)), float(np.sqrt(errors[1] / 3))


def irradiance(seen: EnvironmentMap, normals: np.ndarray) -> np.ndarray:
    """Luminous irradiance (n,) of surfaces with normals (n, 3) under a map."""
    rows, cols, _ = seen.radiance.shape
    light = luminance_from_rgb(seen.radiance.astype(np.float64)) * cell_solid_angles(rows, cols, seen.coverage)[:, None]
    return np.maximum(normals @ cell_directions(rows, cols, seen.coverage).reshape(-1, 3).T, 0) @ light.ravel()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="?", choices=("tuned", "kept", "speed"), default="tuned")
    parser.add_argument("--seeds", default="0:20")
    parser.add_argument("--each", action="store_true", help="a line a room, too")
    options = parser.parse_args()
    if options.rooms == "speed":
        print(f"cameras level and alike: {speed(rig_of(SQUARE))}", flush=True)
        print(f"turned and tilted:       {speed(rig_of(SQUARE, TURNS))}")
        return
    first, last = map(int, options.seeds.split(":"))
    make = kept_room if options.rooms == "kept" else random_room
    print("| rig | lamps | place median / p90, % (trial) | intensity median / p90, % "
          "| error / sigma, alone (all) | missed, false, patches a frame | ids changed | irradiance 1 m away, % | ms |")  # fmt: skip
    print("|---" * 9 + "|")
    for name, places in RIGS.items():
        scores = []
        for seed in range(first, last):
            scores.append(score(make(seed), places, seed))
            if options.each:
                print(f"| {name} {seed} {_row(scores[-1:])}")
        print(f"| {name} {_row(scores, TRIAL[name])}", flush=True)


def _row(scores: Sequence[Score], trial: str = "") -> str:
    place, intensity, sigmas = (np.concatenate([getattr(each, name) for each in scores]) for name in ("place", "intensity", "over_sigma"))
    alone = np.concatenate([each.alone for each in scores]).astype(bool)
    if not len(place):
        return f"| 0 | - | - | - | {_counts(scores)} | - | - | - |"
    before, after = (float(np.sqrt(np.mean([getattr(s, of) ** 2 for s in scores]))) for of in ("map_error", "point_error"))
    return (
        f"| {len(place) // (FRAMES - FIRST)} | {100 * np.median(place):.2f} / {100 * np.quantile(place, 0.9):.2f} ({trial}) "
        f"| {100 * np.median(intensity):.1f} / {100 * np.quantile(intensity, 0.9):.1f} "
        f"| {np.sqrt(np.mean(sigmas[alone] ** 2)):.2f} ({np.sqrt(np.mean(sigmas**2)):.2f}) | {_counts(scores)} "
        f"| {sum(s.changed_ids for s in scores)} "
        f"| {100 * before:.1f} -> {100 * after:.1f} ({after / before:.2f} x) | {np.median([s.cpu_ms for s in scores]):.1f} |"
    )


def speed(rig: CameraRig, steps: int = 300) -> str:
    """Median and p99 of a step of four cameras that see twelve lamps of one colour, in a line."""
    rng = np.random.default_rng(1)
    ways: list[np.ndarray] = []
    while len(ways) < 12:
        way = np.abs(rng.standard_normal(3)) * (*rng.choice([-1, 1], 2), 0.6) + (0, 0, 0.25)
        if all(way @ other < np.cos(np.radians(12)) * np.linalg.norm(way) for other in ways):
            ways.append(way / np.linalg.norm(way))
    bulbs = [Bulb((float(x), float(y), float(z))) for x, y, z in (rig.centre + rng.uniform(2, 4) * way for way in ways)]
    still = lamp_maps(bulbs, rig, rng)
    moments = [[noisy(each, rng) for each in still] for _ in range(8)]
    state, wall, cpu, report = FuseState.start(rig), [], [], None
    for k in range(steps):
        started, used = time.perf_counter(), time.process_time()
        state, _, _, report = fuse_step(state, moments[k % 8])
        wall.append(1e3 * (time.perf_counter() - started))
        cpu.append(1e3 * (time.process_time() - used))
    assert report is not None
    figures = [f"{name} {np.median(ms):.1f} ms, p99 {np.quantile(ms, 0.99):.1f} ms" for name, ms in (("wall", wall[5:]), ("CPU", cpu[5:]))]
    return f"{report.sources} sources, {report.located} located: {'; '.join(figures)}; load {os.getloadavg()[0]:.1f}"


def _counts(scores: Sequence[Score]) -> str:
    return ", ".join(f"{np.mean(of):.3f}" for of in ([s.missed for s in scores], [s.false for s in scores], [s.patches for s in scores]))


if __name__ == "__main__":
    main()
