"""What the second set of lights does for glossy surfaces: metal spheres of rising roughness under a real map, against the map itself.

    python -m bench.gloss MAP.hdr... --out DIR

The truth sums the map's own pixels of the upper hemisphere at each pixel's centre; a sphere alone casts no shadow that its normals do not
tell. Writes gloss.csv (error of each roughness, method and number of weak lights) and gloss_NAME.png (truth above, then without and with
the second set).
"""

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from bench.judge import Source, points_of, read_source
from bench.renderer_truth import Hits, first_hits, scene_tree
from services.images import write_png
from services.lights import Lights
from services.renderer.renderer import Renderer
from services.renderer.scene import Scene, load_scene
from services.renderer.tonemap import adapt, tone_mapped
from services.sampler.step import initial_state, step
from services.settings import Renderer as RendererSettings
from services.settings import Sampler
from services.sphere import LUMINANCE

SIDE = 96  # pixels of a sphere's picture
COUNT = 72  # strong lights, the paper's number
ROUGHNESS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
WEAK = (0, 256, 512, 1024)
METHODS = ("tracked", "havran-azimuth")
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
    """GGX as glTF 2.0, appendix B, has it, summed over lights for each point; written from the specification."""
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
    """A sphere and its true picture."""
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


def sets_of(source: Source, method: str, weak: int) -> tuple[Lights, Lights]:
    """The strong lights and the weak ones, as the sampler gives them on a first frame."""
    wanted = Sampler(method=method, count=COUNT, fine=weak, filter="none")
    _, lights, report = step(wanted, initial_state(wanted), source.polar, "hemisphere", 0.0, None, source.centroids)
    return lights, report.fine or Lights.none()


def lab(pixels: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of sRGB pixels (height, width, 3) uint8."""
    import cv2

    return cv2.cvtColor(pixels.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)


def errors(sphere: Sphere, picture: np.ndarray) -> tuple[float, float]:
    """Relative RMS of the luminance, and the mean Lab difference as tone-mapped with the truth's adaptation, where the sphere is."""
    there = sphere.truth[..., 3] > 0
    off, true = (picture - sphere.truth)[there][:, :3] @ LUMINANCE, sphere.truth[there][:, :3] @ LUMINANCE
    seen = [lab(tone_mapped(image, adapt(None, sphere.truth, 0.0), 0.0)[..., :3])[there] for image in (picture, sphere.truth)]
    return float(np.sqrt(np.mean(off**2)) / true.mean()), float(np.linalg.norm(seen[0] - seen[1], axis=-1).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    wanted = parser.parse_args()
    wanted.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for path in wanted.maps:
        source = read_source(path)
        sets = {(method, weak): sets_of(source, method, weak) for method in METHODS for weak in WEAK}
        strips: dict[tuple[str, int] | str, list[np.ndarray]] = {}
        for roughness in ROUGHNESS:
            sphere = sphere_under(source, roughness, wanted.out)
            renderer = Renderer(sphere.scene, RendererSettings(width=SIDE, height=SIDE, shadow_map=256))
            adaptation = adapt(None, sphere.truth, 0.0)
            strips.setdefault("truth", []).append(tone_mapped(sphere.truth, adaptation, 0.0))
            for (method, weak), (lights, many) in sets.items():
                picture = renderer.render(lights, many)
                error, difference = errors(sphere, picture)
                rows.append((path.stem, method, weak, roughness, f"{error:.4f}", f"{difference:.3f}"))
                strips.setdefault((method, weak), []).append(tone_mapped(picture, adaptation, 0.0))
            renderer.release()
        (wanted.out / "sphere.toml").unlink()
        chosen = ["truth", *((method, weak) for method in METHODS for weak in (0, 512))]
        sheet = np.concatenate([np.concatenate(strips[name], axis=1) for name in chosen])
        write_png(wanted.out / f"gloss_{path.stem}.png", sheet)
    with open(wanted.out / "gloss.csv", "w", newline="") as file:
        csv.writer(file).writerows([("map", "method", "weak", "roughness", "relative_rmse", "lab"), *rows])


if __name__ == "__main__":
    main()
