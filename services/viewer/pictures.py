"""Pictures for the page: the polar map as a sky disc, the rendered picture on a dark ground, both as JPEG."""

import cv2
import numpy as np

from vemlight.light.colour import luminance_from_rgb, srgb_from_linear
from vemlight.light.sphere import Coverage, cell_solid_angles
from vemlight.runtime import wire

DISC_PIXELS = 512  # on a side: 256 for the 90 rings of a map, so that a cell is some pixels wide
QUALITY = 88  # of JPEG: no visible blocks on smooth skies, half the bytes of 95
KEY = 0.20  # where the map's log-average goes; Reinhard et al. 2002 propose 0.18 for scenes of average brightness
WHITE = 6.0  # equation 4: what becomes display white, on the scale of KEY
ADAPT = 0.15  # of the way to a new frame's log-average, each frame: at 25 Hz settled within half a second, and nothing flickers
DARK = 1e-6  # of the mean: keeps black cells from ruling the log-average
GROUND = (38, 32, 28)  # blue, green, red: what stands behind a picture where its alpha is 0
GROUND_UNDER = np.rint(np.outer(1 - np.arange(256) / 255, GROUND)).astype(np.uint8)[None]  # what is seen of it under each alpha
LINEAR_STEPS = 4096  # of the linear range: even in the curve's steepest part one step moves less than one code, 12.92 * 255 / 4096 = 0.8


def srgb_codes() -> np.ndarray:
    """The sRGB code (uint8) of LINEAR_STEPS linear values from 0 to 1 (IEC 61966-2-1)."""
    return np.round(255 * srgb_from_linear(np.linspace(0, 1, LINEAR_STEPS))).astype(np.uint8)


SRGB_CODES = srgb_codes()


class Sky:
    """Maps as discs. It remembers the brightness it is adapted to, as the logarithm of a luminance."""

    def __init__(self) -> None:
        self._adapted: float | None = None
        self._shape: tuple[int, ...] = ()
        self._lookup = (np.empty(0, np.int16), np.empty(0, np.uint16))

    def disc_jpeg(self, header: wire.MapMessage, radiance: np.ndarray) -> bytes:
        """The map (rows, cols, 3) as a JPEG of DISC_PIXELS on a side, laid out as `disc_lookup` says."""
        if len(radiance) > DISC_PIXELS:
            radiance = cv2.resize(radiance, (4 * DISC_PIXELS, DISC_PIXELS), interpolation=cv2.INTER_AREA)
        if self._shape != radiance.shape:
            self._shape = radiance.shape
            columns, rows = disc_lookup(*radiance.shape[:2])
            self._lookup = cv2.convertMaps(columns + 1, rows + 1, cv2.CV_16SC2)  # in 32nds of a cell: no pixel of the disc is finer
        codes = _with_neighbours(self.codes(radiance, header.coverage))
        return jpeg(cv2.remap(codes, *self._lookup, cv2.INTER_LINEAR))

    def codes(self, radiance: np.ndarray, coverage: Coverage) -> np.ndarray:
        """The map tone-mapped to (rows, cols, 3) uint8 sRGB, in OpenCV's order blue, green, red. A black map stays black.

        The global operator of Reinhard et al. 2002, equations 1, 2 and 4; its log-average is weighted by solid angle.
        """
        y = luminance_from_rgb(radiance.astype(np.float64))
        area = cell_solid_angles(y.shape[0], y.shape[1], coverage)
        if (mean := float(area @ y.mean(axis=1) / area.sum())) > 0:
            log_average = float(area @ np.log(y + DARK * mean).mean(axis=1) / area.sum())
            self._adapted = log_average if self._adapted is None else self._adapted + ADAPT * (log_average - self._adapted)
        to_key = KEY / np.exp(self._adapted or 0.0)
        gain = to_key * (1 + y * to_key / WHITE**2) / (1 + y * to_key)
        display = np.clip(radiance[..., ::-1] * gain[..., None], 0, 1)
        return SRGB_CODES[np.rint(display * (LINEAR_STEPS - 1)).astype(np.int32)]


def disc_lookup(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the disc's pixels lie in a polar map: (column, row) indices, two arrays (DISC_PIXELS, DISC_PIXELS) float32.

    The sky seen from below as an equidistant fisheye: the zenith in the middle, the end of the map on the rim, +Y at the top and so
    +X at the left. What lies outside the rim gets the rim's row.
    """
    centre = DISC_PIXELS / 2
    right = (np.arange(DISC_PIXELS) + 0.5 - centre) / centre
    up = -right[:, None]
    phi = np.arctan2(up, -right) % (2 * np.pi)
    row = np.minimum(np.hypot(up, right) * rows, rows) - 0.5
    return (phi * (cols / (2 * np.pi)) - 0.5).astype(np.float32), row.astype(np.float32)


def _with_neighbours(codes: np.ndarray) -> np.ndarray:
    """The map with one more cell on each side: round the azimuth, over the pole, and the rim again."""
    over_pole = np.roll(codes[:1], codes.shape[1] // 2, axis=1)
    return np.pad(np.concatenate([over_pole, codes, codes[-1:]]), ((0, 0), (1, 1), (0, 0)), mode="wrap")


def picture_jpeg(pixels: np.ndarray) -> bytes:
    """A picture (height, width, 4) uint8 RGBA, alpha straight, over GROUND, as JPEG."""
    colours, alpha = cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGR), cv2.extractChannel(pixels, 3)
    if alpha.min(initial=255) == 255:  # nothing shows behind it
        return jpeg(colours)
    cover = cv2.cvtColor(alpha, cv2.COLOR_GRAY2BGR)
    return jpeg(cv2.add(cv2.multiply(colours, cover, scale=1 / 255), cv2.LUT(cover, GROUND_UNDER)))


def jpeg(colours: np.ndarray) -> bytes:
    """Blue, green, red (height, width, 3) uint8 as JPEG."""
    done, data = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return data.tobytes()
