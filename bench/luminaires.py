"""Luminaires: error against samples, the 2003 approximation against the exact field, shadow maps against rays, and times.

    python -m bench.luminaires [--out docs/luminaires] [--only NAME ...]

Names: convergence, accuracy, approximation, shadows, search, speed, moving. Each writes luminaires_NAME.csv, and a chart
where there is one. The lamp of the charts is a faceted headlight from the virtual goniophotometer, 7 x 9 images, similar to the `bike`
of Lu et al. 2015. On a machine with a GPU `--only speed moving` measures what the papers did; the first row names the GL
and the load of the processor.
"""

import argparse
import csv
import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from bench.rivals import luminaire_sampling as rivals
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import quaternion_xyz
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.luminaire import shadow_views, shift_invariant
from vemlight.renderer.luminaire.acquisition import AcquisitionPlanes
from vemlight.renderer.luminaire.bases import compact_dual
from vemlight.renderer.luminaire.estimator import halton, interleaved_shifts, irradiance_receivers, shade
from vemlight.renderer.luminaire.goniophotometer import ReflectorLamp, measured_lamp
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.method_choice import chosen_method
from vemlight.renderer.luminaire.reference import irradiance, relative_error, spot_irradiance
from vemlight.renderer.luminaire.tables import summed_area_tables
from vemlight.renderer.passes.luminaires import rasterised_luminaire
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.luminaire_table import Luminaire, LuminaireTable, world_from_lamp
from vemlight.renderer.scene.meshes import bounds, shape_geometry
from vemlight.renderer.scene.scene import BUNDLED_SCENE, Mesh, Scene, ViewCamera, load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

DOWN = np.array([0.0, 0.0, -1.0])
DARK = LightSet.of(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
PAPER_2003 = {(25, 500): 2.7, (49, 500): 1.5, (63, 500): 1.2, (25, 8000): 1.3, (49, 8000): 0.7, (63, 8000): 0.55}  # frames/s, table 1
PAPER_PRECOMPUTED_MS = {(63, 300): 513, (25, 256): 129, (99, 256): 527}  # Lu et al. 2015, section 7


def headlight() -> LightField:
    lamp = ReflectorLamp(aperture_radius_m=0.03, focal_m=0.007, ball_radius_m=0.002, offset_m=(0.001, 0.0, 0.0),
                         radiance=(4e6, 3.5e6, 2.6e6), facets=20, facet_tilt=0.08)
    planes = AcquisitionPlanes("bell", 0.0075, 9, 7, 0.12, (0.14, 0.14), 96, 96)
    return measured_lamp(lamp, planes, compact_dual("bell", 4), per_spacing=6, name="headlight")


def same(count: int) -> np.ndarray:
    return interleaved_shifts(np.zeros(count, int), np.zeros(count, int), 1)


def wall(distance_m: float, half_m: float, columns: int, rows: int) -> np.ndarray:
    """Points (rows * columns, 3) of a wall across the axis."""
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * half_m
    y = ((np.arange(rows) + 0.5) / rows * 2 - 1) * half_m * rows / columns
    return np.stack([*np.meshgrid(x, y), np.full((rows, columns), distance_m)], axis=-1).reshape(-1, 3)


def rmse(picture: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((picture - truth) ** 2)) / np.mean(truth))


def lab_error(picture: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance in Lab of tone-mapped pictures: 1 - exp(-L / mean), as Lu et al. 2015 compare them, and the sRGB curve."""
    lab = []
    for image in (picture, truth):
        level = 1 - np.exp(-np.maximum(image, 0) / truth.mean())
        lab.append(cv2.cvtColor((level ** (1 / 2.2)).astype(np.float32).reshape(-1, 1, 3), cv2.COLOR_RGB2Lab))
    return float(np.linalg.norm(lab[0] - lab[1], axis=-1).mean())


def median_s(work: Callable[[], object], times: int = 5) -> float:
    spent = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return float(np.median(spent))


def cpu_s(work: Callable[[], object], times: int = 3) -> float:
    """Processor time of all threads, the least of some rounds: other work on the machine hardly touches it."""
    spent = []
    for _ in range(times):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return min(spent)


def machine(renderer: Renderer) -> str:
    return f"{renderer.info}; {os.cpu_count()} cores of {platform.machine()}, load {os.getloadavg()[0]:.1f}"


def write(path: Path, header: list[str], rows: list[list]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([header, *([f"{v:.5g}" if isinstance(v, float) else v for v in row] for row in rows)])
    print(path.name)
    for row in rows:
        print("  " + ", ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row))


def chart(path: Path, rows: list[list], x: int, label: str) -> None:
    """Relative RMSE and mean Lab error (columns 3 and 4 of rows that begin with a name) against column x."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(10, 4), dpi=110)
    for axes, y, measure in zip(panels, (3, 4), ("relative RMSE", "mean Lab error"), strict=True):
        for name in dict.fromkeys(row[0] for row in rows):
            axes.loglog(*zip(*[(row[x], row[y]) for row in rows if row[0] == name], strict=True), marker="o", label=name)
        axes.set(xlabel=label, ylabel=measure)
        axes.grid(True, which="both", alpha=0.3)
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def convergence(out: Path) -> None:
    """Error against samples a pixel of uniform, precomputed global and position-dependent sampling, on a wall in the beam."""
    field = headlight()
    tables, points = summed_area_tables(field), wall(1.2, 0.9, 32, 24)
    truth, rng = np.array([irradiance(field, p, DOWN) for p in points]), np.random.default_rng(1)
    ways = {
        "uniform": lambda n: rivals.uniform(tables, points, n, halton(n)),
        "precomputed": lambda n: rivals.precomputed(tables, points, n, np.column_stack([halton(n)[:, 0], rng.random((n, 2))])),
        "ours": lambda n: shade(tables, irradiance_receivers(points, np.tile(DOWN, (len(points), 1))), same(len(points)), n),
    }
    rows = []
    for name, way in ways.items():
        way(4)
        counts = [63, 126, 252, 504, 1008, 4032] + ([16128, 63000] if name == "precomputed" else [])
        for n in counts:
            picture = way(n)
            spent_us = cpu_s(lambda way=way, n=n: way(n)) / len(points) * 1e6
            rows.append([name, n, spent_us, rmse(picture, truth), lab_error(picture, truth)])
    write(out / "luminaires_convergence.csv", ["sampling", "samples a point", "CPU us a point", "relative RMSE", "mean Lab error"], rows)
    chart(out / "luminaires_convergence.png", rows, 1, "samples a point")
    chart(out / "luminaires_equal_time.png", rows, 2, "processor time a point, microseconds")


def accuracy(out: Path) -> None:
    """1,000 points before, on, near and between the planes: the mean of 10^5 samples against quadrature."""
    field, rng = headlight(), np.random.default_rng(1)
    d = field.distance_m
    z = rng.choice([0.5 * d, d - 1e-4, d - 1e-5, d, d + 1e-5, d + 1e-4, 1.1 * d, 2 * d, 8 * d], 1000)
    points = np.concatenate([rng.uniform(-0.05, 0.05, (1000, 2)) * np.maximum(z / d, 1)[:, None], z[:, None]], axis=1)
    got = shade(summed_area_tables(field), irradiance_receivers(points, np.tile(DOWN, (1000, 1))), same(1000), 100_000)
    truth = np.array([irradiance(field, p, DOWN) for p in points])
    off = np.linalg.norm(got - truth, axis=1) / np.linalg.norm(truth, axis=1)
    lit = np.linalg.norm(truth, axis=1) > 1e-3 * np.linalg.norm(truth, axis=1).max()
    parts = {"within 1e-4 of S": np.abs(z - d) < 2e-4, "between": z < d - 1e-3, "beyond": z > d + 1e-3}
    rows = [[name, int((lit & part).sum()), *np.quantile(off[lit & part], (0.5, 0.99, 1.0)).tolist()] for name, part in parts.items()]
    write(out / "luminaires_accuracy.csv", ["points", "count", "median error", "99 %", "largest"], rows)


def approximation(out: Path) -> None:
    """Figure 3 of 2003, and its approximation against the exact field for filters of different width."""
    theta = np.radians(np.arange(0, 81, 10.0))
    rows = [["E_r", s, *[float(e) for e in relative_error(theta, s)]] for s in (0.01, 0.02, 0.04, 0.08)]
    write(out / "luminaires_figure3.csv", ["", "s", *[f"{np.degrees(a):.0f} degrees" for a in theta]], rows)
    rows = []
    for factor in (0.5, 1.0, 2.0, 4.0):
        lamp = ReflectorLamp(aperture_radius_m=0.02, focal_m=0.005, ball_radius_m=0.002, radiance=(4e6, 3.5e6, 2.6e6))
        planes = AcquisitionPlanes("bell", 0.0075, 5, 5, 0.12 * factor, (0.1 + 0.05 * factor, 0.1 + 0.05 * factor), 48, 48)
        field = measured_lamp(lamp, planes, compact_dual("bell", 4), per_spacing=6)
        for distance in (2 * planes.distance_m, 10 * planes.distance_m):
            points = wall(distance, 0.4 * distance, 12, 9)
            exact = np.array([irradiance(field, p, DOWN) for p in points])
            spots = np.array([spot_irradiance(field, p, DOWN) for p in points])
            rows.append([2 * planes.spacing_m / planes.distance_m, distance, shift_invariant.error_bound(field), rmse(spots, exact)])
    write(out / "luminaires_approximation.csv", ["s", "distance m", "bound E_r", "relative RMSE"], rows)


def pictured(scene: Scene, size: tuple[int, int]) -> np.ndarray:
    renderer = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1])))
    try:
        return renderer.render(DARK)[..., :3].copy()
    finally:
        renderer.release()


def with_lamp(scene: Scene, field: LightField, at: tuple, rotate: tuple, **table) -> Scene:
    row = LuminaireTable(at=at, rotate=rotate, **table)
    drawn = chosen_method(field, row.method, row.samples)
    return scene._replace(luminaires=(Luminaire(field, world_from_lamp(at, rotate), 1.0, row, drawn),))


def shadows(out: Path) -> None:
    """Shadow maps from both reference positions, and none, against traced rays on the bundled scene."""
    demo, field = load_scene(SHAPES), headlight()
    lit: dict[str, Any] = {"at": (-2.2, -1.6, 1.2), "rotate": (0.0, 108.0, 25.0), "method": "sampled", "samples": 200}
    truth = pictured(with_lamp(demo, field, **lit, shadows="traced"), (160, 120))
    tried: list[tuple[str, shadow_views.ReferencePlane, str, int]] = [
        ("none", "sampling", "none", 16), ("measurement plane, 2015", "measurement", "maps", 192),
        ("sampling plane", "sampling", "maps", 64), ("sampling plane", "sampling", "maps", 192),
        ("sampling plane", "sampling", "maps", 384),
    ]
    rows = []
    for name, reference, kind, size in tried:
        rasterised_luminaire.cell_views = partial(shadow_views.cell_views, reference=reference)
        picture = pictured(with_lamp(demo, field, **lit, shadows=kind, shadow_map=size), (160, 120))
        rows.append([name, size, rmse(picture, truth), lab_error(picture, truth), float(picture.sum() / truth.sum())])
    rasterised_luminaire.cell_views = shadow_views.cell_views
    write(out / "luminaires_shadows.csv", ["maps from", "texels", "relative RMSE", "mean Lab error", "energy"], rows)


def search(out: Path) -> None:
    """Probes in a CDF of 300 entries: binary, regula falsi (the secant variant of 2015), and the two in turns."""
    rng, x = np.random.default_rng(1), np.linspace(-1, 1, 300)
    shapes = {"uniform": np.ones(300), "smooth bump": np.exp(-4 * x**2), "narrow peak": np.exp(-400 * x**2) + 1e-4, "ramp": np.exp(8 * x),
              "random HDR": np.exp(2 * rng.normal(size=300))}
    rows = []
    for name, density in shapes.items():
        edges = np.concatenate([[0], np.cumsum(density)]) / density.sum()
        for way in ("binary", "regula falsi", "in turns"):
            probes = [_probes(edges, float(t), way) for t in rng.random(2000)]
            rows.append([name, way, float(np.mean(probes)), int(np.max(probes))])
    write(out / "luminaires_search.csv", ["density", "search", "mean probes", "most"], rows)


def _probes(edges: np.ndarray, target: float, way: str) -> int:
    low, high, count = 0, len(edges) - 1, 0
    while high - low > 1:
        fraction = (target - edges[low]) / max(edges[high] - edges[low], 1e-300)
        guess = low + int(fraction * (high - low))
        halves = way == "binary" or (way == "in turns" and count % 2)
        middle = (low + high) // 2 if halves else min(max(guess, low + 1), high - 1)
        count += 1
        low, high = (middle, high) if edges[middle] <= target else (low, middle)
    return count


def speed(out: Path) -> None:
    """Tables, maps and the light of one lamp, on this machine's GL, at the papers' sizes."""
    rng, rows = np.random.default_rng(1), []

    def field(rows_: int, cols: int, side: int) -> LightField:
        grain = cv2.GaussianBlur(rng.random((side, side)).astype(np.float32), (0, 0), side / 30)
        y, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
        image = (np.exp(-6 * (x**2 + y**2)) * grain)[..., None] * np.ones(3)
        images = np.broadcast_to(image, (rows_, cols, side, side, 3)).astype(np.float32)
        return AcquisitionPlanes("bell", 0.0075, rows_, cols, 0.12, (0.14, 0.14), side, side).field(images, "photometric", "smooth")

    for (count, side), paper_ms in PAPER_PRECOMPUTED_MS.items():
        lamp = field(*{63: (7, 9), 25: (5, 5), 99: (9, 11)}[count], side)
        summed_area_tables(lamp)
        ms = median_s(lambda lamp=lamp: (summed_area_tables(lamp), shadow_views.cell_views(lamp, 0.01, 10.0, "measurement"))) * 1e3
        rows.append([f"tables, {count} images of {side} x {side}", ms, 1e3 / ms, f"2015: {paper_ms} ms"])
    lit: dict[str, Any] = {"at": (-2.2, -1.6, 1.2), "rotate": (0.0, 108.0, 25.0)}
    for count, polygons in PAPER_2003:
        side = {25: (5, 5), 49: (7, 7), 63: (9, 7)}[count]
        scene = with_lamp(polygon_scene(polygons), field(*side, 300), **lit, method="shift-invariant", shadow_map=192)
        ms, _ = _frame_ms(scene, (400, 400))
        paper_ms = 1e3 / PAPER_2003[count, polygons]
        rows.append([f"2003: {count} spots, {polygons} polygons, 400 x 400, maps anew", ms, 1e3 / ms, f"2003: {paper_ms:.0f} ms"])
    scene = with_lamp(load_scene(SHAPES), field(9, 7, 300), **lit, method="sampled", samples=200, shadow_map=256)
    ms, drawn_by = _frame_ms(scene, (1024, 768))
    rows.append(["2015: 63 images, 200 samples, 1024 x 768, 80 maps anew", ms, 1e3 / ms, "2015: 67 to 143 ms (GTX 580)"])
    write(out / "luminaires_speed.csv", ["what", "ms", "a second", "paper"], [[drawn_by, "", "", ""], *rows])


def polygon_scene(polygons: int) -> Scene:
    """A ground, and boxes of 12 triangles in rows, about `polygons` in all."""
    box = shape_geometry("box")
    parts = [Mesh("ground", shape_geometry("plane").moved(np.eye(3) * 4.5, np.zeros(3)), load_scene(SHAPES).meshes[0].material)]
    side = int(np.ceil(np.sqrt(polygons / 12)))
    stack = [box.moved(np.eye(3) * 1.2 / side, np.array([(i + 0.5) / side * 6 - 3, (j + 0.5) / side * 6 - 3, 1.2 / side]))
             for i, j in np.ndindex(side, side)][: polygons // 12]
    first = np.arange(len(stack)) * len(box.positions)
    triangles = np.concatenate([g.triangles + np.uint32(k) for g, k in zip(stack, first, strict=True)])
    joined = stack[0]._replace(positions=np.concatenate([g.positions for g in stack]), normals=np.concatenate([g.normals for g in stack]),
                               triangles=triangles)
    if hasattr(joined, "uvs"):
        joined = joined._replace(uvs=np.concatenate([g.uvs for g in stack]))
    parts.append(Mesh("boxes", joined, parts[0].material))
    low, high = bounds([part.geometry for part in parts])
    return Scene(ViewCamera(position=(3.4, -4.6, 2.7), at=(0.0, 0.1, 0.5), fov_y=40.0), tuple(parts), (low + high) / 2, (high - low) / 2)


def _frame_ms(scene: Scene, size: tuple[int, int]) -> tuple[float, str]:
    """(ms, machine): median of frames in which the lamp moved, so that all its maps are drawn; with the read-back.

    Of 30 frames, of 3 that take more than a second, and one that takes more than ten.
    """
    table, step = scene.luminaires[0].table, iter(range(100))
    lamp = Pose(name="lamp", position=table.at, rotation=quaternion_xyz(table.rotate), power=1.0)
    scene = scene._replace(objects=(*scene.objects, lamp))
    renderer = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1])))

    def frame() -> None:
        at = table.at[0], table.at[1], table.at[2] + 1e-3 * next(step)
        renderer.render(DARK, pose=scene_pose(scene, 0.0, [msgspec.structs.replace(lamp, position=at)]))
    try:
        median_s(frame, 1)  # compiles
        first_s = median_s(frame, 1)
        ms = (first_s if first_s > 10 else median_s(frame, 3 if first_s > 1 else 30)) * 1e3
        return ms, machine(renderer.renderer)
    finally:
        renderer.release()


def moving(out: Path) -> None:
    """The two headlights: what a frame costs when nothing, a lamp's power, one lamp, both lamps and the ball moved."""
    scene = load_scene(BUNDLED_SCENE.with_name("headlights.toml"))
    left, right = [item for item in scene.objects if item.power is not None]
    (ball,) = [item for item in scene.objects if item.name == "ball"]
    moves = {"nothing": (), "a lamp's power": (left,), "one lamp": (left,), "both lamps": (left, right), "the ball": (ball,)}
    renderer = FrameSequence(Renderer(scene, Settings(width=192, height=108), timed=True))
    rows: list[list] = [[machine(renderer.renderer), "", ""]]
    for name, objects in moves.items():
        spent = []
        for k in range(6):
            offset = 0.0 if name == "a lamp's power" else 1e-3 * k
            power = 1.0 + k if name == "a lamp's power" else None
            at = [(o.position[0], o.position[1], o.position[2] + offset) for o in objects]
            poses = [Pose(name=o.name, position=p, rotation=o.rotation, power=power) for o, p in zip(objects, at, strict=True)]
            start = time.perf_counter()
            renderer.render(DARK, pose=scene_pose(scene, 0.0, poses))
            spent.append(((time.perf_counter() - start) * 1e3, renderer.timings.timers_ms.get("luminaire maps", 0.0)))
        rows.append([name, *np.median(spent[1:], axis=0).tolist()])
    renderer.release()
    write(out / "luminaires_moving.csv", ["what moved", "frame ms", "of it maps ms"], rows)


BENCHES = {f.__name__: f for f in (convergence, accuracy, approximation, shadows, search, speed, moving)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/luminaires"))
    parser.add_argument("--only", nargs="+", choices=list(BENCHES), default=list(BENCHES))
    arguments = parser.parse_args()
    for name in arguments.only:
        BENCHES[name](arguments.out)


if __name__ == "__main__":
    main()
