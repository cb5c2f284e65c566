"""Ten unlike scenes, made here: half of them are kept aside while anything is tuned."""

from collections.abc import Callable

import numpy as np

from bench import hard_scenes
from bench.hard_scenes import ball, box, ground, together
from bench.renderer import tube_knot
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.meshes import Geometry, VertexAttributes, bounds, clean_geometry, shape_geometry
from vemlight.renderer.scene.scene import Mesh, Scene, ViewCamera

Place = tuple[float, float, float]


def made(eye: Place, at: Place, fov_y: float, *meshes: tuple[Geometry, Phong]) -> Scene:
    """A scene of meshes with their materials."""
    parts = tuple(Mesh(f"mesh {k}", mesh, material) for k, (mesh, material) in enumerate(meshes))
    low, high = bounds([part.geometry for part in parts])
    return Scene(ViewCamera(position=eye, at=at, fov_y=fov_y), parts, (low + high) / 2, (high - low) / 2)


def matte(red: float, green: float, blue: float) -> Phong:
    return Phong((red, green, blue))


def gloss() -> Scene:
    """Balls from matte to nearly mirrors on a shelf."""
    meshes = [(ground(8), matte(0.5, 0.5, 0.5)), (box((4.4, 1.0, 0.1), (0, 0, 0.05)), matte(0.3, 0.2, 0.1))]
    for k, exponent in enumerate((4.0, 16.0, 64.0, 256.0, 1024.0)):
        meshes.append((ball(0.38, (-1.7 + 0.85 * k, 0.0, 0.48)), Phong((0.05, 0.05, 0.05), (0.8, 0.75, 0.6), exponent)))
    return made((0.0, -4.6, 1.7), (0.0, 0.0, 0.4), 36, *meshes)


def street() -> Scene:
    """Two rows of houses with balconies, lamp posts and parked boxes."""
    rng = np.random.default_rng(11)
    houses, balconies, small = [], [], []
    for side in (-1, 1):
        for k in range(6):
            high = float(rng.uniform(7, 15))
            houses.append(box((7.6, 8.0, high), (-20 + 8 * k, side * 10.0, high / 2)))
            for floor in range(1, int(high / 3)):
                balconies.append(box((2.4, 1.0, 0.12), (-20 + 8 * k, side * 5.6, 3.0 * floor)))
                balconies += [box((0.03, 0.03, 0.9), (-21.1 + 8 * k + 0.2 * n, side * 5.15, 3.0 * floor + 0.5)) for n in range(12)]
        small += [box((0.1, 0.1, 4.5), (-18 + 9 * k, side * 4.2, 2.25)) for k in range(5)]
        small += [box((3.8, 1.6, 1.3), (-16 + 7 * k, side * 3.0, 0.65)) for k in range(4)]
    meshes = (ground(80), matte(0.25, 0.25, 0.25)), (together(houses), matte(0.55, 0.45, 0.35)), (together(balconies), matte(0.6, 0.6, 0.6))
    return made((-24.0, -0.6, 2.2), (6.0, 0.5, 3.0), 55, *meshes, (together(small), Phong((0.3, 0.1, 0.1), (0.1, 0.1, 0.1), 60)))


def engine() -> Scene:
    """Pipes, fins, bolts and a block, close together."""
    fins = [box((0.9, 0.6, 0.012), (0, 0, 0.5 + 0.035 * k)) for k in range(16)]
    bolts = [ball(0.035, (0.55 * np.cos(a), -0.45 + 0.05 * np.sin(3 * a), 0.3 + 0.25 * np.sin(a))) for a in np.linspace(0, 2 * np.pi, 14)]
    pipe = tube_knot(512, 16)
    low, high = bounds([pipe])
    size, places = float((high - low).max()), ((1.5, (0.1, 0.0, 0.8)), (0.9, (-0.6, -0.3, 0.5)))
    pipes = [pipe.moved(scale / size * np.eye(3), np.array(place)) for scale, place in places]
    meshes = (
        (ground(6), matte(0.4, 0.4, 0.4)), (box((1.2, 0.8, 0.5), (0, 0, 0.25)), Phong((0.2, 0.2, 0.22), (0.3, 0.3, 0.3), 40)),
        (together(fins), matte(0.5, 0.5, 0.52)), (together(bolts), Phong((0.1, 0.1, 0.1), (0.6, 0.6, 0.6), 120)),
        (together(pipes), Phong((0.35, 0.16, 0.08), (0.3, 0.25, 0.2), 90)),
    )  # fmt: skip
    return made((1.7, -2.3, 1.6), (0.0, 0.0, 0.6), 38, *meshes)


def far() -> Scene:
    """A small yard 3 km from the origin."""
    away = np.array([3000.0, -2000.0, 40.0])
    yard = hard_scenes.pickets()
    meshes = tuple(mesh._replace(geometry=mesh.geometry.moved(np.eye(3), away)) for mesh in yard.meshes)
    low, high = bounds([mesh.geometry for mesh in meshes])
    eye, at = (tuple((np.array(place) + away).tolist()) for place in (yard.camera.position, yard.camera.at))
    return Scene(ViewCamera(position=eye, at=at, fov_y=yard.camera.fov_y), meshes, (low + high) / 2, (high - low) / 2)


def _heights(side: int, size_m: float, high_m: float, seed: int) -> Geometry:
    """Hills on a square of side x side points: sums of waves."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    z = np.zeros_like(x)
    for octave in range(1, 8):
        for _ in range(3):
            across, turn = rng.normal(size=2) * 1.6**octave, rng.uniform(0, 2 * np.pi)
            z += 0.62**octave * np.sin(across[0] * x + across[1] * y + turn)
    points = np.stack([x * size_m / 2, y * size_m / 2, z / np.abs(z).max() * high_m], axis=-1).reshape(-1, 3)
    k = np.arange(side * side).reshape(side, side)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    return clean_geometry(VertexAttributes(points), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def land() -> Scene:
    """A square kilometre of hills with towers, and a person's things in front."""
    hills, rng = _heights(200, 1000.0, 40.0, 5), np.random.default_rng(6)
    towers = [box((8, 8, 30), (float(x), float(y), 15.0)) for x, y in rng.uniform(-300, 300, (20, 2))]
    near = [box((0.04, 0.04, 1.2), (-1.0 + 0.4 * k, -440.0, 41.0)) for k in range(6)]
    floor = shape_geometry("plane").moved(4 * np.eye(3), np.array([0.0, -442.0, 40.4]))
    meshes = (hills, matte(0.35, 0.4, 0.25)), (together(towers), matte(0.6, 0.55, 0.5)), (floor, matte(0.5, 0.5, 0.5))
    return made((0.3, -446.0, 42.6), (0.0, -436.0, 41.2), 50, *meshes, (together(near), matte(0.5, 0.2, 0.1)))


def million() -> Scene:
    """A million triangles: fine hills of 9 m under a rail."""
    hills = _heights(708, 9.0, 0.7, 9)
    rails = [box((0.05, 0.05, 1.2), (-2.0 + 0.5 * k, -1.0, 0.7)) for k in range(9)] + [box((4.2, 0.06, 0.06), (0, -1.0, 1.2))]
    return made((2.0, -5.0, 2.6), (0.0, 0.0, 0.3), 42, (hills, matte(0.45, 0.4, 0.3)), (together(rails), matte(0.5, 0.3, 0.2)))


TUNED: dict[str, Callable[[], Scene]] = {
    "room": hard_scenes.room, "attic": hard_scenes.attic, "garden": hard_scenes.leaves, "gloss": gloss, "thin": hard_scenes.wires,
}  # fmt: skip
KEPT_ASIDE: dict[str, Callable[[], Scene]] = {"street": street, "engine": engine, "far": far, "land": land, "million": million}
