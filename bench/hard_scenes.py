"""Small scenes that are hard to shadow: rooms, slits, thin things, leaves. Half of them are kept aside while anything is tuned."""

from collections.abc import Callable

import numpy as np

from vemlight.light.sphere import rotation_xyz
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.meshes import Geometry, VertexAttributes, bounds, clean_geometry, shape_geometry
from vemlight.renderer.scene.scene import Mesh, Scene, ViewCamera

WALL_M = 0.2
Rotation = tuple[float, float, float]  # degrees about x, y, z


def _placed(geometry: Geometry, size: tuple[float, float, float], at: tuple[float, float, float], rotate: Rotation = (0, 0, 0)) -> Geometry:
    points = geometry.positions.astype(np.float64) * np.array(size) / 2 @ rotation_xyz(rotate).T + at
    return clean_geometry(VertexAttributes(points), geometry.triangles)


def box(size: tuple[float, float, float], at: tuple[float, float, float], rotate: Rotation = (0, 0, 0)) -> Geometry:
    """A box of a size, its middle at a place."""
    return _placed(shape_geometry("box"), size, at, rotate)


def ball(radius: float, at: tuple[float, float, float]) -> Geometry:
    """A sphere."""
    return shape_geometry("sphere").moved(radius * np.eye(3), np.array(at))


def together(parts: list[Geometry]) -> Geometry:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(part.positions) for part in parts)])
    triangles = np.concatenate([part.triangles.astype(np.int64) + k for part, k in zip(parts, first, strict=False)])
    return clean_geometry(VertexAttributes(np.concatenate([part.positions for part in parts])), triangles)


def ground(side: float) -> Geometry:
    """A square in z = 0."""
    return shape_geometry("plane").moved(side / 2 * np.eye(3), np.zeros(3))


def made(eye: tuple[float, float, float], at: tuple[float, float, float], fov_y: float, *meshes: tuple[Geometry, float]) -> Scene:
    """A scene of meshes, each with its albedo."""
    parts = tuple(Mesh(f"mesh {k}", mesh, Phong(diffuse=(albedo, albedo, albedo))) for k, (mesh, albedo) in enumerate(meshes))
    low, high = bounds([part.geometry for part in parts])
    return Scene(ViewCamera(position=eye, at=at, fov_y=fov_y), parts, (low + high) / 2, (high - low) / 2)


def _shell(x: float, y: float, z: float, window: tuple[float, float, float, float]) -> list[Geometry]:
    """Walls, floor and ceiling about a room of x by y by z metres; window: from, to, sill, top in the wall towards -y."""
    w, (left, right, sill, top) = WALL_M, window
    parts = [box((x + 2 * w, y + 2 * w, w), (0, 0, -w / 2)), box((x + 2 * w, y + 2 * w, w), (0, 0, z + w / 2))]
    parts += [box((w, y, z), (side * (x + w) / 2, 0, z / 2)) for side in (-1, 1)] + [box((x + 2 * w, w, z), (0, (y + w) / 2, z / 2))]
    wall = -(y + w) / 2
    parts += [
        box((left + x / 2 + w, w, z), ((left - x / 2 - w) / 2, wall, z / 2)),
        box((x / 2 + w - right, w, z), ((right + x / 2 + w) / 2, wall, z / 2)),
    ]
    middle, wide = (left + right) / 2, right - left
    return [*parts, box((wide, w, sill), (middle, wall, sill / 2)), box((wide, w, z - top), (middle, wall, (z + top) / 2))]


def room() -> Scene:
    """A room of 6 x 5 x 3 m with a window, a table and a ball."""
    table = [box((1.4, 0.8, 0.05), (0.4, 0.2, 0.75))] + [
        box((0.06, 0.06, 0.72), (0.4 + 0.6 * i, 0.2 + 0.3 * j, 0.36)) for i in (-1, 1) for j in (-1, 1)
    ]
    return made(
        (-2.6, 2.2, 1.6),
        (0.9, -0.8, 0.8),
        62,
        (together(_shell(6, 5, 3, (-1.0, 1.2, 0.9, 2.3))), 0.7),
        (together(table), 0.4),
        (ball(0.35, (-1.2, 0.2, 0.35)), 0.5),
    )


def attic() -> Scene:
    """A roof of boards with slits of 15 mm over a floor with two boxes."""
    boards = []
    for side in (-1, 1):
        for k in range(20):
            along = 0.1 + 0.165 * k
            boards.append(box((4.4, 0.15, 0.03), (0, side * (2.4 - 0.72 * along), 0.02 + 0.69 * along), (-side * 44, 0, 0)))
    gables = [box((0.1, 5.4, 3.0), (side * 2.2, 0, 1.5)) for side in (-1, 1)]
    return made(
        (-1.8, 0.9, 1.2),
        (0.8, -0.4, 0.2),
        65,
        (ground(6), 0.5),
        (together(boards), 0.4),
        (together(gables), 0.5),
        (box((0.6, 0.6, 0.5), (0.6, -0.3, 0.25)), 0.6),
    )


def pickets() -> Scene:
    """A fence of slats, thin posts and pebbles on a lawn."""
    slats = [box((0.06, 0.02, 1.0), (-1.6 + 0.16 * k, 0.6, 0.5)) for k in range(21)] + [
        box((3.4, 0.03, 0.06), (0, 0.63, z)) for z in (0.25, 0.8)
    ]
    posts = [box((0.02, 0.02, 0.9), (-0.9 + 0.6 * k, -0.3, 0.45)) for k in range(4)]
    rng = np.random.default_rng(3)
    pebbles = [
        ball(r, (x, y, 0.5 * r))
        for r, x, y in zip(rng.uniform(0.02, 0.06, 30), rng.uniform(-1.6, 1.6, 30), rng.uniform(-1.2, 0.4, 30), strict=True)
    ]
    return made(
        (0.6, -3.4, 1.7), (0, 0.2, 0.3), 42, (ground(8), 0.6), (together(slats), 0.7), (together(posts), 0.3), (together(pebbles), 0.5)
    )


def leaves() -> Scene:
    """A bush of 900 single leaves on stems."""
    rng = np.random.default_rng(4)
    leaf = np.array([[0, -0.5, 0], [0.22, 0, 0.05], [0, 0.5, 0], [-0.22, 0, 0.05]])
    points, triangles = [], []
    for k in range(900):
        size, place = rng.uniform(0.08, 0.16), rng.normal((0.0, 0.0, 0.9), (0.45, 0.45, 0.3))
        points.append(size * leaf @ rotation_xyz(tuple(rng.uniform(0, 360, 3))).T + np.maximum(place, (-9, -9, 0.1)))
        triangles.append(np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k)
    bush = clean_geometry(VertexAttributes(np.concatenate(points)), np.concatenate(triangles))
    return made((1.2, -3.0, 1.6), (0, 0, 0.65), 42, (ground(8), 0.6), (bush, 0.4), (box((0.04, 0.04, 0.9), (0, 0, 0.45)), 0.3))


def colonnade() -> Scene:
    """A hall with columns along its open side."""
    columns = [box((0.3, 0.3, 2.8), (-2.8 + 0.8 * k, -1.9, 1.4), (0, 0, 20)) for k in range(8)]
    walls = [
        box((6.6, 0.2, 2.8), (0, 2.1, 1.4)),
        box((6.6, 4.4, 0.2), (0, 0, 2.9)),
        *(box((0.2, 4.4, 2.8), (3.3 * side, 0, 1.4)) for side in (-1, 1)),
    ]
    return made(
        (-2.6, 1.7, 1.5),
        (1.0, -0.7, 0.6),
        62,
        (ground(12), 0.5),
        (together(columns), 0.6),
        (together(walls), 0.7),
        (ball(0.4, (0.4, 0.3, 0.4)), 0.5),
    )


def blinds() -> Scene:
    """A narrow room whose window has slats of 25 mm."""
    slats = [box((1.56, 0.025, 0.002), (0, -2.05, 1.0 + 0.02 * k), (35, 0, 0)) for k in range(55)]
    return made(
        (-1.3, 1.6, 1.5),
        (0.5, -0.7, 0.6),
        65,
        (together(_shell(3, 4, 2.5, (-0.75, 0.75, 1.0, 2.1))), 0.7),
        (together(slats), 0.6),
        (box((0.5, 0.5, 0.45), (0.4, 0.0, 0.225), (0, 0, 25)), 0.5),
    )


def wires() -> Scene:
    """A mesh fence of 4 mm wires and chairs of thin tubes."""
    wire = [box((0.004, 0.004, 1.2), (-1.5 + 0.075 * k, 0.7, 0.6)) for k in range(41)] + [
        box((3.0, 0.004, 0.004), (0, 0.7, 0.06 * k)) for k in range(21)
    ]
    chairs = []
    for x in (-0.7, 0.5):
        chairs += [box((0.4, 0.4, 0.02), (x, -0.2, 0.45))] + [
            box((0.015, 0.015, 0.45), (x + 0.18 * i, -0.2 + 0.18 * j, 0.225)) for i in (-1, 1) for j in (-1, 1)
        ]
        chairs += [box((0.4, 0.012, 0.03), (x, -0.02, 0.5 + 0.08 * k)) for k in range(6)]
    return made((0.5, -3.2, 1.7), (0, 0.1, 0.35), 42, (ground(8), 0.6), (together(wire), 0.5), (together(chairs), 0.4))


def stairs() -> Scene:
    """Steps with open risers under a rail."""
    steps = [box((1.2, 0.28, 0.04), (0, -0.9 + 0.26 * k, 0.18 * (k + 1))) for k in range(8)]
    rails = [box((0.012, 0.012, 0.9), (0.58, -0.9 + 0.13 * k, 0.09 * k + 0.6)) for k in range(16)]
    return made((2.6, -2.8, 1.9), (0, 0.1, 0.6), 42, (ground(8), 0.6), (together(steps), 0.5), (together(rails), 0.4))


TUNED: dict[str, Callable[[], Scene]] = {"room": room, "attic": attic, "pickets": pickets, "leaves": leaves}
KEPT_ASIDE: dict[str, Callable[[], Scene]] = {"colonnade": colonnade, "blinds": blinds, "wires": wires, "stairs": stairs}
