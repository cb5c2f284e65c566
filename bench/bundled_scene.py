"""The bundled scene's meshes, from scratch: a terrace with a laid table, a bench of slats, a small tree and polished things.

    python -m bench.bundled_scene [--out services/renderer/scene/scenes/terrace]

Everything is made here by formulas and seeded numbers; the cloth is dropped on the table and hangs as it falls (position-based dynamics,
Müller et al. 2007). Metres, +Z up while made; glTF's +Y up in the file. It takes about a minute.
"""

import argparse
import io
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

OUT = Path(__file__).parents[1] / "services" / "renderer" / "scene" / "scenes" / "terrace"
SEED = 2005
SLAB_M, SLABS = 0.6, 8  # of the paving: a picture of 8 x 8 slabs is repeated to the horizon
GROUND_M = 8000.0  # from the middle: its edge lies .013 degrees below the horizon, a third of a pixel of 1280 x 720
TABLE_M, TABLE_R, CLOTH_M = 0.74, 0.5, 1.62  # height, radius, side of the cloth
CLOTH_MM = 5.0  # above the table: a round rim, and no triangle of the table shows through
CLOTH_SIDE, FRAMES, ROUNDS = 64, 300, 24  # threads each way; steps of a sixtieth of a second, rounds of constraints in each


# Profiles: radius and height, from below.
VASE = [(0, 0), (0.045, 0), (0.075, 0.05), (0.085, 0.11), (0.06, 0.18), (0.03, 0.23), (0.032, 0.27), (0.05, 0.3), (0.03, 0.28)]
BOWL = [(0, 0), (0.05, 0), (0.055, 0.012), (0.1, 0.035), (0.135, 0.085), (0.13, 0.085), (0.095, 0.04), (0.04, 0.018), (0, 0.016)]
POT = [(0, 0), (0.17, 0), (0.18, 0.02), (0.235, 0.4), (0.25, 0.42), (0.245, 0.45), (0.22, 0.45), (0.215, 0.4), (0, 0.39)]


def material(name: str, colour: tuple[float, float, float], metallic: float, roughness: float, **more: Any) -> PBRMaterial:
    """A glTF material of a linear colour."""
    return PBRMaterial(name=name, baseColorFactor=[*colour, 1.0], metallicFactor=metallic, roughnessFactor=roughness, **more)


def coloured(mesh: trimesh.Trimesh, look: PBRMaterial, uv: np.ndarray | None = None) -> trimesh.Trimesh:
    mesh.visual = TextureVisuals(uv=uv, material=look)
    return mesh


def joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    mesh: Any = trimesh.util.concatenate(meshes)
    return mesh


def lathe(profile: list[tuple[float, float]], sides: int = 40) -> trimesh.Trimesh:
    """The surface that a smooth line through points (radius, height) makes round the vertical."""
    points, at = np.array(profile), np.linspace(0, 1, len(profile))
    fine = np.linspace(0, 1, 4 * len(profile))
    smooth = np.stack([_through(at, points[:, k], fine) for k in (0, 1)], axis=-1)
    turn = 2 * np.pi * np.arange(sides) / sides
    rings = np.stack([smooth[:, :1] * np.cos(turn), smooth[:, :1] * np.sin(turn), np.repeat(smooth[:, 1:], sides, axis=1)], axis=-1)
    return trimesh.Trimesh(rings.reshape(-1, 3), grid_faces(len(smooth), sides, closed=True), process=False)


def _through(at: np.ndarray, values: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """A monotone cubic through values, so that no profile overshoots."""
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(at, values)(fine)


def grid_faces(rows: int, cols: int, closed: bool = False) -> np.ndarray:
    """Two triangles for each cell of a grid of vertices; `closed`: the last column meets the first."""
    row, col = np.meshgrid(np.arange(rows - 1), np.arange(cols if closed else cols - 1), indexing="ij")
    a, b = row * cols + col, row * cols + (col + 1) % cols
    c, d = a + cols, b + cols
    return np.concatenate([np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3)])


def tablecloth() -> trimesh.Trimesh:
    """A square cloth that has fallen over a round table."""
    n = CLOTH_SIDE
    side = np.linspace(-CLOTH_M / 2, CLOTH_M / 2, n)
    x, y = np.meshgrid(side, side, indexing="ij")
    c, s = np.cos(np.radians(31.0)), np.sin(np.radians(31.0))
    place = np.stack([c * x - s * y, s * x + c * y, np.full_like(x, TABLE_M + 0.02)], axis=-1)
    place[..., 2] += 0.004 * np.random.default_rng(SEED).standard_normal((n, n))
    speed = np.zeros_like(place)
    thread = side[1] - side[0]
    # Pairs that keep their distance: along the threads, across a cell, and two threads away, which resists folds.
    pairs = [((1, 0), 0.9), ((0, 1), 0.9), ((1, 1), 0.5), ((1, -1), 0.5), ((2, 0), 0.12), ((0, 2), 0.12)]
    for _ in range(FRAMES):
        speed[..., 2] -= 9.81 / 60
        speed *= 0.985
        before = place.copy()
        place = place + speed / 60
        for _ in range(ROUNDS):
            for (i, j), stiff in pairs:
                for phase in range(2):
                    _pull(place, i, j, np.hypot(i, j) * thread, stiff, phase)
            touching = _stand(place)
        speed = (place - before) * 60
        speed[touching] *= 0.2  # friction
    return trimesh.Trimesh(place.reshape(-1, 3), grid_faces(n, n), process=False)


def _pull(place: np.ndarray, i: int, j: int, length: float, stiff: float, phase: int) -> None:
    """Brings pairs (i, j) threads apart towards their length: first the even ones, then the odd, so that none is in two at once."""
    n = len(place)
    step = max(abs(i), abs(j))
    rows = np.arange(n - i)
    cols = np.arange(max(0, -j), n - max(0, j))
    axis = rows if i else cols
    chosen = axis[(axis // step) % 2 == phase]
    rows, cols = (chosen, cols) if i else (rows, chosen)
    a = np.ix_(rows, cols)
    b = np.ix_(rows + i, cols + j)
    across = place[b] - place[a]
    distance = np.linalg.norm(across, axis=-1, keepdims=True)
    shift = 0.5 * stiff * (1 - length / np.maximum(distance, 1e-9)) * across
    place[a] += shift
    place[b] -= shift


def _stand(place: np.ndarray) -> np.ndarray:
    """Brings what is inside the table out by its nearest face, and keeps the cloth above the ground; where it touches the top."""
    radius = np.hypot(place[..., 0], place[..., 1])
    up, out = TABLE_M + CLOTH_MM / 1e3 - place[..., 2], TABLE_R + CLOTH_MM / 1e3 - radius
    within = (up > 0) & (out > 0)
    on_top = within & (up <= out)
    place[..., 2] = np.where(on_top, place[..., 2] + up, place[..., 2])
    scale = np.where(within & ~on_top, 1 + out / np.maximum(radius, 1e-9), 1.0)
    place[..., :2] *= scale[..., None]
    place[..., 2] = np.maximum(place[..., 2], 0.01)
    return on_top


def bench_of_slats() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Slats of wood, and the iron that carries them: 1.5 m long, its back to +Y."""
    slats, iron = [], []
    for k in range(5):
        slats.append(_bar((1.5, 0.07, 0.028), (0, 0.095 * k - 0.19, 0.44)))
    for k in range(4):
        slats.append(_bar((1.5, 0.026, 0.075), (0, 0.245 + 0.028 * k, 0.56 + 0.105 * k), tilt_deg=-14))
    for x in (-0.62, 0.62):
        iron += [_bar((0.04, 0.03, 0.44), (x, -0.19, 0.21)), _bar((0.04, 0.03, 0.44), (x, 0.2, 0.21)),
                 _bar((0.04, 0.44, 0.03), (x, 0.0, 0.41)), _bar((0.04, 0.03, 0.52), (x, 0.31, 0.67), tilt_deg=-14)]  # fmt: skip
    return joined(slats), joined(iron)


def _bar(size: tuple[float, float, float], at: tuple[float, float, float], tilt_deg: float = 0.0) -> trimesh.Trimesh:
    bar = trimesh.creation.box(size)
    bar.apply_transform(trimesh.transformations.rotation_matrix(np.radians(tilt_deg), (1, 0, 0)))
    bar.apply_translation(at)
    bar.unmerge_vertices()
    return bar


def tree() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Trunk with branches, and leaves of four triangles each: 2 m high."""
    generator = np.random.default_rng(SEED)
    branches: list[trimesh.Trimesh] = []
    tips: list[np.ndarray] = []

    def grow(start: np.ndarray, way: np.ndarray, length: float, radius: float, depth: int) -> None:
        end = start + length * way
        branches.append(_limb(start, end, radius, 0.72 * radius))
        if depth == 0:
            tips.extend(start + t * (end - start) for t in np.linspace(0.2, 1.0, 4))
            return
        turn = generator.uniform(0, 2 * np.pi)
        for k in range(3):
            spread = np.radians(generator.uniform(26, 48))
            around = turn + k * 2 * np.pi / 3 + generator.uniform(-0.4, 0.4)
            side, other = np.linalg.svd(way[None])[2][1:]
            next_way = np.cos(spread) * way + np.sin(spread) * (np.cos(around) * side + np.sin(around) * other)
            next_way[2] += 0.12  # towards the light
            grow(end, next_way / np.linalg.norm(next_way), length * generator.uniform(0.62, 0.8), 0.62 * radius, depth - 1)

    grow(np.array([0.0, 0.0, 0.4]), np.array([0.03, 0.02, 1.0]) / np.linalg.norm([0.03, 0.02, 1.0]), 0.62, 0.032, 4)
    leaves = [_leaf(tip + 0.03 * generator.standard_normal(3), generator) for tip in tips for _ in range(4)]
    return joined(branches), joined(leaves)


def _limb(start: np.ndarray, end: np.ndarray, low: float, high: float) -> trimesh.Trimesh:
    sides = 7 if low > 0.012 else 4
    way = (end - start) / np.linalg.norm(end - start)
    side, other = np.linalg.svd(way[None])[2][1:]
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
    return trimesh.Trimesh(np.concatenate([start + low * ring, end + high * ring]), grid_faces(2, sides, closed=True), process=False)


def _leaf(at: np.ndarray, generator: np.random.Generator) -> trimesh.Trimesh:
    """A pointed leaf, folded along its rib."""
    length, width = generator.uniform(0.05, 0.075), generator.uniform(0.014, 0.02)
    way = generator.standard_normal(3)
    way[2] += 0.3
    way /= np.linalg.norm(way)
    side, up = np.linalg.svd(way[None])[2][1:]
    fold = 0.35 * width * up
    points = [0 * way, 0.5 * length * way + width * side + fold, length * way, 0.5 * length * way - width * side + fold, 0.5 * length * way]
    return trimesh.Trimesh(at + np.array(points), [[0, 1, 4], [1, 2, 4], [4, 2, 3], [0, 4, 3]], process=False)


def paving() -> Image.Image:
    """SLABS x SLABS slabs of stone with dark joints, sRGB."""
    generator, side = np.random.default_rng(SEED), 1024
    slab = side // SLABS
    tone = 0.40 + 0.055 * generator.standard_normal((SLABS, SLABS))
    grain = generator.standard_normal((side, side))
    stains = Image.fromarray(generator.standard_normal((64, 64)).astype(np.float32))
    coarse = np.asarray(stains.resize((side, side), Image.Resampling.BICUBIC))
    light = np.kron(tone, np.ones((slab, slab))) * (1 + 0.05 * grain + 0.07 * coarse)
    place = np.arange(side) % slab
    joint = np.minimum(place, slab - 1 - place) < 2
    light[joint, :] *= 0.45
    light[:, joint] *= 0.45
    linear = np.clip(light, 0.02, 0.9)[..., None] * [1.0, 0.965, 0.90]
    return Image.fromarray((255 * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8))


def ground() -> trimesh.Trimesh:
    picture = io.BytesIO()
    paving().save(picture, "JPEG", quality=82)
    look = material("stone", (1.0, 1.0, 1.0), 0.0, 0.85, baseColorTexture=Image.open(picture))
    corners = GROUND_M * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    return coloured(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), look, corners[:, :2] / (SLAB_M * SLABS))


def torus_knot(p: int = 2, q: int = 3, along: int = 160, around: int = 14, radius: float = 0.085) -> trimesh.Trimesh:
    """A tube along a torus knot, about half a metre wide."""
    t = 2 * np.pi * np.arange(along) / along
    middle = np.stack([(2 + np.cos(q * t)) * np.cos(p * t), (2 + np.cos(q * t)) * np.sin(p * t), -np.sin(q * t)], axis=-1) * 0.11
    tangent = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outward = middle * [1, 1, 0] + [0, 0, 1e-9]
    side = np.cross(tangent, outward)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(tangent, side)
    turn = 2 * np.pi * np.arange(around) / around
    tube = middle[:, None] + 0.6 * radius * (np.cos(turn)[None, :, None] * side[:, None] + np.sin(turn)[None, :, None] * other[:, None])
    faces = grid_faces(along + 1, around, closed=True) % (along * around)
    return trimesh.Trimesh(tube.reshape(-1, 3), faces, process=False)


def written(folder: Path, name: str, parts: list[tuple[trimesh.Trimesh, tuple[float, float, float]]]) -> int:
    """Writes an object, made of meshes at their places, as NAME.glb; how many triangles it has."""
    scene = trimesh.Scene()
    up = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)  # glTF's +Y up
    for number, (mesh, at) in enumerate(parts):
        mesh.apply_transform(up @ trimesh.transformations.translation_matrix(at))
        _ = mesh.vertex_normals  # so that they are written
        look: Any = mesh.visual
        part = look.material.name if len(parts) > 1 else name
        scene.add_geometry(mesh, node_name=f"{part} {number}", geom_name=f"{part} {number}")
    content: Any = scene.export(file_type="glb", include_normals=True)
    (folder / f"{name}.glb").write_bytes(content)
    return sum(len(mesh.faces) for mesh, _ in parts)


def table() -> list[tuple[trimesh.Trimesh, tuple[float, float, float]]]:
    """A laid table: cloth, vase, a bowl of oranges."""
    top = TABLE_M + CLOTH_MM / 1e3
    parts = [
        (coloured(tablecloth(), material("linen", (0.72, 0.66, 0.55), 0.0, 0.95)), (0.0, 0.0, 0.0)),
        (coloured(lathe(VASE), material("copper", (0.955, 0.54, 0.36), 1.0, 0.22)), (0.12, 0.14, top)),
        (coloured(lathe(BOWL), material("glaze", (0.06, 0.20, 0.33), 0.0, 0.18)), (-0.14, -0.12, top)),
    ]
    for x, y in [(-0.17, -0.15), (-0.10, -0.12), (-0.15, -0.07)]:
        fruit = trimesh.creation.uv_sphere(0.036, count=[10, 16])
        parts.append((coloured(fruit, material("orange", (0.85, 0.31, 0.03), 0.0, 0.45)), (x, y, top + 0.056)))
    return parts


def objects() -> dict[str, list[tuple[trimesh.Trimesh, tuple[float, float, float]]]]:
    """The meshes of each object with their places in it; terrace.toml places the objects."""
    here = (0.0, 0.0, 0.0)
    slats, iron = bench_of_slats()
    wood, leaves = tree()
    plinth = trimesh.creation.box((0.42, 0.42, 0.62))
    plinth.unmerge_vertices()
    knot = torus_knot()
    knot.apply_transform(trimesh.transformations.rotation_matrix(np.radians(78), (1, 0, 0)))
    ball = trimesh.creation.uv_sphere(0.21, count=[24, 36])
    return {
        "ground": [(ground(), here)],
        "table": table(),
        "bench": [
            (coloured(slats, material("oak", (0.38, 0.21, 0.10), 0.0, 0.6)), here),
            (coloured(iron, material("iron", (0.035, 0.037, 0.04), 0.0, 0.4)), here),
        ],
        "tree": [
            (coloured(wood, material("bark", (0.23, 0.18, 0.13), 0.0, 0.9)), here),
            (coloured(leaves, material("leaf", (0.17, 0.25, 0.09), 0.0, 0.5, doubleSided=True)), here),
            (coloured(lathe(POT), material("terracotta", (0.52, 0.22, 0.12), 0.0, 0.8)), here),
        ],
        "plinth": [(coloured(plinth, material("limestone", (0.60, 0.58, 0.53), 0.0, 0.8)), (0.0, 0.0, 0.31))],
        "knot": [(coloured(knot, material("gold", (1.0, 0.71, 0.29), 1.0, 0.3)), (0.0, 0.0, -float(knot.bounds[0, 2])))],
        "ball": [(coloured(ball, material("steel", (0.77, 0.78, 0.78), 1.0, 0.12)), (0.0, 0.0, 0.21))],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=OUT)
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    triangles = {name: written(chosen.out, name, parts) for name, parts in objects().items()}
    size = sum((chosen.out / f"{name}.glb").stat().st_size for name in triangles)
    print(f"{chosen.out}: {sum(triangles.values())} triangles, {size} bytes: {triangles}")


if __name__ == "__main__":
    main()
