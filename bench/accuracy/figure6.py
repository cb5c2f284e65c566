"""The paper's figure 6, as lights on the sky and as pictures under them, 4 to 128 of each method."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from rich.progress import Progress

from bench.accuracy.drawing import few_shades, leave_margin, save
from bench.accuracy.maps import one
from bench.evaluation import judged_hard, points_of, probe_irradiance, read_source, relative_rms
from bench.methods import POINTS, SOFT, STILL, settled
from tests.support.scenes import SHAPES
from vemlight.light.colour import LUMINANCE_WEIGHTS, srgb_from_linear
from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Size

COUNTS = (4, 8, 16, 32, 64, 128)
METHODS = [next(m for m in STILL if m.name == name) for name in (
    "structured", "Kollig and Keller", "Penrose tiling", "Havran, azimuth first", POINTS, SOFT
)]  # fmt: skip
REFERENCE = 1024  # lights, points, of the picture that others are compared with: their own error is a tenth of that of 64
DISC = 100  # pixels of a sky's picture


def figure6(out: Path, progress: Progress) -> None:
    """The lights of each method on one sky, and the error they have."""
    path = one("an overcast sky")
    source = read_source(path)
    truth, rows = probe_irradiance(points_of(source)), []
    figure, axes = _sheet((11, 11.4))
    task = progress.add_task("figure 6", total=axes.size)
    picture = few_shades(_disc(source.polar), DISC)
    for line, method in zip(axes, METHODS, strict=True):
        for axis, count in zip(line, COUNTS, strict=True):
            lights, _ = settled(method, count, source)
            error = relative_rms(judged_hard(lights) - truth.hard, truth.hard)
            rows.append({"method": method.name, "lights": count, "error_hard": error})
            axis.imshow(picture, extent=(-1, 1, -1, 1), origin="lower", interpolation="none")
            place, power = _on_disc(lights.directions), lights.irradiance @ LUMINANCE_WEIGHTS
            if lights.covariances is not None:
                for outline in _outlines(lights):
                    axis.plot(*_on_disc(outline).T, color="orange", lw=0.8)
            sizes = np.round(np.sqrt(6 + 900 * power / power.sum()))  # points across; equal ones are drawn together, for a small SVG
            for size in np.unique(sizes):
                axis.plot(*place[sizes == size].T, "o", ms=size, markerfacecolor="none", markeredgecolor="lime", markeredgewidth=0.9)
            _label(axis, count, error)
            progress.advance(task)
        line[0].set_ylabel(method.name.replace(" (", "\n("), fontsize=9)
    note = f"{path.stem}, equal-area; circles grow with the light's power, orange: extents, one sigma; error, hard edges."
    save(figure, rows, out, "figure6", note)


def pictures(out: Path, progress: Progress) -> None:
    """The product's own scene under the lights of each method, and its difference from the picture under REFERENCE lights."""
    source = read_source(one("a sun"))
    figure, axes = _sheet((13, 10.2))
    renderer, rows = FrameSequence(Renderer(load_scene(SHAPES), Size(width=200, height=150), 4)), []
    task = progress.add_task("pictures", total=axes.size)
    try:
        truth = np.array(renderer.render(settled(next(m for m in METHODS if m.name == POINTS), REFERENCE, source)[0]))[..., :3]
        for line, method in zip(axes, METHODS, strict=True):
            for axis, count in zip(line, COUNTS, strict=True):
                picture = np.array(renderer.render(settled(method, count, source)[0]))[..., :3]
                error = float(np.sqrt(np.mean(((picture - truth) @ LUMINANCE_WEIGHTS) ** 2)) / np.mean(truth @ LUMINANCE_WEIGHTS))
                rows.append({"method": method.name, "lights": count, "difference": error})
                axis.imshow(few_shades(srgb_from_linear((picture / (picture + truth.mean())).clip(0, 1)), 140), interpolation="none")
                _label(axis, count, error)
                progress.advance(task)
            line[0].set_ylabel(method.name.replace(" (", "\n("), fontsize=9)
    finally:
        renderer.release()
    save(figure, rows, out, "pictures", f"Under a sun; difference in luminance from the picture under {REFERENCE} tracked points.")


def _sheet(size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    figure, axes = plt.subplots(len(METHODS), len(COUNTS), figsize=size, layout="constrained")
    leave_margin(figure, 0.03)
    return figure, axes


def _on_disc(directions: np.ndarray) -> np.ndarray:
    """(n, 2) on the disc of equal areas from directions (n, 3) of the upper hemisphere."""
    z = directions[:, 2:]
    return directions[:, :2] * np.sqrt(np.maximum(1 - z, 0) / np.maximum(1 - z * z, 1e-12))


def _outlines(lights: LightSet) -> np.ndarray:
    """(n, 25, 3) directions, one sigma around each light of extent."""
    turn = np.linspace(0, 2 * np.pi, 25)[None, :, None]
    extents = Extents.of(lights)
    across, along = extents.axes[:, None, 0], extents.axes[:, None, 1]
    around = lights.directions[:, None] + across * np.cos(turn) + along * np.sin(turn)
    return around / np.linalg.norm(around, axis=-1, keepdims=True)


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
