"""All frames of a recording turned into one series a light, by way of a file: 40 bytes a light and frame, however many there are."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.exchange.punctual import angles_deg
from vemlight.light.light_set import LightSet

ROW = np.dtype([("id", "<i8"), ("frame", "<i4"), ("direction", "<f4", 3), ("irradiance", "<f4", 3), ("angle_deg", "<f4")])


class LightSeries(NamedTuple):
    """One light's frames. frames: (n,) int32, ascending. directions: (n, 3), irradiance: (n, 3), angles_deg: (n,), float32."""

    id: int
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

    def __enter__(self) -> "LightColumns":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, lights: LightSet, time_s: float) -> None:
        """Adds a frame. Raises OSError when the disk refuses."""
        rows = np.empty(len(lights.ids), ROW)
        rows["id"], rows["frame"] = lights.ids, len(self.times_s)
        rows["direction"], rows["irradiance"], rows["angle_deg"] = lights.directions, lights.irradiance, angles_deg(lights)
        self._file.write(rows.tobytes())
        self._rows += len(rows)
        self.times_s.append(time_s)

    def series(self) -> Iterator[LightSeries]:
        """Each light, by id."""
        self._file.flush()
        if not self._rows:
            return
        rows = np.memmap(self._file, ROW, mode="r", shape=(self._rows,))
        order = np.argsort(rows["id"], kind="stable")
        ends = np.flatnonzero(np.diff(rows["id"][order], append=-1)) + 1
        for begin, end in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True):
            of_light = rows[order[begin:end]]
            arrays = (of_light[name] for name in ("frame", "direction", "irradiance", "angle_deg"))
            yield LightSeries(int(of_light["id"][0]), *arrays)
