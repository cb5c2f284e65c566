"""What glossy surfaces reflect: VEMLIGHT_DATA=FOLDER python -m bench.gloss [--out docs/charts]

Metal spheres of increasing roughness under 72 lights of four real maps, with the map that narrow lobes reflect and without, against the map
itself: the reference sums all of the map's directions at each pixel's centre; a sphere casts no shadow on its lit side. Writes
gloss.png (the spheres under one map, and the error over roughness) and gloss.csv.
"""

import argparse
import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple, cast

import numpy as np
from matplotlib import pyplot as plt
from numba import njit, prange
from rich.progress import track

from bench.accuracy.drawing import colour, leave_margin
from bench.accuracy.maps import chosen
from bench.evaluation import Source, points_of, read_source
from tests.support.ray_casting import Hits, first_hits, scene_tree
from vemlight.commands.chart import machine
from vemlight.files import written_whole
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.output.tonemap import adapt, tone_mapped
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Renderer as RendererSettings
from vemlight.settings import Sampler

SIDE = 96  # pixels of a sphere's picture
COUNT = 72  # lights with shadow maps, the paper's number
ROUGHNESS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
Method = Literal["tracked", "havran-azimuth"]
Reflects = Literal["lights", "map"]
METHODS: tuple[Method, ...] = ("tracked", "havran-azimuth")
VARIANTS: tuple[tuple[Method, Reflects], ...] = tuple((method, reflects) for method in METHODS for reflects in ("lights", "map"))
SCENE = """[camera]
from = [0.0, -6.0, 1.5]
at = [0.0, 0.0, 0.0]
fov_y = 21.0
[[mesh]]
shape = "sphere"
material = {{base_color = [0.95, 0.93, 0.88], metallic = 1.0, roughness = {roughness}}}
"""


class Sphere(NamedTuple):
    scene: Scene
    hits: Hits
    truth: np.ndarray  # (SIDE, SIDE, 4) float64, linear


@njit(cache=True, parallel=True)
def _reflected(position, normal, flat, eye, alpha, f0, directions, irradiance, out):
    """GGX of glTF 2.0, appendix B, summed over lights for each point; written from the specification."""
    for p in prange(len(position)):
        view = eye - position[p]
        view /= np.sqrt(np.dot(view, view))
        nv = max(np.dot(normal[p], view), 1e-4)
        for k in range(len(directions)):
            d = directions[k]
            nl = d[0] * normal[p, 0] + d[1] * normal[p, 1] + d[2] * normal[p, 2]
            if nl <= 0.0 or d[0] * flat[p, 0] + d[1] * flat[p, 1] + d[2] * flat[p, 2] <= 0.0:
                continue
            hx, hy, hz = d[0] + view[0], d[1] + view[1], d[2] + view[2]
            size = np.sqrt(hx * hx + hy * hy + hz * hz)
            nh = (hx * normal[p, 0] + hy * normal[p, 1] + hz * normal[p, 2]) / size
            vh = (hx * view[0] + hy * view[1] + hz * view[2]) / size
            a2 = alpha * alpha
            facets = a2 / (np.pi * (nh * nh * (a2 - 1) + 1) ** 2)
            smith = nl * np.sqrt(nv * nv * (1 - a2) + a2) + nv * np.sqrt(nl * nl * (1 - a2) + a2)
            value = facets * 0.5 / smith * nl
            for c in range(3):
                out[p, c] += irradiance[k, c] * value * (f0[c] + (1 - f0[c]) * (1 - vh) ** 5)


def sphere_under(source: Source, roughness: float, folder: Path) -> Sphere:
    """A sphere and its reference picture."""
    path = folder / "sphere.toml"
    path.write_text(SCENE.format(roughness=roughness))
    scene = load_scene(path)
    hits = first_hits(scene, scene_tree(scene), SIDE, SIDE)
    there = hits.triangle >= 0
    light = points_of(source)
    sums = np.zeros((int(there.sum()), 3))
    eye = np.array(scene.camera.position)
    points = (hits.position[there], hits.smooth_normal[there], hits.flat_normal[there])
    _reflected(*points, eye, max(roughness, 0.05) ** 2, np.array([0.95, 0.93, 0.88]), light.directions, light.irradiance, sums)
    truth = np.zeros((SIDE, SIDE, 4))
    truth[there, :3] = sums
    truth[..., 3] = there
    return Sphere(scene, hits, truth)


def lights_of(source: Source, method: Method) -> LightSet:
    """The lights that the sampler gives on a first frame."""
    wanted = Sampler(method=method, count=COUNT, filter="none")
    return step(wanted, initial_state(), SamplerInput(source.polar, "hemisphere", 0.0, source.bright_cells))[1]


def lab(pixels: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of sRGB pixels (height, width, 3) uint8."""
    import cv2

    return cv2.cvtColor(pixels.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)


def errors(sphere: Sphere, picture: np.ndarray) -> tuple[float, float]:
    """Relative RMS of the luminance, and the mean Lab difference as tone-mapped with the truth's adaptation, where the sphere is."""
    there = sphere.truth[..., 3] > 0
    off, true = (picture - sphere.truth)[there][:, :3] @ LUMINANCE_WEIGHTS, sphere.truth[there][:, :3] @ LUMINANCE_WEIGHTS
    seen = [lab(tone_mapped(image, adapt(None, sphere.truth, 0.0), 0.0)[..., :3])[there] for image in (picture, sphere.truth)]
    return float(np.sqrt(np.mean(off**2)) / true.mean()), float(np.linalg.norm(seen[0] - seen[1], axis=-1).mean())


class Row(NamedTuple):
    """A line of gloss.csv. reflects: what narrow lobes reflect. rmse: over the reference's mean. lab: mean difference
    of tone-mapped pixels.
    """

    map: str
    method: Method
    reflects: Reflects
    roughness: float
    rmse: float
    lab: float


def measured(kind: str, source: Source, folder: Path) -> tuple[list[Row], dict[str, np.ndarray]]:
    """The errors under one map, and its strips of spheres by name, (SIDE, n SIDE, 4) uint8."""
    rows: list[Row] = []
    strips: dict[str, list[np.ndarray]] = {"the map itself": []}
    lights = {method: lights_of(source, method) for method in METHODS}
    environment = EnvironmentMap(source.polar, "hemisphere", source.bright_cells)
    for roughness in ROUGHNESS:
        sphere = sphere_under(source, roughness, folder)
        adaptation = adapt(None, sphere.truth, 0.0)
        strips["the map itself"].append(tone_mapped(sphere.truth, adaptation, 0.0))
        renderer = FrameSequence(Renderer(sphere.scene, RendererSettings(width=SIDE, height=SIDE, shadow_map=256)))
        for method, reflects in VARIANTS:
            picture = renderer.render(lights[method], environment if reflects == "map" else None)
            rows.append(Row(kind, method, reflects, roughness, *errors(sphere, picture)))
            strips.setdefault(title(method, reflects), []).append(tone_mapped(picture, adaptation, 0.0))
        renderer.release()
    return rows, {name: np.concatenate(strip, axis=1) for name, strip in strips.items()}


def title(method: Method, reflects: Reflects) -> str:
    return f"{method}, {COUNT} lights" + (" and the map" if reflects == "map" else " alone")


def draw(rows: list[Row], strips: dict[str, np.ndarray], kind: str, out: Path) -> None:
    """The chart: spheres on the left, errors on the right."""
    figure = plt.figure(figsize=(15, 6.5), layout="constrained")
    leave_margin(figure, 0.03)
    left, right = cast(np.ndarray, figure.subfigures(1, 2, width_ratios=(1, 1.1)))
    shown = ["the map itself", *(title(*variant) for variant in VARIANTS)]
    for name, axis in zip(shown, left.subplots(len(shown), 1), strict=True):
        axis.imshow(strips[name])
        axis.set_title(name, fontsize=8)
        axis.set_axis_off()
    left.suptitle(f"{kind}; roughness {', '.join(map(str, ROUGHNESS))}", fontsize=9)
    for measure, label, axis in zip(("rmse", "lab"), ("relative RMSE", "mean difference in L*a*b*"), right.subplots(1, 2), strict=True):
        for k, method in enumerate(METHODS):
            styles: dict[Reflects, str] = {"lights": ":", "map": "-"}
            for reflects, style in styles.items():
                means = [
                    np.mean([getattr(r, measure) for r in rows if (r.method, r.reflects, r.roughness) == (method, reflects, at)])
                    for at in ROUGHNESS
                ]
                axis.plot(ROUGHNESS, means, style, color=colour(k), label=title(method, reflects))
        axis.set(yscale="log", xlabel="roughness", title=label)
        axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=7)
    note = f"Means over {len({r.map for r in rows})} maps.   python -m bench.gloss   {machine()}"
    figure.text(0.01, 0.004, note, fontsize=7, color="0.35")
    with written_whole(out / "gloss.png") as part:
        figure.savefig(part, dpi=85)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "charts")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    strips: dict[str, dict[str, np.ndarray]] = {}
    with TemporaryDirectory() as folder:
        for kind, path in track(chosen().items(), "maps"):
            found, strips[kind] = measured(kind, read_source(path), Path(folder))
            rows += found
    kind = next(iter(strips))
    draw(rows, strips[kind], kind, out)
    with written_whole(out / "gloss.csv") as part, open(part, "w", newline="") as file:
        csv.writer(file).writerows([Row._fields, *((*row[:4], f"{row.rmse:.4g}", f"{row.lab:.4g}") for row in rows)])


if __name__ == "__main__":
    main()
