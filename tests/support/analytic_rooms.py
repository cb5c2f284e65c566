"""Rooms whose light is known: Lambertian walls and boxes lit by spheres and panels, as cameras see them in polar maps.

A room is a box around the world's origin with its floor at z = 0. Walls get the lamps' direct light, with shadows of the lamps' middles,
and an even rest. Lamps and their images in a mirror are sampled finely, so that a map's flux is right to 1e-3.
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.fuse.rig_file import CameraRig, RigCamera
from vemlight.light.bright_cells import bright_cells_from_light
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import SPAN, Coverage, cell_directions, cell_solid_angles, direction_from_angles, quaternion_xyz

COARSE, FINE = 2, 13  # samples on a side of a cell, and of one near a lamp
NEAR_RAD = math.radians(2.0)  # around a lamp
BRIGHT_FRACTION, MAX_BRIGHT_CELLS = 1 / 500, 64  # as capture makes them
FAR = 1e9
TILE_M = 0.4  # of a textured wall


class Lamp(NamedTuple):
    """A sphere of `radius`, or a panel that shines to the side of `normal` with half axes `half` (2, 3). radiance: (3,)."""

    at: np.ndarray
    radiance: np.ndarray
    radius: float = 0.0
    normal: np.ndarray | None = None
    half: np.ndarray | None = None

    @property
    def extent(self) -> float:
        """Distance of its farthest point from its middle, m."""
        return self.radius if self.half is None else float(np.sqrt((self.half**2).sum()))

    def intensity_to(self, place: np.ndarray) -> np.ndarray:
        """RGB W/sr towards a place or places (..., 3)."""
        if self.half is None or self.normal is None:
            return np.broadcast_to(math.pi * self.radius**2 * self.radiance, (*np.shape(place)[:-1], 3))
        away = np.asarray(place) - self.at
        cosine = np.maximum(away @ self.normal, 0) / np.linalg.norm(away, axis=-1)
        area = 4 * np.linalg.norm(self.half[0]) * np.linalg.norm(self.half[1])
        return area * cosine[..., None] * self.radiance


class Room(NamedTuple):
    """size: (3,) m. albedo: (6, 3) of the walls -x, x, -y, y, floor, ceiling. boxes: (low, high, albedo). ambient: radiance of the even
    rest at albedo 1. mirror: part of the wall +x that mirrors, (y0, z0, y1, z1, reflectance), or None. texture: standard deviation of ln
    albedo from one tile of TILE_M to the next.
    """

    size: np.ndarray
    albedo: np.ndarray
    lamps: tuple[Lamp, ...]
    boxes: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...] = ()
    ambient: float = 0.02
    mirror: tuple[float, float, float, float, float] | None = None
    texture: float = 0.0


def sphere_lamp(at: tuple[float, float, float], candela: tuple[float, float, float] | float, radius: float = 0.04) -> Lamp:
    """A sphere with that intensity."""
    return Lamp(np.asarray(at, float), np.broadcast_to(candela, 3) / (math.pi * radius**2), radius)


def panel_lamp(at: tuple[float, float, float], towards: tuple[float, float, float], candela: float, side: float, colour=(1, 1, 1)) -> Lamp:
    """A square panel with that intensity on its axis."""
    normal = np.subtract(towards, at) / np.linalg.norm(np.subtract(towards, at))
    first = np.cross(normal, (0.0, 0.0, 1.0) if abs(normal[2]) < 0.9 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    half = np.array([first, np.cross(normal, first)]) * side / 2
    return Lamp(np.asarray(at, float), candela * np.asarray(colour, float) / side**2, 0.0, normal, half)


def room_map(
    room: Room, place: np.ndarray, turn: np.ndarray | None = None, rows: int = 90, coverage: Coverage = "hemisphere",
    lamps_seen: tuple[bool, ...] | None = None,
) -> EnvironmentMap:  # fmt: skip
    """What a camera at `place`, turned by world_from_camera (3, 3), sees, 4 columns a row of the hemisphere. lamps_seen: which lamps it
    sees; the others are hidden from it alone, as behind a pole."""
    turn = np.eye(3) if turn is None else turn
    cols = round(rows * 2 * math.pi / SPAN[coverage])
    place = np.asarray(place, float)
    hidden = () if lamps_seen is None else tuple(n for n, seen in enumerate(lamps_seen) if not seen)
    angles = SPAN[coverage] / rows, 2 * math.pi / cols
    cells = np.arange(rows * cols)
    near = _near_lamps(room, place, cell_directions(rows, cols, coverage).reshape(-1, 3) @ turn.T)
    light = np.zeros((rows * cols, 3))
    fine_directions, fine_light = np.zeros((0, 3)), np.zeros((0, 3))
    for which, samples in ((cells[~near], COARSE), (cells[near], FINE)):
        directions = directions_in(which, samples, cols, *angles)
        seen = radiance_along(room, place, directions.reshape(-1, 3) @ turn.T, hidden).reshape(*directions.shape)
        light[which] = seen.mean(axis=1)
        if samples == FINE:
            fine_directions, fine_light = directions, seen
    solid = np.repeat(cell_solid_angles(rows, cols, coverage), cols)
    power = luminance_from_rgb(light) * solid
    bright = np.flatnonzero((power > BRIGHT_FRACTION * power.sum()) & near)
    bright = np.sort(bright[np.argsort(-power[bright])][:MAX_BRIGHT_CELLS])
    place_of = np.searchsorted(cells[near], bright)
    samples = bright_cells_from_light(
        np.repeat(bright, FINE**2), fine_directions[place_of].reshape(-1, 3),
        luminance_from_rgb(fine_light[place_of]).reshape(-1), rows, cols, coverage,
    )  # fmt: skip
    return EnvironmentMap(light.reshape(rows, cols, 3).astype(np.float32), coverage, samples)


def noisy(seen: EnvironmentMap, rng: np.random.Generator, noise: float = 0.02) -> EnvironmentMap:
    """The map with noise in each cell, relative."""
    factor = np.maximum(1 + noise * rng.standard_normal(seen.radiance.shape[:2]), 0)[..., None]
    return seen._replace(radiance=(seen.radiance * factor).astype(np.float32))


def directions_in(cells: np.ndarray, samples: int, cols: int, row_angle: float, col_angle: float) -> np.ndarray:
    """Unit vectors (cells, samples^2, 3), of equal solid angle."""
    row, col = np.divmod(cells, cols)
    within = (np.arange(samples) + 0.5) / samples
    top, bottom = np.cos(row * row_angle)[:, None], np.cos((row + 1) * row_angle)[:, None]
    theta = np.arccos(np.clip(top + (bottom - top) * within, -1, 1))[:, :, None]
    phi = ((col[:, None] + within) * col_angle)[:, None, :]
    return direction_from_angles(theta, phi).reshape(len(cells), samples * samples, 3)


def _near_lamps(room: Room, place: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Which directions lie near a lamp or its image in the mirror."""
    near = np.zeros(len(directions), bool)
    for lamp in room.lamps:
        images = [lamp.at]
        if room.mirror:
            images.append(lamp.at * (-1, 1, 1) + (room.size[0], 0, 0))
        for at in images:
            away = np.linalg.norm(at - place)
            reach = math.asin(min(lamp.extent / away, 1.0)) + NEAR_RAD
            near |= directions @ ((at - place) / away) > math.cos(reach)
    return near


def radiance_along(
    room: Room, place: np.ndarray, directions: np.ndarray, hidden: tuple[int, ...] = (), mirrored: bool = False
) -> np.ndarray:
    """Radiance (n, 3) that arrives at `place` (3,) or places (n, 3) from directions (n, 3)."""
    start = np.broadcast_to(place, directions.shape)
    distance, wall = _room_walls(room, start, directions)
    light = np.zeros(directions.shape)
    normal = np.zeros(directions.shape)
    axis, sign = wall // 2, wall % 2
    normal[np.arange(len(wall)), axis] = 1.0 - 2.0 * sign
    albedo = room.albedo[wall].copy()
    for low, high, colour in room.boxes:
        enter, side = _box(start, directions, low, high)
        nearer = enter < distance
        distance = np.where(nearer, enter, distance)
        albedo[nearer], normal[nearer], wall = colour, 0.0, np.where(nearer, -1, wall)
        axis_of = np.flatnonzero(nearer), side[nearer]
        normal[axis_of] = -np.sign(directions[axis_of])
    lit = np.full(len(directions), -1)
    for n, lamp in enumerate(room.lamps):
        if n in hidden:
            continue
        hit = _lamp(lamp, start, directions)
        lit = np.where(hit < distance, n, lit)
        distance = np.minimum(distance, hit)
    hit = start + directions * distance[:, None]
    dark = lit < 0
    light[dark] = _reflected(room, hit[dark], normal[dark], albedo[dark])
    for n, lamp in enumerate(room.lamps):
        light[lit == n] = lamp.radiance
    if room.mirror and not mirrored:
        y0, z0, y1, z1, reflectance = room.mirror
        inside = dark & (wall == 1) & (hit[:, 1] > y0) & (hit[:, 1] < y1) & (hit[:, 2] > z0) & (hit[:, 2] < z1)
        bent = directions[inside] * (-1, 1, 1)
        light[inside] = reflectance * radiance_along(room, hit[inside] + 1e-6 * bent, bent, hidden, True)
    return light


def _room_walls(room: Room, start: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the room's walls and which is met."""
    low, high = np.array([-room.size[0] / 2, -room.size[1] / 2, 0.0]), np.array([room.size[0] / 2, room.size[1] / 2, room.size[2]])
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.where(directions > 0, (high - start) / directions, np.where(directions < 0, (low - start) / directions, FAR))
    axis = np.argmin(ahead, axis=1)
    row = np.arange(len(axis))
    return ahead[row, axis], 2 * axis + (directions[row, axis] > 0)


def _box(start: np.ndarray, directions: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to a box, FAR where it is missed, and the axis of the side that is met."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / directions, (high - start) / directions
    enter, leave = np.fmin(a, b), np.fmax(a, b)
    side = np.argmax(enter, axis=1)
    first, last = enter.max(axis=1), leave.min(axis=1)
    return np.where((first < last) & (first > 1e-6), first, FAR), side


def _lamp(lamp: Lamp, start: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distance to a lamp's shining surface, FAR where it is missed."""
    to = lamp.at - start
    if lamp.half is None or lamp.normal is None:
        along = np.einsum("ij,ij->i", to, directions)
        gap = np.einsum("ij,ij->i", to, to) - along**2
        inside = (gap < lamp.radius**2) & (along > 0)
        return np.where(inside, along - np.sqrt(np.maximum(lamp.radius**2 - gap, 0)), FAR)
    facing = directions @ lamp.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (to @ lamp.normal) / facing
    hit = start + directions * distance[:, None] - lamp.at
    inside = (facing < 0) & (distance > 1e-6)
    for half in lamp.half:
        inside &= np.abs(hit @ half) < half @ half
    return np.where(inside, distance, FAR)


def _reflected(room: Room, places: np.ndarray, normals: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """Radiance of Lambertian surfaces at places (n, 3)."""
    light = np.full(places.shape, room.ambient)
    for lamp in room.lamps:
        to = lamp.at - places
        away = np.maximum(np.linalg.norm(to, axis=1), max(lamp.extent, 1e-3))
        cosine = np.maximum(np.einsum("ij,ij->i", to, normals), 0) / away
        seen = np.ones(len(places))
        for low, high, _ in room.boxes:
            distance, _ = _box(places + 1e-4 * normals, to / away[:, None], low, high)
            seen = np.where(distance < away, 0.0, seen)
        light += (seen * cosine / (math.pi * away**2))[:, None] * lamp.intensity_to(places)
    if room.texture:
        tile = np.floor((places + 100.0) / TILE_M - 1e-6).astype(np.uint64) @ np.array([73856093, 19349663, 83492791], np.uint64)
        even = ((tile * np.uint64(2654435761) >> np.uint64(8)) % np.uint64(65536) + 0.5) / 65536
        albedo = np.minimum(albedo * np.exp(room.texture * math.sqrt(12) * (even - 0.5))[:, None], 0.95)
    return albedo * light


def turned(turn: np.ndarray, rng: np.random.Generator, deg: float) -> np.ndarray:
    """world_from_camera with an error of `deg` about each axis."""
    x, y, z = np.radians(deg) * rng.standard_normal(3)
    small = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    u, _, v = np.linalg.svd(np.eye(3) + small + small @ small / 2)
    return u @ v @ turn


def rig_of(
    places: np.ndarray, turns: list[tuple[float, float, float, float]] | None = None, pose_deg: float = 0.05, pose_m: float = 0.002
) -> CameraRig:
    """A rig of cameras a, b, c, ... at places (n, 3)."""
    cameras = tuple(
        RigCamera(name="abcdefghijklmnop"[n], source=".", at=(x, y, z), turn=turns[n] if turns else (0.0, 0.0, 0.0, 1.0))
        for n, (x, y, z) in enumerate(np.asarray(places, np.float64).tolist())
    )
    return CameraRig(pose_deg=pose_deg, pose_m=pose_m, camera=cameras)


def maps_of(room: Room, rig: CameraRig, rng: np.random.Generator, error: float = 1.0, **seen) -> list[EnvironmentMap]:
    """What the rig's cameras see when their poses are wrong by `error` times what it declares; without noise."""
    return [
        room_map(
            room, np.asarray(camera.at) + error * rig.pose_m * rng.standard_normal(3),
            turned(camera.world_from_camera, rng, error * rig.pose_deg), **seen,
        )
        for camera in rig.camera
    ]  # fmt: skip


SQUARE = np.array([[-0.5, -0.5, 1.1], [0.5, -0.5, 1.1], [0.5, 0.5, 1.1], [-0.5, 0.5, 1.1]])
TRIANGLE = np.array([[-0.5, -0.289, 1.1], [0.5, -0.289, 1.1], [0.0, 0.577, 1.1]])
PAIR = np.array([[-0.5, 0.0, 1.1], [0.5, 0.0, 1.1]])


def random_room(seed: int) -> Room:
    """A room of 4 to 8 m with three to six lamps above the cameras, some of them panels, and a box or two."""
    rng = np.random.default_rng(seed)
    size = np.array([*rng.uniform(4, 8, 2), rng.uniform(2.6, 3.6)])
    albedo = np.clip(rng.uniform(0.25, 0.75, (6, 1)) * rng.uniform(0.8, 1.2, (6, 3)), 0, 0.9)
    lamps: list[Lamp] = []
    wanted = int(rng.integers(3, 7))
    while len(lamps) < wanted:
        at = np.array([*(rng.uniform(-0.46, 0.46, 2) * size[:2]), rng.uniform(1.4, size[2] - 0.15)])
        away = np.linalg.norm(at - (0, 0, 1.1))
        if away < 1.2 or any(np.linalg.norm(at - lamp.at) < 0.5 for lamp in lamps):
            continue
        colour = rng.uniform(0.6, 1.0, 3)
        strength = 10 ** rng.uniform(-0.3, 0.3)
        if rng.random() < 0.3:
            lamps.append(panel_lamp(tuple(at), (0, 0, 1.1), strength, float(rng.uniform(0.1, 0.4)), tuple(colour)))
        else:
            lamps.append(sphere_lamp(tuple(at), tuple(strength * colour), float(rng.uniform(0.02, 0.1))))
    boxes = []
    for _ in range(int(rng.integers(0, 3))):
        corner = np.array([*rng.uniform(-0.4, 0.4, 2) * size[:2], 0.0])
        if np.linalg.norm(corner[:2]) > 1.5:
            boxes.append((corner, corner + rng.uniform(0.3, 0.9, 3) * (1, 1, 2), rng.uniform(0.2, 0.7, 3)))
    return Room(size, albedo, tuple(lamps), tuple(boxes), float(rng.uniform(0.01, 0.05)))


def kept_room(seed: int) -> Room:
    """A room of another kind, on which nothing is tuned: long or high, darker or lighter walls, lamps in a row or around a table, warm and
    cold ones, one much stronger than the others.
    """
    rng = np.random.default_rng(90_000 + seed)
    size = np.array([rng.uniform(5, 11), rng.uniform(4, 7), rng.uniform(2.8, 4.5)])
    albedo = np.clip(rng.uniform(0.1, 0.85, (6, 1)) * rng.uniform(0.85, 1.15, (6, 3)), 0, 0.9)
    count, lamps = int(rng.integers(2, 8)), list[Lamp]()
    row = rng.random() < 0.5
    spots = [
        (size[0] * ((n + 0.5) / count - 0.5) * 0.9, rng.uniform(-0.4, 0.4) * size[1]) if row
        else (rng.uniform(1.3, 2.1) * math.cos(6.28 * (n + 0.3) / count), rng.uniform(1.3, 1.9) * math.sin(6.28 * (n + 0.3) / count))
        for n in range(count)
    ]  # fmt: skip
    for n, (x, y) in enumerate(spots):
        at = (float(x), float(np.clip(y, -0.46 * size[1], 0.46 * size[1])), float(rng.uniform(1.5, size[2] - 0.2)))
        if np.linalg.norm(np.subtract(at, (0, 0, 1.1))) < 1.0:
            continue
        warm = rng.uniform(0, 1)
        colour = np.array([1.0, 0.7 + 0.25 * warm, 0.4 + 0.6 * warm])
        strength = 10 ** rng.uniform(-0.4, 0.4) * (4 if n == 0 else 1)
        if rng.random() < 0.35:
            lamps.append(panel_lamp(at, (0, 0, 1.1), strength, float(rng.uniform(0.15, 0.5)), tuple(colour)))
        else:
            lamps.append(sphere_lamp(at, tuple(strength * colour), float(rng.uniform(0.015, 0.12))))
    low = np.array([rng.uniform(1.6, 2.0), rng.uniform(-1.5, 0.5), 0.0])
    boxes = ((low, low + rng.uniform(0.4, 1.0, 3) * (1, 1, 1.5), rng.uniform(0.1, 0.8, 3)),)
    return Room(size, albedo, tuple(lamps), boxes, float(rng.uniform(0.005, 0.08)))


class WideRig(NamedTuple):
    """Places (n, 3) and turns (n quaternions) of cameras that stand 0.25 to 4 m apart."""

    places: np.ndarray
    turns: list[tuple[float, float, float, float]]


def wide_room(seed: int) -> tuple[Room, WideRig]:
    """A large room that each camera of its rig, of 2 to 6 on the floor, a wall or the ceiling, sees otherwise: textured walls, lamps a
    hand's breadth from them, panels that face anywhere into the room, and pillars that hide lamps from some.
    """
    rng = np.random.default_rng(50_000 + seed)
    size = np.array([rng.uniform(6, 12), rng.uniform(5, 9), rng.uniform(2.8, 4.5)])
    half = size[:2] / 2
    albedo = np.clip(rng.uniform(0.2, 0.8, (6, 1)) * rng.uniform(0.85, 1.15, (6, 3)), 0, 0.9)
    kind, apart = rng.choice(["floor", "wall", "ceiling"], p=[0.5, 0.3, 0.2]), float(rng.uniform(0.5, 4))
    count = int(rng.integers(2, 7))
    centre = {"floor": (0.0, 0.0, 1.0), "wall": (0.0, -half[1] + 0.4, 1.6), "ceiling": (0.0, 0.0, size[2] - 0.3)}[str(kind)]
    along = np.linspace(-0.5, 0.5, count) * max(count - 1, 1) ** 0.5
    places = np.array(centre) + apart * np.stack([along, 0.4 * rng.uniform(-1, 1, count) * (kind != "wall"), 0 * along], axis=1)
    places[:, 2] += rng.uniform(-0.15, 0.15, count) * (1 if kind == "floor" else 0.5)
    places[:, :2] = np.clip(places[:, :2], -half + 0.3, half - 0.3)
    tilt = {"floor": 0.0, "wall": -90.0, "ceiling": 180.0}[str(kind)]  # about x: the axis looks up, along y, down
    turns = [quaternion_xyz((tilt + rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(-180, 180) * (kind == "floor"))) for _ in places]
    lamps, wanted = list[Lamp](), int(rng.integers(3, 8))
    while len(lamps) < wanted:
        low = 0.3 if kind != "floor" else 1.3
        at = np.array([*(rng.uniform(-0.9, 0.9, 2) * half), rng.uniform(low, size[2] - (0.3 if kind != "ceiling" else 0.8))])
        by_wall = rng.random() < 0.3
        if by_wall:
            side = int(rng.integers(0, 2))
            at[side] = rng.choice([-1, 1]) * (half[side] - rng.uniform(0.1, 0.2))
        if np.linalg.norm(places - at, axis=1).min() < 1.0 or any(np.linalg.norm(at - lamp.at) < 0.6 for lamp in lamps):
            continue
        strength, colour = 10 ** rng.uniform(-0.3, 0.5), rng.uniform(0.6, 1.0, 3)
        if not by_wall and rng.random() < 0.5:
            towards = places.mean(axis=0) + rng.uniform(-4, 4, 3) * (1, 1, 0.3)
            lamps.append(panel_lamp(tuple(at), tuple(towards), strength, float(rng.uniform(0.1, 0.4)), tuple(colour)))
        else:
            lamps.append(sphere_lamp(tuple(at), tuple(strength * colour), float(rng.uniform(0.02, 0.07))))
    boxes = []
    for _ in range(int(rng.integers(0, 6))):
        corner = np.array([*(rng.uniform(-0.8, 0.8, 2) * half), 0.0])
        if np.linalg.norm(places[:, :2] - corner[:2], axis=1).min() > 0.8:
            extent = np.array([*rng.uniform(0.2, 0.5, 2), size[2] * rng.uniform(0.5, 1.0)])
            boxes.append((corner, corner + extent, rng.uniform(0.2, 0.7, 3)))
    texture = float(rng.choice([0.0, 0.6, 1.2]))
    room = Room(size, albedo, tuple(lamps), tuple(boxes), float(rng.uniform(0.01, 0.05)), None, texture)
    return room, WideRig(places, turns)
