"""A still life 1 m from four cameras in a room with lamps: pictures under near lights, under directional ones alone, and the truth.

    python -m bench.near_pictures [tuned|kept] [--out FOLDER] [--rooms N] [--first SEED] [--figure SEED]

Rooms are those of tests/support/analytic_rooms.py, made anew from each seed, with two to seven lamps, spheres and panels; `kept` ones are
of another kind, on which nothing was tuned. The cameras' maps have 2 % noise a cell and pose errors as their rig file declares; `fuse_step`
makes near lights and the rest of the map of them, after FRAMES frames, and the sampler soft lights of that rest. `named` is the same with
each panel named as a measured lamp, whose file says that it shines by Lambert's law. Directional lights alone are made of the first
camera's map, and of the map at the rig's centre, exact and without noise. The truth is traced: each pixel's surface sees lamps with their
extent at their places, and the walls from where it is, with the still life's own shadows; light comes from above the horizon, as the
cameras see it. Nothing is glossy, and surfaces of the still life do not light each other.

Prints relative RMSE of radiance for each room and ratios, and writes OUT/near_KIND_SEED.png: truth, the centre's map, near lights, named
ones. With --figure it writes OUT/near.png alone: lamps where the cameras see them, and the pictures, for docs/several-cameras.md.
"""

import argparse
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.hard_scenes import ball, box, made, together
from tests.support.analytic_rooms import SQUARE, Lamp, Room, kept_room, maps_of, noisy, radiance_along, random_room, rig_of, room_map
from tests.support.ray_casting import Hits, Tree, first_hits, rays_leave, scene_tree
from vemlight.fuse.fusing import FuseState, fuse_step
from vemlight.fuse.rig_file import CameraRig, RigCamera
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.extent import tangents
from vemlight.light.images import write_png
from vemlight.light.light_set import LightSet
from vemlight.light.measured_lamp import MeasuredLamp
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.measured_lamps import lit_by_lamps, recognised, with_measured_lamps
from vemlight.renderer.scene.scene import Scene
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Renderer as Settings
from vemlight.settings import Sampler

WIDTH, HEIGHT = 96, 72  # of the pictures that are judged
FRAMES = 6  # of the rig: near lights are published from the second on
LAMP_RAYS, WALL_RAYS = 3, 6  # a side: 9 to each lamp, 36 over the hemisphere, in strata, twice
AWAY_M = 1.0  # of the still life from the nearest camera
MARGIN_M, CLEAR_M = 0.65, 1.0  # of the still life from walls and boxes, and from lamps
SETTLED = 8  # frames in which lights find their places on a still map
VIEW = 320  # pixels of a camera's view in the figure
ROOMS = {"tuned": random_room, "kept": kept_room}


class Errors(NamedTuple):
    """Relative RMSE of one room's pictures."""

    near: float
    named: float
    centre: float
    first_camera: float


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


def truth(room: Room, scene: Scene, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """The picture, twice, with noise that is independent, (2, height, width, 3)."""
    tree = scene_tree(scene)
    hits = first_hits(scene, tree, *size)
    sizes = [len(mesh.geometry.triangles) for mesh in scene.meshes]
    albedo = np.array([mesh.material.diffuse for mesh in scene.meshes])[np.repeat(np.arange(len(sizes)), sizes)[hits.triangle]]  # type: ignore[union-attr]
    return np.array([albedo / math.pi * true_irradiance(room, tree, hits, rng) for _ in range(2)])


def relative_rmse(picture: np.ndarray, exact: np.ndarray) -> float:
    """Over the root mean square of what is exact. The product of the differences to both truths has nothing of their noise on average."""
    square = np.mean((picture - exact[0]) * (picture - exact[1])) / np.mean(exact[0] * exact[1])
    return math.sqrt(max(float(square), 0.0))


def soft_lights(seen: EnvironmentMap) -> LightSet:
    """What the sampler makes of a still map by default."""
    state, lights = initial_state(), LightSet.none()
    for k in range(SETTLED):
        state, lights, _ = step(Sampler(filter="none"), state, SamplerInput(seen.radiance, seen.coverage, k / 25, seen.bright_cells))
    return lights


def rendered(scene: Scene, size: tuple[int, int], lights: LightSet, near: NearLightSet, lamps: tuple[MeasuredLamp, ...] = ()) -> np.ndarray:
    """The renderer's picture (height, width, 3), with all rays, at pixel centres, without a bounce."""
    scene = with_measured_lamps(scene, lamps)
    sequence = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1], bounces=0)))
    pose = sequence.renderer.setup.rest
    if lamps:
        found = recognised(scene.luminaires, [lamp.within_m for lamp in lamps], near, SQUARE.mean(axis=0))
        near, pose = found.near, lit_by_lamps(pose, scene, found.colours)
    picture = sequence.render(lights, pose=pose, near=near)[..., :3].astype(np.float64)
    sequence.release()
    return picture


def named_panels(room: Room, folder: Path) -> tuple[MeasuredLamp, ...]:
    """The panels of a room as the settings would name them, with a file that has the cosine of Lambert's law."""
    angles = np.arange(0, 91, 5)
    angle, candela = (" ".join(f"{value:.4f}" for value in values) for values in (angles, 1000 * np.cos(np.radians(angles))))
    text = f"IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 {len(angles)} 1 1 2 0 0 0\n1 1 100\n{angle}\n0\n{candela}\n"
    (folder / "lambert.ies").write_text(text)
    lamps = []
    for lamp in room.lamps:
        if lamp.normal is not None:
            x, y, z = lamp.normal.tolist()
            rotate = (0.0, math.degrees(math.acos(z)), math.degrees(math.atan2(y, x)))
            at = (float(lamp.at[0]), float(lamp.at[1]), float(lamp.at[2]))
            lamps.append(MeasuredLamp(file=str(folder / "lambert.ies"), at=at, rotate=rotate))
    return tuple(lamps)


class Trial(NamedTuple):
    """One room with what was located in it. pictures: truth, centre's map, near, named. line: about the room."""

    room: Room
    rig: CameraRig
    near: NearLightSet
    errors: Errors
    pictures: list[np.ndarray]
    line: str


def trial(room: Room, seed: int, size: tuple[int, int], folder: Path) -> Trial | None:
    """None where the room has no place for the still life."""
    rng = np.random.default_rng(10_000 + seed)
    place = subject_place(room, rng)
    if place is None:
        return None
    rig = rig_of(SQUARE)
    scene = still_life(place, rng)
    seen = maps_of(room, rig, rng)
    state = FuseState.start(rig)
    for _ in range(FRAMES):
        state, rest, near, _ = fuse_step(state, [noisy(each, rng) for each in seen])
    exact, none, around = truth(room, scene, size, rng), NearLightSet.empty(), soft_lights(rest)
    made_of = {
        "near": rendered(scene, size, around, near),
        "named": rendered(scene, size, around, near, named_panels(room, folder)),
        "centre": rendered(scene, size, soft_lights(room_map(room, rig.centre)), none),
        "first_camera": rendered(scene, size, soft_lights(seen[0]), none),
    }
    errors = Errors(**{name: relative_rmse(picture, exact) for name, picture in made_of.items()})
    panels = sum(lamp.half is not None for lamp in room.lamps)
    line = f"{len(room.lamps)} lamps, {panels} of them panels, {len(near.ids)} located; still life at {np.round(place, 2).tolist()}"
    return Trial(room, rig, near, errors, [exact.mean(axis=0), made_of["centre"], made_of["near"], made_of["named"]], line)


def as_shown(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """Pictures as a screen shows them, uint8; what is brighter than all but a hundredth of the first's shining pixels is white."""
    lit = pictures[0][pictures[0].any(axis=-1)]
    white = max(float(np.percentile(lit, 99)), 1e-12)
    codes = []
    for picture in pictures:
        signal = np.clip(picture / white, 0, 1)
        codes.append(np.round(255 * np.where(signal < 0.0031308, 12.92 * signal, 1.055 * signal ** (1 / 2.4) - 0.055)).astype(np.uint8))
    return codes


def camera_view(room: Room, camera: RigCamera) -> np.ndarray:
    """What an equidistant fisheye of 180 degrees sees, (VIEW, VIEW, 3), linear; its axis is the picture's middle."""
    across = (2 * np.arange(VIEW) + 1) / VIEW - 1
    x, y = np.meshgrid(across, -across)
    radius = np.hypot(x, y)
    inside = radius < 1
    theta, phi = radius[inside] * math.pi / 2, np.arctan2(y, x)[inside]
    local = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    view = np.zeros((VIEW, VIEW, 3))
    view[inside] = radiance_along(room, np.asarray(camera.at), local @ camera.world_from_camera.T)
    return view


def figure(made_of: Trial, path: Path) -> None:
    """Writes what the cameras see with the located lamps on it, and under it the pictures of the still life."""
    from matplotlib.figure import Figure
    from matplotlib.patheffects import withStroke

    outlined = [withStroke(linewidth=2, foreground="black")]
    drawing = Figure(figsize=(12, 6.6), dpi=100, layout="constrained")
    grid = drawing.add_gridspec(2, 1, height_ratios=(1.2, 1.0))
    top, bottom = (drawing.add_subfigure(grid[k]) for k in range(2))
    views = [camera_view(made_of.room, camera) for camera in made_of.rig.camera]
    white = np.percentile(views[0][views[0].any(axis=-1)], 98)
    shown = as_shown([np.full((1, 1, 3), white), *views])[1:]
    for axes, view, camera in zip(top.subplots(1, len(views)), shown, made_of.rig.camera, strict=True):
        axes.imshow(view)
        local = (made_of.near.at - np.asarray(camera.at)) @ camera.world_from_camera
        away = np.linalg.norm(local, axis=1)
        radius = np.arccos(local[:, 2] / away) / (math.pi / 2)
        turn = np.arctan2(local[:, 1], local[:, 0])
        column, row = (VIEW / 2 * (1 + radius * np.cos(turn)), VIEW / 2 * (1 - radius * np.sin(turn)))
        axes.plot(column, row, "D", ms=11, mfc="none", mec="#00e5ff", mew=1.4)
        for x, y, metres in zip(column, row, away, strict=True):
            text = axes.annotate(f"{metres:.2f} m", (x, y), (0, -17), "data", "offset points", color="#00e5ff", ha="center", fontsize=9)
            text.set_path_effects(outlined)
        axes.set_title(f"camera {camera.name}", fontsize=10)
        axes.axis("off")
    errors = (None, made_of.errors.centre, made_of.errors.near)
    names = ("exact, lamps at their places", "directional lights alone", "near lights as located, and the rest")
    for axes, picture, name, error in zip(bottom.subplots(1, 3), as_shown(made_of.pictures[:3]), names, errors, strict=True):
        axes.imshow(picture, interpolation="nearest")
        axes.set_title(name if error is None else f"{name}: RMSE {100 * error:.0f} %", fontsize=10)
        axes.axis("off")
    drawing.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=ROOMS, nargs="?", default="tuned")
    parser.add_argument("--out", type=Path, default=Path("near-pictures"))
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="seed of the first room")
    parser.add_argument("--size", type=int, nargs=2, default=(WIDTH, HEIGHT), help="width and height in pixels")
    parser.add_argument("--figure", type=int, metavar="SEED", help="draw that room alone")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    every: list[Errors] = []
    first, rooms = (options.first, options.rooms) if options.figure is None else (options.figure, 1)
    for seed in range(first, first + rooms):
        made_here = trial(ROOMS[options.kind](seed), seed, tuple(options.size), options.out)
        if made_here is None:
            print(f"room {seed}: no place 1 m from the cameras")
            continue
        errors = made_here.errors
        every.append(errors)
        print(f"room {seed}: {made_here.line}; {table_line(errors)}", flush=True)
        if options.figure is None:
            write_png(options.out / f"near_{options.kind}_{seed}.png", np.concatenate(as_shown(made_here.pictures), axis=1))
        else:
            figure(made_here, options.out / "near.png")
    if every:
        print(f"geometric means of {len(every)} {options.kind} rooms: {table_line(Errors(*np.exp(np.mean(np.log(every), axis=0))))}")


def table_line(errors: Errors) -> str:
    """Errors, and ratios to those of directional lights."""
    first, centre = ([each / of for each in (errors.near, errors.named)] for of in (errors.first_camera, errors.centre))
    own = ", ".join(f"{name.replace('_', ' ')} {error:.3f}" for name, error in errors._asdict().items())
    return f"{own}; over the first camera's {first[0]:.2f} and {first[1]:.2f}, over the centre's {centre[0]:.2f} and {centre[1]:.2f}"


if __name__ == "__main__":
    main()
