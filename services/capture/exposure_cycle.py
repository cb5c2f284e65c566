"""The exposures that a camera is asked for, frame after frame, and which one a frame has, by its picture.

No driver tells the exposure of a frame, and what is written to a control takes effect one to four frames later. So the first exposure is
held until it must have arrived; from then on exposures are written ahead, and what comes is recognised, never assumed.
"""

from typing import NamedTuple

import numpy as np

from vemlight.capture.exposure_merge import QUANTISING, READ_NOISE, CodeValues

SETTLING = 8  # frames for which the first exposure is held, of which only the last is used: twice the longest delay of a control
GRID = 96  # places across and down an image where a frame is compared; 9,216 at most. 48 to 128 do
MOTION = 0.15  # of the light, that a place may have changed by a camera that sways


class ExposureCycle(NamedTuple):
    """exposures: in s, falling. They are written in this order, again and again, beginning behind `first`."""

    exposures: tuple[float, ...]

    @property
    def first(self) -> int:
        """The exposure that is held at the start: in the middle, or of two the longer, which shows most of what the others see."""
        return (len(self.exposures) - 1) // 2

    def asked_after(self, received: int) -> int | None:
        """The number of the exposure to write when so many frames have come; None while the first one is held."""
        return None if received < SETTLING else (self.first + 1 + received - SETTLING) % len(self.exposures)


class ExposureRecogniser:
    """Says which of several exposures a frame has, from the radiance that was there just before."""

    def __init__(self, values: CodeValues, exposures: tuple[float, ...], spans: np.ndarray) -> None:
        """spans: see `FrameMaker.spans`."""
        self._light, self._exposures = values.light.astype(np.float32), np.array(exposures, np.float32)[:, None]
        height = len(spans)
        width = int(spans[:, 1].max(initial=1))
        y, x = (grid.ravel() for grid in np.meshgrid(*(np.arange(0, n, max(n // GRID, 1)) for n in (height, width)), indexing="ij"))
        inside = (x >= spans[y, 0]) & (x < spans[y, 1])
        self._y, self._x = y[inside], x[inside]
        self._top, self._electron = np.float32(values.light[values.clipped_from]), np.float32(values.electron)
        step = self._top / (values.clipped_from - values.dark) * values.step
        self._read = np.float32((values.electron * READ_NOISE) ** 2 + QUANTISING * step**2)

    def recognised(self, codes: np.ndarray, radiance: np.ndarray, longest: int) -> int:
        """The number of the exposure of a frame's codes, (height, width) or (.., 3). radiance: of the same shape, float32.

        longest: the longest exposure that the radiance was found with, by number: it says how well dark places are known.

        It is the likeliest one: the light of the codes differs from radiance times exposure by noise and motion, sigma, with the tails of
        Cauchy's law, because what moved is no noise.
        """
        seen = np.minimum(self._light[codes[self._y, self._x]].ravel(), self._top)
        expected = np.minimum(radiance[self._y, self._x].ravel() * self._exposures, self._top)
        known = self._read * (1 + (self._exposures / self._exposures[longest]) ** 2)
        sigma = np.sqrt(known + self._electron * np.maximum(expected, 0) + (MOTION * expected) ** 2)
        return int(np.argmin((np.log(sigma) + np.log1p(((seen - expected) / sigma) ** 2)).mean(axis=1)))
