"""A still life 1 m from four cameras in a room with lamps: pictures under near lights, under directional ones alone, and the truth.

    python -m bench.near_pictures [--out FOLDER] [--rooms N] [--first SEED]

Rooms are those of tests/support/analytic_rooms.py, made anew from each seed: three to six lamps, spheres and panels. The cameras' maps
have 2 % noise a cell and pose errors as their rig file declares; `fuse_step` makes near lights and the rest of the map of them, after
FRAMES frames, and the sampler soft lights of that rest. Directional lights alone are made of the map at the rig's centre, exact and without
noise, and of the first camera's map. The truth is traced: each pixel's surface sees lamps with their extent at their places, and the walls
from where it is, with the still life's own shadows; light comes from above the horizon, as the cameras see it. Nothing is glossy, and
surfaces of the still life do not light each other.

Prints relative RMSE of radiance for each room and ratios, and writes OUT/near_SEED.png: truth, near lights, the centre's map.
"""

import argparse
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.hard_scenes import ball, box, made, together
from tests.support.analytic_rooms import SQUARE, Lamp, Room, maps_of, noisy, radiance_along, random_room, rig_of, room_map
from tests.support.ray_casting import Hits, Tree, first_hits, rays_leave, scene_tree
from vemlight.fuse.fusing import FuseState, fuse_step
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.extent import tangents
from vemlight.light.images import write_png
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import Scene
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Renderer as Settings
from vemlight.settings import Sampler

WIDTH, HEIGHT = 96, 72  # of the pictures that are judged
FRAMES = 6  # of the rig: near lights are published from the second on
LAMP_RAYS, WALL_RAYS = 4, 8  # a side: 16 to each lamp, 64 over the hemisphere, in strata, twice
AWAY_M = 1.0  # of the still life from the nearest camera
MARGIN_M, CLEAR_M = 0.65, 1.0  # of the still life from walls and boxes, and from lamps
SETTLED = 8  # frames in which lights find their places on a still map


class Errors(NamedTuple):
    """Relative RMSE of one room's pictures. noise: of the truth itself, of its halves."""

    near: float
    centre: float
    first_camera: float
    noise: float


def subject_place(room: Room, rng: np.random.Generator) -> np.ndarray | None:
    """A place AWAY_M from the nearest of the cameras, in their plane; None where the room has none."""
    for _ in range(200):
        turn = rng.uniform(0, 2 * math.pi)
        for away in np.linspace(0.3, 2.5, 221):
            place = np.array([away * math.cos(turn), away * math.sin(turn), SQUARE[0, 2]])
            if np.linalg.norm(SQUARE - place, axis=1).min() >= AWAY_M:
                break
        free = np.all(np.abs(place[:2]) < room.size[:2] / 2 - MARGIN_M)
        free &= all(np.any((place < low - MARGIN_M) | (place > high + MARGIN_M)) for low, high, _ in room.boxes)
        if free and all(np.linalg.norm(place - lamp.at) > CLEAR_M + lamp.extent for lamp in room.lamps):
            return place
    return None


def still_life(place: np.ndarray, rng: np.random.Generator) -> Scene:
    """A table top with a ball, a box, a column and a leaning plate, about a place."""
    x, y, z = place
    turn = float(rng.uniform(0, 360))
    table = box((0.8, 0.8, 0.02), (x, y, z - 0.21))
    things = together([
        ball(0.1, (x - 0.12, y + 0.08, z - 0.1)), box((0.16, 0.12, 0.2), (x + 0.14, y + 0.1, z - 0.1), (0, 0, turn)),
        box((0.03, 0.03, 0.36), (x + 0.05, y - 0.16, z - 0.02)), box((0.2, 0.01, 0.2), (x - 0.17, y - 0.15, z - 0.1), (20, 0, turn / 2)),
    ])  # fmt: skip
    away = np.array([math.cos(math.radians(turn)), math.sin(math.radians(turn)), 0.55]) * 1.3
    eye = place + away
    return made((float(eye[0]), float(eye[1]), float(eye[2])), (float(x), float(y), float(z) - 0.12), 34.0, (table, 0.6), (things, 0.8))


def square_strata(rays: int, rng: np.random.Generator, count: int) -> np.ndarray:
    """Jittered points of the unit square, (count, rays^2, 2)."""
    corner = np.stack(np.meshgrid(np.arange(rays), np.arange(rays)), axis=-1).reshape(-1, 2)
    return (corner + rng.random((count, rays * rays, 2))) / rays


def to_lamp(lamp: Lamp, places: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, k, 3) to points of a lamp as places (n, 3) see it, and the solid angle that each stands for, sr, (n, k)."""
    count = points.shape[1]
    if lamp.half is not None and lamp.normal is not None:
        on = lamp.at + (2 * points[..., :1] - 1) * lamp.half[0] + (2 * points[..., 1:] - 1) * lamp.half[1]
        away = on - places[:, None]
        distance = np.linalg.norm(away, axis=-1)
        directions = away / distance[..., None]
        area = 4 * np.linalg.norm(lamp.half[0]) * np.linalg.norm(lamp.half[1]) / count
        return directions, area * np.maximum(-directions @ lamp.normal, 0) / distance**2
    away = lamp.at - places
    distance = np.linalg.norm(away, axis=1)
    axis = away / distance[:, None]
    first, second = tangents(axis)
    height = 1 - np.sqrt(1 - (lamp.radius / distance) ** 2)  # of the cap of directions
    cosine = 1 - height[:, None] * points[..., 0]
    sine, turn = np.sqrt(1 - cosine**2), 2 * math.pi * points[..., 1]
    across = np.cos(turn)[..., None] * first[:, None] + np.sin(turn)[..., None] * second[:, None]
    directions = cosine[..., None] * axis[:, None] + sine[..., None] * across
    return directions, np.broadcast_to((2 * math.pi * height / count)[:, None], cosine.shape)


def true_irradiance(room: Room, tree: Tree, hits: Hits, rng: np.random.Generator) -> np.ndarray:
    """What each pixel's surface receives of the room, (height, width, 3), with the scene's own shadows."""
    seen = hits.triangle >= 0
    places, normals = hits.position[seen], hits.smooth_normal[seen]
    origins = places + 1e-6 * hits.flat_normal[seen]
    lamps_only = room._replace(albedo=np.zeros_like(room.albedo), boxes=tuple((low, high, np.zeros(3)) for low, high, _ in room.boxes))
    light = np.zeros(places.shape)

    def add(world: Room, directions: np.ndarray, solid: np.ndarray, hidden: tuple[int, ...]) -> None:
        rays = directions.reshape(-1, 3)
        k = directions.shape[1]
        starts = np.repeat(origins, k, axis=0)
        cosine = np.einsum("nki,ni->nk", directions, normals)
        flat = np.einsum("nki,ni->nk", directions, hits.flat_normal[seen])
        weight = (solid * np.maximum(cosine, 0) * (flat > 0) * (directions[..., 2] > 0)).reshape(-1)
        wanted = np.flatnonzero(weight > 0)
        free = wanted[rays_leave(tree, starts[wanted], rays[wanted])]
        radiance = np.zeros(rays.shape)
        radiance[free] = weight[free, None] * radiance_along(world, starts[free], rays[free], hidden)
        light[:] += radiance.reshape(-1, k, 3).sum(axis=1)

    for number, lamp in enumerate(room.lamps):
        directions, solid = to_lamp(lamp, places, square_strata(LAMP_RAYS, rng, len(places)))
        add(lamps_only, directions, solid, tuple(n for n in range(len(room.lamps)) if n != number))
    first, second = tangents(normals)
    points = square_strata(WALL_RAYS, rng, len(places))
    radius, turn = np.sqrt(points[..., 0]), 2 * math.pi * points[..., 1]
    up = np.sqrt(1 - points[..., 0])
    across = np.cos(turn)[..., None] * first[:, None] + np.sin(turn)[..., None] * second[:, None]
    directions = up[..., None] * normals[:, None] + radius[..., None] * across
    add(room, directions, math.pi / np.maximum(up, 1e-9) / points.shape[1], tuple(range(len(room.lamps))))
    whole = np.zeros(hits.position.shape)
    whole[seen] = light
    return whole


def truth(room: Room, scene: Scene, size: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """The picture (height, width, 3), and its own noise: RMSE of the mean of two halves, relative."""
    tree = scene_tree(scene)
    hits = first_hits(scene, tree, *size)
    sizes = [len(mesh.geometry.triangles) for mesh in scene.meshes]
    albedo = np.array([mesh.material.diffuse for mesh in scene.meshes])[np.repeat(np.arange(len(sizes)), sizes)[hits.triangle]]  # type: ignore[union-attr]
    halves = [albedo / math.pi * true_irradiance(room, tree, hits, rng) for _ in range(2)]
    picture = (halves[0] + halves[1]) / 2
    return picture, relative_rmse((halves[0] - halves[1]) / 2 + picture, picture)


def relative_rmse(picture: np.ndarray, exact: np.ndarray) -> float:
    """Over the root mean square of what is exact."""
    return float(np.sqrt(np.mean((picture - exact) ** 2) / np.mean(exact**2)))


def soft_lights(seen: EnvironmentMap) -> LightSet:
    """What the sampler makes of a still map by default."""
    state, lights = initial_state(), LightSet.none()
    for k in range(SETTLED):
        state, lights, _ = step(Sampler(filter="none"), state, SamplerInput(seen.radiance, seen.coverage, k / 25, seen.bright_cells))
    return lights


def rendered(scene: Scene, size: tuple[int, int], lights: LightSet, near: NearLightSet) -> np.ndarray:
    """The renderer's picture (height, width, 3), with all rays, at pixel centres, without a bounce."""
    sequence = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1], bounces=0)))
    picture = sequence.render(lights, near=near)[..., :3].astype(np.float64)
    sequence.release()
    return picture


def with_spheres(room: Room) -> Room:
    """The room with a sphere in place of each panel, of its intensity towards the rig and its second moment."""
    middle = SQUARE.mean(axis=0)
    lamps = []
    for lamp in room.lamps:
        radius = lamp.radius or float(np.linalg.norm(lamp.half[0])) * math.sqrt(4 / 3)  # type: ignore[index]
        lamps.append(Lamp(lamp.at, lamp.intensity_to(middle) / (math.pi * radius**2), radius))
    return room._replace(lamps=tuple(lamps))


def pictures_of(seed: int, spheres: bool, size: tuple[int, int]) -> tuple[Errors, list[np.ndarray], str] | None:
    """Errors of a room, its pictures (truth, near, directional), and a line about it; None where it has no place for the still life."""
    room, rng = random_room(seed), np.random.default_rng(10_000 + seed)
    room = with_spheres(room) if spheres else room
    place = subject_place(room, rng)
    if place is None:
        return None
    rig = rig_of(SQUARE)
    scene = still_life(place, rng)
    seen = maps_of(room, rig, rng)
    state = FuseState.start(rig)
    for _ in range(FRAMES):
        state, rest, near, _ = fuse_step(state, [noisy(each, rng) for each in seen])
    exact, noise = truth(room, scene, size, rng)
    none = NearLightSet.empty()
    made_of = {
        "near": rendered(scene, size, soft_lights(rest), near),
        "centre": rendered(scene, size, soft_lights(room_map(room, rig.centre)), none),
        "first_camera": rendered(scene, size, soft_lights(seen[0]), none),
    }
    near_error, centre, first = (relative_rmse(picture, exact) for picture in made_of.values())
    errors = Errors(near_error, centre, first, noise)
    panels = sum(lamp.half is not None for lamp in room.lamps)
    at = np.round(place, 2).tolist()
    line = f"room {seed}: {len(room.lamps)} lamps, {panels} of them panels, {len(near.ids)} located; still life at {at}"
    return errors, [exact, made_of["near"], made_of["centre"]], line


def side_by_side(pictures: list[np.ndarray]) -> np.ndarray:
    """Pictures as a screen shows them, (height, n width, 3) uint8; what is brighter than all but a hundredth of the first is white."""
    white = max(float(np.percentile(pictures[0], 99)), 1e-12)
    signal = np.clip(np.concatenate(pictures, axis=1) / white, 0, 1)
    return np.round(255 * np.where(signal < 0.0031308, 12.92 * signal, 1.055 * signal ** (1 / 2.4) - 0.055)).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("near-pictures"))
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="seed of the first room")
    parser.add_argument("--size", type=int, nargs=2, default=(WIDTH, HEIGHT), help="width and height in pixels")
    parser.add_argument("--spheres", action="store_true", help="panels become spheres of their intensity towards the rig")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    every: list[Errors] = []
    for seed in range(options.first, options.first + options.rooms):
        made_here = pictures_of(seed, options.spheres, tuple(options.size))
        if made_here is None:
            print(f"room {seed}: no place 1 m from the cameras")
            continue
        errors, pictures, line = made_here
        every.append(errors)
        ratio = errors.near / errors.centre
        print(f"{line}; near {errors.near:.3f}, map at the centre {errors.centre:.3f} ({ratio:.2f}), "
              f"first camera's {errors.first_camera:.3f} ({errors.near / errors.first_camera:.2f}); truth's noise {errors.noise:.4f}",
              flush=True)  # fmt: skip
        write_png(options.out / f"near_{seed}.png", side_by_side(pictures))
    near, centre, first = (np.exp(np.mean(np.log([getattr(each, name) for each in every]))) for name in ("near", "centre", "first_camera"))
    print(f"geometric means of {len(every)} rooms: near {near:.3f}, centre {centre:.3f} ({near / centre:.2f}), "
          f"first camera {first:.3f} ({near / first:.2f})")  # fmt: skip


if __name__ == "__main__":
    main()
