"""The paper's figure 6, as lights on the sky and as pictures under them, 4 to 128 of each method."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from rich.progress import Progress

from bench.accuracy.drawing import few_shades, leave_margin, save
from bench.accuracy.maps import one
from bench.evaluation import points_of, points_of_lights, probe_irradiance, read_source, relative_rms
from bench.methods import POINTS, STILL, settled
from tests.support.scenes import SHAPES
from vemlight.light.colour import LUMINANCE_WEIGHTS, srgb_from_linear
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Size

COUNTS = (4, 8, 16, 32, 64, 128)
METHODS = [next(m for m in STILL if m.name == name) for name in (
    "structured", "Kollig and Keller", "Penrose tiling", "Havran, azimuth first", POINTS
)]  # fmt: skip
REFERENCE = 512  # lights of the picture that others are compared with
DISC = 100  # pixels of a sky's picture


def figure6(out: Path, progress: Progress) -> None:
    """The lights of each method on one sky, and the error they have."""
    path = one("an overcast sky")
    source = read_source(path)
    truth, rows = probe_irradiance(points_of(source)), []
    figure, axes = _sheet((11, 9.6))
    task = progress.add_task("figure 6", total=axes.size)
    picture = few_shades(_disc(source.polar), DISC)
    for line, method in zip(axes, METHODS, strict=True):
        for axis, count in zip(line, COUNTS, strict=True):
            lights, _ = settled(method, count, source)
            got = probe_irradiance(points_of_lights(lights))
            error = relative_rms(got.hard - truth.hard, truth.hard)
            rows.append({"method": method.name, "lights": count, "error_hard": error})
            axis.imshow(picture, extent=(-1, 1, -1, 1), origin="lower", interpolation="none")
            d = lights.directions
            radius = np.sqrt(np.maximum(1 - d[:, 2], 0) / np.maximum(1 - d[:, 2] ** 2, 1e-12))
            power = lights.irradiance @ LUMINANCE_WEIGHTS
            sizes = np.round(np.sqrt(6 + 900 * power / power.sum()))  # points across; equal ones are drawn together, for a small SVG
            for size in np.unique(sizes):
                own = sizes == size
                place = d[own, 0] * radius[own], d[own, 1] * radius[own]
                axis.plot(*place, "o", ms=size, markerfacecolor="none", markeredgecolor="lime", markeredgewidth=0.9)
            _label(axis, count, error)
            progress.advance(task)
        line[0].set_ylabel(method.name, fontsize=9)
    save(figure, rows, out, "figure6", f"{path.stem}, equal-area; circles grow with the light's power; error, hard edges.")


def pictures(out: Path, progress: Progress) -> None:
    """The product's own scene under the lights of each method, and its difference from the picture under REFERENCE lights."""
    source = read_source(one("a sun"))
    figure, axes = _sheet((13, 8.6))
    renderer, rows = FrameSequence(Renderer(load_scene(SHAPES), Size(width=200, height=150, shadow_map=256), 4)), []
    task = progress.add_task("pictures", total=axes.size)
    try:
        truth = np.array(renderer.render(settled(METHODS[-1], REFERENCE, source)[0]))[..., :3]
        for line, method in zip(axes, METHODS, strict=True):
            for axis, count in zip(line, COUNTS, strict=True):
                picture = np.array(renderer.render(settled(method, count, source)[0]))[..., :3]
                error = float(np.sqrt(np.mean(((picture - truth) @ LUMINANCE_WEIGHTS) ** 2)) / np.mean(truth @ LUMINANCE_WEIGHTS))
                rows.append({"method": method.name, "lights": count, "difference": error})
                axis.imshow(few_shades(srgb_from_linear((picture / (picture + truth.mean())).clip(0, 1)), 140), interpolation="none")
                _label(axis, count, error)
                progress.advance(task)
            line[0].set_ylabel(method.name, fontsize=9)
    finally:
        renderer.release()
    save(figure, rows, out, "pictures", f"Under a sun; difference in luminance from the picture under {REFERENCE} tracked lights.")


def _sheet(size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    figure, axes = plt.subplots(len(METHODS), len(COUNTS), figsize=size, layout="constrained")
    leave_margin(figure, 0.03)
    return figure, axes


def _label(axis: Any, count: int, error: float) -> None:
    axis.set_title(f"{count}: {100 * error:.1f} %", fontsize=8)
    axis.set(xticks=[], yticks=[])


def _disc(polar: np.ndarray) -> np.ndarray:
    """A polar map seen from below, equal areas, tone-mapped sRGB, (DISC, DISC, 3)."""
    rows, cols, _ = polar.shape
    x, y = np.meshgrid(np.linspace(-1, 1, DISC), np.linspace(-1, 1, DISC))
    theta = 2 * np.arcsin(np.minimum(np.sqrt((x**2 + y**2) / 2), np.sqrt(0.5)))
    phi = np.arctan2(y, x) % (2 * np.pi)
    row, col = (theta / (np.pi / 2) * rows).astype(int), (phi / (2 * np.pi) * cols).astype(int)
    seen = polar[np.minimum(row, rows - 1), np.minimum(col, cols - 1)]
    seen = seen / (seen + 2 * np.median(seen))
    return np.where((x**2 + y**2 <= 1)[..., None], srgb_from_linear(seen.clip(0, 1)), 1.0)
