"""Masks over a map: the light of regions of the sphere left out, or filled from around them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from vemlight.capture.frames import Frame
from vemlight.capture.ground import with_ground
from vemlight.capture.source import FrameSource
from vemlight.files import notice
from vemlight.light.bright_cells import BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.mask import Mask
from vemlight.light.sphere import SPAN, Coverage, angles_from_direction
from vemlight.settings import Capture

RASTER_PIXELS = 2048  # of the disc on which masks are drawn, on a side: 11 a degree of a hemisphere; 512 to 4096 would do
FIXED_POINT_BITS = 4  # of a pixel, in which OpenCV takes coordinates: a 16th
SAMPLES = 3  # on a side of a cell, whose mean is how much of it is covered; 2 to 4 would do
MAX_SAMPLES = 2**21  # of a map: of larger ones each cell counts by its middle
MAX_FILLED_CELLS = 80_000  # a map of the sphere of 180 x 360 has 64,800; factoring its equations takes a second, once
RIM_REACH = 3  # cells to either side, whose median says what is usual at a rim: 2 to 5 would do
RIM_PEAK = 4.0  # times that, above which a rim's cell is a source beside the mask, such as a sun, and counts as so much; 3 to 8 would do
LEAK = 1e-12  # of a cell's conductances: where nothing is around a region, its fill is dark, and the equations stay solvable


class MaskWeights(NamedTuple):
    """Masks over maps of one size. dark, filled: (rows, cols) float32, the fraction of each cell that is left out, or filled.

    dark_raster, filled_raster: uint8, the disc they were drawn on. unknown: flat indices (n,) of the cells with filled > 0. solve: from the
    rim's radiance (cells, 3) float64, in which only cells outside of every mask count, to that of the unknown cells (n, 3).
    """

    dark: np.ndarray
    filled: np.ndarray
    dark_raster: np.ndarray
    filled_raster: np.ndarray
    unknown: np.ndarray
    solve: Callable[[np.ndarray], np.ndarray]


def mask_weights(masks: Sequence[Mask], rows: int, cols: int, coverage: Coverage) -> MaskWeights:
    """What the masks cover of a polar map. More than MAX_FILLED_CELLS to fill are dark instead, which a notice says."""
    rasters = {mode: _raster([mask for mask in masks if mask.mode == mode], coverage) for mode in ("dark", "fill")}
    dark, filled = (_covered(rasters[mode], rows, cols, coverage) for mode in ("dark", "fill"))
    filled = np.minimum(filled, 1 - dark)
    unknown = np.flatnonzero(filled)
    if len(unknown) > MAX_FILLED_CELLS:
        found = f"[capture] masks fill {len(unknown)} cells of the map and at most {MAX_FILLED_CELLS} can be"
        notice(f"{found}; they are dark: lower rows and cols")
        dark, filled, unknown = np.minimum(dark + filled, 1), np.zeros_like(filled), unknown[:0]
    return MaskWeights(dark, filled, rasters["dark"], rasters["fill"], unknown, _harmonic(unknown, dark, rows, cols, coverage))


def _raster(masks: Sequence[Mask], coverage: Coverage) -> np.ndarray:
    """The masks drawn on the disc, 1 inside, (RASTER_PIXELS, RASTER_PIXELS) uint8: x and y as in the world, the polar angle as radius."""
    import cv2

    raster = np.zeros((RASTER_PIXELS, RASTER_PIXELS), np.uint8)
    per_deg = RASTER_PIXELS / 2 / np.degrees(SPAN[coverage])
    for mask in masks:
        azimuth, elevation = np.array(mask.points, np.float64).T
        radius, phi = (90 - elevation) * per_deg, np.radians(azimuth)
        place = np.stack([radius * np.cos(phi), radius * np.sin(phi)], axis=-1) + RASTER_PIXELS / 2 - 0.5
        points = np.rint(place * 2**FIXED_POINT_BITS).astype(np.int32)
        if mask.width_deg:
            own = np.zeros_like(raster)
            width = max(1, round(mask.width_deg * per_deg))
            cv2.polylines(own, [points], False, 1, width, cv2.LINE_8, FIXED_POINT_BITS)
            if len(points) == 1:
                cv2.circle(own, tuple(points[0].tolist()), width * 2**FIXED_POINT_BITS // 2, 1, -1, cv2.LINE_8, FIXED_POINT_BITS)
        else:
            own = cv2.fillPoly(np.zeros_like(raster), [points], 1, cv2.LINE_8, FIXED_POINT_BITS)
        np.maximum(raster, own, out=raster)
    return raster


def _inside(raster: np.ndarray, theta: np.ndarray, phi: np.ndarray, coverage: Coverage) -> np.ndarray:
    """The raster's values at directions."""
    radius = theta * (RASTER_PIXELS / 2 / SPAN[coverage])
    x, y = (np.clip((radius * turn(phi) + RASTER_PIXELS / 2).astype(np.int64), 0, RASTER_PIXELS - 1) for turn in (np.cos, np.sin))
    return raster[y, x]


def _covered(raster: np.ndarray, rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    """The fraction of each cell inside, (rows, cols) float32."""
    if not raster.any():
        return np.zeros((rows, cols), np.float32)
    side = SAMPLES if rows * cols * SAMPLES**2 <= MAX_SAMPLES else 1
    theta = (np.arange(rows * side) + 0.5) * (SPAN[coverage] / (rows * side))
    phi = (np.arange(cols * side) + 0.5) * (2 * np.pi / (cols * side))
    inside = _inside(raster, theta[:, None], phi[None, :], coverage)
    return inside.reshape(rows, side, cols, side).mean(axis=(1, 3), dtype=np.float32)


def _harmonic(unknown: np.ndarray, dark: np.ndarray, rows: int, cols: int, coverage: Coverage) -> Callable[[np.ndarray], np.ndarray]:
    """Solves Laplace's equation on the sphere in the unknown cells, with the cells around as the boundary, and none at dark ones.

    Finite volumes: two cells exchange as much as their common edge is long, over the distance of their middles. So the fill has the rim's
    values at the rim, and lies between the smallest and the largest of them (the maximum principle); at a map's end nothing flows.
    """
    if not len(unknown):
        return lambda radiance: np.zeros((0, radiance.shape[-1]))
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    number = np.full(rows * cols, -1, np.int64)
    number[unknown] = np.arange(len(unknown))
    row, col = np.divmod(unknown, cols)
    height, width = SPAN[coverage] / rows, 2 * np.pi / cols
    middle, edge = np.sin((np.arange(rows) + 0.5) * height), np.sin(np.arange(rows + 1) * height)
    own, other, conductance = [], [], []
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        at = row + down
        inside = (at >= 0) & (at < rows)
        between = height / (middle[row] * width) if right else edge[row + (down > 0)] * width / height
        neighbour = np.clip(at, 0, rows - 1) * cols + (col + right) % cols
        used = inside & (dark.ravel()[neighbour] == 0)
        own.append(np.flatnonzero(used))
        other.append(neighbour[used])
        conductance.append(between[used])
    i, j, c = np.concatenate(own), np.concatenate(other), np.concatenate(conductance)
    diagonal = np.bincount(i, c, len(unknown))
    diagonal += LEAK * np.maximum(diagonal, 1)
    both = number[j] >= 0
    count = np.arange(len(unknown))
    entries = np.concatenate([diagonal, -c[both]]), (np.concatenate([count, i[both]]), np.concatenate([count, number[j[both]]]))
    factors = splu(coo_matrix(entries, shape=(len(unknown), len(unknown))).tocsc())
    rim_i, rim_c = i[~both], c[~both]
    rim, rim_j = np.unique(j[~both], return_inverse=True)
    around = _cells_around(rim, (number < 0) & (dark.ravel() == 0), rows, cols)

    def solve(radiance: np.ndarray) -> np.ndarray:
        flow = rim_c[:, None] * _without_peaks(radiance, rim, around)[rim_j]
        known = np.stack([np.bincount(rim_i, flow[:, k], len(unknown)) for k in range(radiance.shape[-1])], axis=-1)
        return np.maximum(factors.solve(known), 0)

    return solve


def _cells_around(cells: np.ndarray, seen: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """The cells within RIM_REACH of each of `cells` (n,) that are `seen` (rows * cols,), flat indices (n, m); -1 for others."""
    row, col = np.divmod(cells, cols)
    near = np.arange(-RIM_REACH, RIM_REACH + 1)
    down, right = row[:, None, None] + near[:, None], (col[:, None, None] + near) % cols
    found = np.clip(down, 0, rows - 1) * cols + right
    return np.where((down >= 0) & (down < rows) & seen[found], found, -1).reshape(len(cells), len(near) ** 2)


def _without_peaks(radiance: np.ndarray, cells: np.ndarray, around: np.ndarray) -> np.ndarray:
    """The radiance (n, 3) of cells of a map (cells, 3), of no more luminance than RIM_PEAK times the median of what is around."""
    luminance = luminance_from_rgb(radiance)
    usual = np.nanmedian(np.where(around >= 0, luminance[around], np.nan), axis=1)
    own = luminance[cells]
    return radiance[cells] * np.minimum(1, RIM_PEAK * usual / np.maximum(own, 1e-30))[:, None]


class Masking:
    """Masks frames of one source; what the masks cover is computed when they change."""

    def __init__(self, settings: Capture) -> None:
        self._albedo = settings.ground
        self._coverage: Coverage = settings.coverage
        self._of: tuple[object, ...] = ()
        self._weights: MaskWeights | None = None

    def masked(self, frame: Frame, masks: tuple[Mask, ...]) -> Frame:
        """The frame without the light of the masks; a ground is lit by what is left."""
        if not masks:
            return frame
        sky = frame.radiance[: len(frame.radiance) // 2] if self._albedo else frame.radiance
        rows, cols, _ = sky.shape
        if self._of != (masks, rows, cols):
            self._of, self._weights = (masks, rows, cols), mask_weights(masks, rows, cols, self._coverage)
        assert self._weights
        radiance, bright = masked_map(sky, frame.bright_cells, self._weights, self._coverage)
        cells = int(np.count_nonzero(self._weights.dark + self._weights.filled))
        if self._albedo:
            radiance = with_ground(radiance, bright, self._albedo)
        return frame._replace(radiance=radiance, bright_cells=bright, masks=masks, masked_cells=cells)


def masked_map(
    radiance: np.ndarray, bright: BrightCells, weights: MaskWeights, coverage: Coverage
) -> tuple[np.ndarray, BrightCells]:
    """A polar map (rows, cols, 3) float32 and its bright cells without what the masks cover.

    Of a bright cell that part of the light is covered whose samples are. Cells that are nan, infinite or negative count as dark around a
    fill, and are gone where they are wholly covered.
    """
    rows, cols, _ = radiance.shape
    dark, filled = weights.dark.ravel().copy(), weights.filled.ravel().copy()
    if len(bright.cells):
        theta, phi = angles_from_direction(bright.directions)
        under = [_inside(raster, theta, phi, coverage) > 0 for raster in (weights.dark_raster, weights.filled_raster)]
        under[1] &= ~under[0]
        cells, place = np.unique(bright.cells, return_inverse=True)
        dark[cells], filled[cells] = (np.bincount(place, bright.weights * each, len(cells)) for each in under)
        left = ~(under[0] | under[1])
        of_cell = np.bincount(place, bright.weights * left, len(cells))[place]
        share = np.divide(bright.weights, of_cell, out=np.zeros(len(place), np.float64), where=of_cell > 0).astype(np.float32)
        bright = BrightCells(bright.cells[left], bright.directions[left], np.minimum(share[left], 1))
    seen = radiance.reshape(-1, 3)
    kept = np.clip(1 - dark - filled, 0, 1)
    made = np.zeros_like(seen)
    np.multiply(seen, kept[:, None].astype(np.float32), out=made, where=kept[:, None] > 0)
    if len(weights.unknown):
        light = np.where(np.isfinite(seen) & (seen > 0), seen, 0).astype(np.float64)
        made[weights.unknown] += (filled[weights.unknown, None] * weights.solve(light)).astype(np.float32)
    return made.reshape(rows, cols, 3), bright


class MaskedSource:
    """A source of frames without the light of the settings' masks; see `vemlight.capture.source.FrameSource`."""

    def __init__(self, source: FrameSource, settings: Capture) -> None:
        self._source, self._masks, self._masking = source, settings.masks, Masking(settings)

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self._source.fps

    def __len__(self) -> int:
        return len(self._source)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises UserError for a file that cannot be used."""
        return self._masking.masked(self._source.frame(k), self._masks)
