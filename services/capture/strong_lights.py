"""Lights that only the shortest exposure can tell, such as the sun: their flux from its last frame, their place from every frame.

Merged pixel by pixel, a light that moves between two exposures is smeared or lost. So around it the frames are laid on the newest one
before they are merged, and what the shortest exposure saw of it is put where the newest frame shows it, clipped or not.
"""

from typing import NamedTuple

import numpy as np

from vemlight.capture.exposure_merge import CodeValues
from vemlight.kernels import kernel

REACH = 25  # pixels around a light's last place in which it is looked for: 2 degrees at 2 Hz are 7 pixels a frame at 60 a second, 1024 px
RING = 0.8  # of REACH: from there on a pixel belongs to the light's surroundings
ROUNDS = 3  # of moving that window to the centre found in it
FAINT = 0.1  # of the top code, below which a pixel is no part of a light
ROUNDED = 1 - 1e-5  # times the radiance of the highest code, which float32 and a difference round by 1e-6
MAX_STRONG = 8  # lights that are followed, those of most flux; others, and windows larger than REACH, stay where they were seen


class StrongLight(NamedTuple):
    """light: (height, width, channels) float32, radiance of the pixels from `corner` (row, column) on: of one that is followed what the
    shortest exposure saw in its `region` (height, width), bool; of others, whose region is None, what exceeds the ceiling.

    places: its centre in the last frame of each exposure, by number, and x, y in pixels; newest: the exposure of the newest frame.
    """

    light: np.ndarray
    corner: tuple[int, int]
    places: dict[int, np.ndarray]
    newest: int
    region: np.ndarray | None = None

    @property
    def place(self) -> np.ndarray:
        """Its centre in the newest frame."""
        return self.places[self.newest]


def ceiling(values: CodeValues, exposures: tuple[float, ...]) -> float:
    """The radiance above which only the shortest of the falling `exposures` tells any."""
    return float(values.light[values.clipped_from]) / exposures[-2]


def strong_lights(
    frames: dict[int, np.ndarray], values: CodeValues, exposures: tuple[float, ...], spans: np.ndarray, step: int
) -> list[StrongLight]:
    """The lights of the shortest exposure, brightest first. frames: the newest codes of each, (height, width, channels). step: 2 for a
    mosaic, else 1.
    """
    import cv2

    highest, shortest = ceiling(values, exposures), len(exposures) - 1
    codes = frames[shortest]
    radiance = (values.light / exposures[-1]).astype(np.float32)
    mask = _above(codes, int(np.searchsorted(radiance, highest, side="right")), spans)
    if not mask.any():
        return []
    # one pixel more around each: a light smaller than a pixel is now in one, now in four
    joined = cv2.dilate(mask, np.ones((1 + 2 * step, 1 + 2 * step), np.uint8))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    found = []
    for n in range(1, count):
        left, top, width, height = (int(value) for value in boxes[n, :4])
        window = (slice(top, top + height), slice(left, left + width))
        region, seen = labels[window] == n, radiance[codes[window]]
        excess = np.maximum(seen - highest, 0) * (region & (mask[window] > 0))[..., None]
        found.append((float(excess.sum()), excess, np.maximum(seen, 0) * region[..., None], region, (top, left)))
    found.sort(key=lambda row: -row[0])
    lights: list[StrongLight] = []
    for _, excess, whole, region, corner in found:
        y, x = np.indices(region.shape)
        weight = excess.sum(axis=2)
        middle = np.array([(x * weight).sum(), (y * weight).sum()]) / max(float(weight.sum()), 1e-30) + corner[::-1]
        if max(region.shape) <= REACH and len(moving(lights)) < MAX_STRONG:
            place = _centre(codes, middle, values)
            places = {e: place if e == shortest else _centre(frame, place, values) for e, frame in frames.items()}
            lights.append(StrongLight(whole, corner, places, shortest, region))
        else:
            lights.append(StrongLight(excess, corner, dict(zip(frames, [middle] * len(frames), strict=True)), shortest))
    return lights


def clipped_part(light: StrongLight, top: float, highest: float, gain: float) -> StrongLight:
    """So many times what a light's clipped pixels saw. top: radiance of the highest code. highest: see `ceiling`."""
    seen = light.light if light.region is not None else light.light + highest
    return light._replace(light=np.where(seen >= ROUNDED * top, gain * top, 0).astype(np.float32), region=None)


def moving(lights: list[StrongLight]) -> list[StrongLight]:
    """Those that are followed."""
    return [light for light in lights if light.region is not None]


def followed(lights: list[StrongLight], codes: np.ndarray, exposure: int, values: CodeValues) -> list[StrongLight]:
    """The lights where a newer frame, of that exposure, shows them."""
    found = []
    for light in lights:
        place = light.place if light.region is None else _centre(codes, light.place, values)
        found.append(light._replace(places={**light.places, exposure: place}, newest=exposure))
    return found


def window_on(light: StrongLight, exposure: int, shape: tuple[int, ...], step: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the last frame of an exposure that lie, by the light's motion, on the window around it in the newest frame.

    For the newest frame's own exposure they are the window itself. shape: height, width of the image. step: see `add_lights`.
    """
    sides = []
    moved = np.rint((light.places.get(exposure, light.place) - light.place) / step).astype(int) * step
    for middle, by, side in zip(np.rint(light.place[::-1]).astype(int), moved[::-1], shape, strict=False):
        window = np.arange(max(middle - REACH, 0), min(middle + REACH + 1, side))
        sides.append(np.clip(window + by, 0, side - 1))
    return sides[0], sides[1]


def add_lights(lights: list[StrongLight], exposures: int, image: np.ndarray, step: int) -> None:
    """Puts the lights into `image` (height, width, channels), moved as they have. step: 2 for a mosaic, else 1.

    In the region of one that is followed nothing else stays. exposures: how many there are.
    """
    for light in moving(lights):
        assert light.region is not None
        by = np.rint((light.place - light.places[exposures - 1]) / step).astype(int) * step
        rows, columns = np.nonzero(light.region)
        rows, columns = rows + light.corner[0] + by[1], columns + light.corner[1] + by[0]
        inside = (rows >= 0) & (rows < image.shape[0]) & (columns >= 0) & (columns < image.shape[1])
        image[rows[inside], columns[inside]] = 0
    for light in lights:
        across, down = (float(value) for value in light.place - light.places[exposures - 1])
        _add_moved(light.light, light.corner[0], light.corner[1], across, down, step, image)


def _centre(codes: np.ndarray, place: np.ndarray, values: CodeValues) -> np.ndarray:
    """The centre of the codes above FAINT around a place, where there are any: soft, so that no pixel counts at once or not at all."""
    faint = values.dark + FAINT * (values.saturated_from - values.dark)
    for _ in range(ROUNDS):
        found = _weighted_centre(codes, place[0], place[1], REACH, faint, values.dark)
        if not found[2] > 0:
            return place
        place = np.array(found[:2])
    return place


@kernel
def _above(codes, level, spans):
    height, width, channels = codes.shape
    mask = np.zeros((height, width), np.uint8)
    for y in range(height):
        for x in range(spans[y, 0], spans[y, 1]):
            for c in range(channels):
                if codes[y, x, c] >= level:
                    mask[y, x] = 1
    return mask


@kernel
def _weighted_centre(codes, at_x, at_y, reach, faint, dark):
    """x, y and sum of the codes above `faint`, and above the mean of those in the outer ring of the window."""
    height, width, channels = codes.shape
    left, right = max(round(at_x) - reach, 0), min(round(at_x) + reach + 1, width)
    top, bottom = max(round(at_y) - reach, 0), min(round(at_y) + reach + 1, height)
    around, pixels = 0.0, 0
    for y in range(top, bottom):
        for x in range(left, right):
            if (RING * reach) ** 2 < (x - at_x) ** 2 + (y - at_y) ** 2 <= reach * reach:
                pixels += channels
                for c in range(channels):
                    around += codes[y, x, c]
    faint += max(around / max(pixels, 1) - dark, 0.0)
    total, sum_x, sum_y = 0.0, 0.0, 0.0
    for y in range(top, bottom):
        for x in range(left, right):
            if (x - at_x) ** 2 + (y - at_y) ** 2 > reach * reach:
                continue
            for c in range(channels):
                weight = max(codes[y, x, c] - faint, 0.0)
                total += weight
                sum_x += weight * x
                sum_y += weight * y
    if total > 0:
        return sum_x / total, sum_y / total, total
    return at_x, at_y, 0.0


@kernel
def _add_moved(light, top, left, across, down, step, image):
    # each pixel is divided among four, `step` pixels apart, so that flux and centre are kept
    height, width, channels = image.shape
    right, below = int(np.floor(across / step)), int(np.floor(down / step))
    u, v = across / step - right, down / step - below
    for y in range(len(light)):
        for x in range(light.shape[1]):
            for n in range(4):
                weight = (u if n % 2 else 1 - u) * (v if n // 2 else 1 - v)
                row, column = top + y + (below + n // 2) * step, left + x + (right + n % 2) * step
                if weight > 0 and 0 <= row < height and 0 <= column < width:
                    for c in range(channels):
                        image[row, column, c] += weight * light[y, x, c]
