"""All frames of a recording turned into each light's, by way of a file: 40 bytes a light and frame, however many there are."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.exchange.punctual import angles_deg
from vemlight.light.light_set import LightSet

ROWS_AT_ONCE = 2**13  # 350 kB: of 72 lights a hundred frames, so that numpy's calls take a hundredth each
ROW = np.dtype([("id", "<i8"), ("frame", "<i4"), ("direction", "<f4", 3), ("irradiance", "<f4", 3), ("angle_deg", "<f4")])


class LightRows(NamedTuple):
    """All frames of some lights, light after light, by id. ids: (lights,) int64. bounds: (lights + 1,), between which each one's rows are.

    frames: (n,) int32, ascending within a light. directions: (n, 3), irradiance: (n, 3), angles_deg: (n,), float32.
    """

    ids: np.ndarray
    bounds: np.ndarray
    frames: np.ndarray
    directions: np.ndarray
    irradiance: np.ndarray
    angles_deg: np.ndarray


class LightColumns:
    """Takes frame after frame; then gives light after light. Used as a context, whose file is gone with it."""

    def __init__(self, folder: Path) -> None:
        self.times_s: list[float] = []
        self._file: Any = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115, until the context ends
        self._rows = 0
        self._waiting: list[LightSet] = []  # the newest frames
        self._waiting_rows = 0

    def __enter__(self) -> "LightColumns":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, lights: LightSet, time_s: float) -> None:
        """Adds a frame. Raises OSError when the disk refuses."""
        self._waiting.append(lights)
        self.times_s.append(time_s)
        self._waiting_rows += len(lights.ids)
        if self._waiting_rows >= ROWS_AT_ONCE:
            self._write()

    def _write(self) -> None:
        rows = np.empty(self._waiting_rows, ROW)
        if self._waiting:
            first = len(self.times_s) - len(self._waiting)
            rows["frame"] = np.repeat(np.arange(first, len(self.times_s)), [len(lights.ids) for lights in self._waiting])
            rows["id"] = np.concatenate([lights.ids for lights in self._waiting])
            rows["direction"] = np.concatenate([lights.directions for lights in self._waiting])
            rows["irradiance"] = np.concatenate([lights.irradiance for lights in self._waiting])
            rows["angle_deg"] = np.concatenate([angles_deg(lights) for lights in self._waiting])
        self._file.write(rows.tobytes())
        self._rows += len(rows)
        self._waiting, self._waiting_rows = [], 0

    def lights(self) -> Iterator[LightRows]:
        """All lights by id: as many at once as ROWS_AT_ONCE rows have, one at least."""
        self._write()
        self._file.flush()
        if not self._rows:
            return
        rows = np.asarray(np.memmap(self._file, ROW, mode="r", shape=(self._rows,)))
        order = np.argsort(rows["id"], kind="stable")
        bounds = np.append(np.flatnonzero(np.diff(rows["id"][order], prepend=-1)), self._rows)
        first = 0
        while first < len(bounds) - 1:
            last = max(first + 1, int(np.searchsorted(bounds, bounds[first] + ROWS_AT_ONCE, side="right")) - 1)
            here = rows.take(order[bounds[first] : bounds[last]])  # a quarter of the time of rows[]
            begins = bounds[first : last + 1] - bounds[first]
            arrays = (here[name] for name in ("frame", "direction", "irradiance", "angle_deg"))
            yield LightRows(here["id"][begins[:-1]], begins, *arrays)
            first = last
