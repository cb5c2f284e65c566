"""Detection of a ColorChecker in a frame of code values: the positions of its 24 patches, and the codes of its six gray ones.

The codes need only increase with luminance, so that any response will do: patches are found as even quadrilaterals in their dark frame,
arranged in rows and columns from neighbour to neighbour (which tolerates a fisheye's distortion), and oriented so that their codes are
in the order of the luminances that the chart's maker publishes.
"""

import itertools
import math
from collections import deque
from typing import NamedTuple

import cv2
import numpy as np

from vemlight.errors import UserError
from vemlight.light.colour import LUMINANCE_WEIGHTS

# CIE L* (D50) of the patches, row by row from dark skin to black, published by the maker for charts of 2005 to 2014
LIGHTNESS = np.array(
    [
        [37.99, 65.71, 49.93, 43.14, 55.11, 70.72],
        [62.66, 40.02, 51.12, 30.33, 72.53, 71.94],
        [28.78, 55.26, 42.10, 81.73, 51.94, 51.04],
        [96.54, 81.26, 66.77, 50.87, 35.66, 20.46],
    ]
)
ROWS, COLS = LIGHTNESS.shape
SEARCH_PX = 1600  # longer side to which a frame is reduced for the search: patches then have tens of pixels; 800 to 3200 do
MIN_PATCH_PX = 8.0  # side of a patch there: the smallest whose corners survive the opening by 3 x 3 pixels; 5 to 12 do
SQUARENESS = 0.75  # of a patch's area over its corners' quadrilateral's: charts have 0.9, wrong contours 0.6; 0.65 to 0.85 do
MIN_SIDE_RATIO = 0.7 * SQUARENESS  # of a patch's shortest over its longest side, which a slant of 58 degrees makes of a square
NEIGHBOUR_DISTANCE = (1.05, 1.6)  # in patch sides: published charts have 1.1 to 1.4
MAX_SIDESTEP = 0.35  # of a neighbour across that direction, in patch sides: what a fisheye bends; 0.2 to 0.5 do
NEIGHBOUR_SIZE = (0.7, 1.4)  # of a neighbour's side over the patch's: perspective and bends; 0.5 to 0.85 and the inverse do
MIN_PATCHES = 14  # of the 24 that must be found: more than half, so that no two places of the chart fit the same patches; 13 to 18 do
MIN_RANK_CORRELATION = 0.6  # with the published lightness: photographs have 0.87 and more, a wrong place had 0.32; 0.4 to 0.8 do
SAMPLE_WIDTH = 0.35  # side of the square that is read in a patch, in patch spacings: patches are 0.7 to 0.9 wide; 0.1 to 0.5 do
SAMPLES = 15  # on a side of that square; 5 or more do


class Quadrilateral(NamedTuple):
    """A region that may be a patch."""

    centre: np.ndarray  # (2,)
    sides: np.ndarray  # (2, 2): half the way across, along either side


def find_chart(codes: np.ndarray) -> np.ndarray:
    """Centres of the patches, (4, 6, 2) float64, x and y, in the chart's order, in a frame (height, width) or (.., 3) of codes.

    Raises UserError when no ColorChecker is found.
    """
    gray = codes if codes.ndim == 2 else codes @ LUMINANCE_WEIGHTS
    scale = min(1.0, SEARCH_PX / max(gray.shape))
    small = cv2.resize(gray.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    best, chart = MIN_RANK_CORRELATION, None
    for places in _lattices(_quadrilaterals(small)):
        for window in _windows(places):
            read = _read(small, window) if _within(window, small.shape) else np.zeros((ROWS, COLS))
            order = _rank_correlation(read, LIGHTNESS)
            if order > best and np.all(np.diff(read[-1]) < 0):
                best, chart = order, window
    if chart is None:
        raise UserError("no ColorChecker was found in the frame; name its corners, or take one that is sharp, even and large in the frame")
    return (chart + 0.5) / scale - 0.5


def chart_from_corners(corners: list[tuple[float, float]]) -> np.ndarray:
    """Centres of the patches, (4, 6, 2) float64, from those of the corner patches: dark skin, bluish green, black, white.

    For a view in perspective, without distortion.
    """
    at = np.array([[0, 0], [COLS - 1, 0], [COLS - 1, ROWS - 1], [0, ROWS - 1]], np.float32)
    return _placed(cv2.getPerspectiveTransform(at, np.array(corners, np.float32)))


def gray_codes(codes: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Median codes (6,) float64 of the gray patches, white to black, of a `chart` as `find_chart` gives it.

    Raises UserError when one lies outside the frame.
    """
    if not _within(chart, codes.shape[:2]):
        raise UserError("the ColorChecker lies outside the frame in part; check its corners")
    return _read(codes if codes.ndim == 2 else codes[..., 1], chart)[-1]


def _within(chart: np.ndarray, shape: tuple[int, ...]) -> bool:
    # whether all samples lie in a frame of `shape`
    x, y = np.moveaxis(_sample_pixels(chart), -1, 0)
    return bool(x.min() >= 0 and y.min() >= 0 and x.max() < shape[1] and y.max() < shape[0])


def _sample_pixels(chart: np.ndarray) -> np.ndarray:
    # pixels that are read in each patch, x and y, (4, 6, SAMPLES, SAMPLES, 2)
    along, down = np.gradient(chart, axis=1), np.gradient(chart, axis=0)
    steps = np.linspace(-SAMPLE_WIDTH / 2, SAMPLE_WIDTH / 2, SAMPLES)
    at = chart[:, :, None, None] + steps[:, None] * along[:, :, None, None] + steps[:, None, None] * down[:, :, None, None]
    return np.rint(at).astype(int)


def _read(gray: np.ndarray, chart: np.ndarray) -> np.ndarray:
    # median of each patch, (4, 6)
    x, y = np.moveaxis(_sample_pixels(chart), -1, 0)
    return np.median(gray[y, x].reshape(ROWS, COLS, -1), axis=-1).astype(np.float64)


def _quadrilaterals(gray: np.ndarray) -> list[Quadrilateral]:
    # regions brighter than the frame around them, at several thresholds
    low, high = np.percentile(gray, (0.5, 99.5))
    image = np.clip((gray - low) / max(high - low, 1e-6) * 255, 0, 255).astype(np.uint8)
    smooth = cv2.medianBlur(image, 3)
    found: list[Quadrilateral] = []
    for block, offset in itertools.product((15, 31, 63, 127), (2, -6)):
        lit = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, block, offset)
        lit = cv2.morphologyEx(lit, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        for contour in cv2.findContours(lit, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
            patch = _quadrilateral(contour, max(gray.shape) / 5)
            if patch and not any(np.linalg.norm(patch.centre - other.centre) < 0.5 * MIN_PATCH_PX for other in found):
                found.append(patch)
    return found


def _quadrilateral(contour: np.ndarray, largest: float) -> Quadrilateral | None:
    # the region inside a contour (n, 1, 2), if it is about a square
    area = cv2.contourArea(contour)
    if not MIN_PATCH_PX**2 < area < largest**2:
        return None
    corners = cv2.approxPolyDP(contour, 0.1 * math.sqrt(area), True)[:, 0].astype(np.float64)
    if len(corners) != 4 or not cv2.isContourConvex(corners.astype(np.float32)):
        return None
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    if lengths.min() < MIN_SIDE_RATIO * lengths.max() or area < SQUARENESS * cv2.contourArea(corners.astype(np.float32)):
        return None
    moments = cv2.moments(contour)
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    sides = np.array([corners[1] - corners[0] + corners[2] - corners[3], corners[2] - corners[1] + corners[3] - corners[0]]) / 4
    return Quadrilateral(centre, sides)


def _lattices(patches: list[Quadrilateral]) -> list[dict[tuple[int, int], np.ndarray]]:
    # patches arranged in rows and columns, from neighbour to neighbour: their centres by row and column
    free, found = set(range(len(patches))), []
    while free:
        seed = free.pop()
        places, queue = {(0, 0): seed}, deque([(0, 0, patches[seed].sides)])
        while queue:
            row, col, sides = queue.popleft()
            here = patches[places[row, col]]._replace(sides=sides)
            for axis, sign in itertools.product((0, 1), (1, -1)):
                place = (row + sign, col) if axis else (row, col + sign)
                other = None if place in places else _neighbour(here, 2 * sign * sides[axis], 2 * sides[1 - axis], patches, free)
                if other is not None:
                    free.discard(other)
                    places[place] = other
                    queue.append((*place, _aligned(patches[other].sides, sides)))
        if len(places) >= MIN_PATCHES:
            # a chart is never seen mirrored
            hand = 1 if np.linalg.det(patches[places[0, 0]].sides) > 0 else -1
            found.append({(row, hand * col): patches[n].centre for (row, col), n in places.items()})
    return found


def _neighbour(here: Quadrilateral, step: np.ndarray, across: np.ndarray, patches: list[Quadrilateral], free: set[int]) -> int | None:
    # the patch one `step`, a side's length, from `here`, of about its size; `across` is its other side
    inverse = np.linalg.inv(np.column_stack([step, across]))
    best, found = math.inf, None
    for n in free:
        ahead, aside = inverse @ (patches[n].centre - here.centre)
        size = math.sqrt(abs(np.linalg.det(patches[n].sides) / np.linalg.det(here.sides)))
        near = NEIGHBOUR_DISTANCE[0] < ahead < NEIGHBOUR_DISTANCE[1] and abs(aside) < MAX_SIDESTEP
        if near and NEIGHBOUR_SIZE[0] < size < NEIGHBOUR_SIZE[1] and ahead + abs(aside) < best:
            best, found = ahead + abs(aside), n
    return found


def _aligned(sides: np.ndarray, others: np.ndarray) -> np.ndarray:
    # the same two sides in the order and direction of the neighbour's
    if abs(sides[0] @ others[0]) * np.linalg.norm(sides[1]) < abs(sides[1] @ others[0]) * np.linalg.norm(sides[0]):
        sides = sides[::-1]
    return sides * np.where(np.sum(sides * others, axis=1) < 0, -1, 1)[:, None]


def _windows(places: dict[tuple[int, int], np.ndarray]) -> list[np.ndarray]:
    # all charts of 4 x 6 that contain enough of the places found, as centres (4, 6, 2)
    spots, pixels = np.array(list(places)), np.array(list(places.values()))
    found = []
    for turn in range(4):
        turned = spots if turn % 2 == 0 else spots[:, ::-1] * [1, -1]
        turned = turned if turn < 2 else -turned
        for row, col in itertools.product(range(turned[:, 0].min() - ROWS + 1, turned[:, 0].max() + 1),
                                          range(turned[:, 1].min() - COLS + 1, turned[:, 1].max() + 1)):
            at = turned - (row, col)
            inside = np.all((at >= 0) & (at < (ROWS, COLS)), axis=1)
            if np.count_nonzero(inside) >= MIN_PATCHES:
                found.append(_filled(at[inside], pixels[inside]))
    return [chart for chart in found if chart is not None]


def _filled(at: np.ndarray, pixels: np.ndarray) -> np.ndarray | None:
    # centres (4, 6, 2): those of the patches found, elsewhere by the homography of the others
    homography, _ = cv2.findHomography(at[:, ::-1].astype(np.float32), pixels.astype(np.float32), cv2.RANSAC, 0.3 * _spacing(at, pixels))
    if homography is None:
        return None
    chart = _placed(homography)
    off = np.linalg.norm(chart[at[:, 0], at[:, 1]] - pixels, axis=1) < 0.5 * _spacing(at, pixels)
    chart[at[off, 0], at[off, 1]] = pixels[off]
    return chart


def _spacing(at: np.ndarray, pixels: np.ndarray) -> float:
    apart = np.linalg.norm(pixels[:, None] - pixels, axis=-1) / np.maximum(np.linalg.norm(at[:, None] - at, axis=-1), 1)
    return float(np.median(apart[np.triu_indices(len(at), 1)]))


def _placed(pixel_from_chart: np.ndarray) -> np.ndarray:
    at = np.stack(np.meshgrid(np.arange(COLS), np.arange(ROWS)), -1).reshape(-1, 1, 2).astype(np.float64)
    return cv2.perspectiveTransform(at, np.asarray(pixel_from_chart, np.float64)).reshape(ROWS, COLS, 2)


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    # Spearman's: the correlation of the ranks
    a, b = (np.argsort(np.argsort(values.ravel())) - (values.size - 1) / 2 for values in (a, b))
    return float(a @ b / math.sqrt((a @ a) * (b @ b)))
