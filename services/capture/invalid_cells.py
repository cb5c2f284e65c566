"""Cells of maps that are no light: counted, and said in one line."""

import numpy as np

from vemlight.files import notice

INFINITE = 1e30  # and what is above: no sun has 1e10 cd/m2; sums over the sphere then stay far from float32's 3.4e38


def valid_values(radiance: np.ndarray) -> np.ndarray:
    """Which values can be light: finite, as those above INFINITE are not taken to be, and not negative; bool of the same shape."""
    return (radiance < INFINITE) & (radiance >= 0)


class InvalidCells:
    """The invalid cells of one frame after the other. counts: those of frames before, as the property gives them."""

    def __init__(self, counts: tuple[int, int, int, int] = (0, 0, 0, 0)) -> None:
        self._cells, self._invalid, self._frames, self._frames_with = counts

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Cells, invalid ones among them, frames, and frames with invalid cells."""
        return self._cells, self._invalid, self._frames, self._frames_with

    def add(self, radiance: np.ndarray) -> None:
        """Counts those of a map (rows, cols, 3)."""
        invalid = int(np.count_nonzero(~valid_values(radiance).all(axis=-1)))
        self._cells, self._frames = self._cells + radiance[..., 0].size, self._frames + 1
        self._invalid, self._frames_with = self._invalid + invalid, self._frames_with + (invalid > 0)

    def say(self) -> None:
        """One line on stderr, if there are any."""
        if self._invalid:
            where = f" in {self._frames_with} of {self._frames} frames" if self._frames > 1 else ""
            notice(f"{self._invalid} of {self._cells} cells of the map were nan, infinite or negative{where}, and count as dark")
