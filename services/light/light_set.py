"""A set of directional lights and its file form, `vemlight.lights/1`: one JSON object a frame, one a line in .jsonl."""

from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.files import written_whole
from vemlight.light.sphere import Coverage


class LightSet(NamedTuple):
    """Directional lights of one frame, brightest meaning first only where a method says so.

    ids: (n,) int64, stable while a light lives. directions: (n, 3) float32 unit vectors from the scene to the light.
    irradiance: (n, 3) float32, RGB on a plane that faces the light.
    """

    ids: np.ndarray
    directions: np.ndarray
    irradiance: np.ndarray

    @staticmethod
    def none() -> "LightSet":
        return LightSet.of(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))

    @staticmethod
    def of(ids: np.ndarray, directions: np.ndarray, irradiance: np.ndarray) -> "LightSet":
        """The arrays in their fixed types."""
        return LightSet(
            np.ascontiguousarray(ids, np.int64), np.ascontiguousarray(directions, np.float32), np.ascontiguousarray(irradiance, np.float32)
        )


class LightRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    id: int
    direction: tuple[float, float, float]
    irradiance: tuple[float, float, float]


class LightsRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One frame's lights as they stand in a file."""

    schema: Literal["vemlight.lights/1"] = "vemlight.lights/1"
    sequence: int
    time_s: float
    coverage: Coverage
    lights: list[LightRow]


def lights_row(lights: LightSet, sequence: int, time_s: float, coverage: Coverage) -> LightsRow:
    """The frame's record; float32 values are written with the digits that bring them back exactly."""
    rows = [
        LightRow(i, (d[0], d[1], d[2]), (e[0], e[1], e[2]))
        for i, d, e in zip(lights.ids.tolist(), lights.directions.tolist(), lights.irradiance.tolist(), strict=True)
    ]
    return LightsRow(sequence=sequence, time_s=time_s, coverage=coverage, lights=rows)


def lights_json(row: LightsRow) -> bytes:
    """The record as one line of JSON with the schema's name in it."""
    return msgspec.json.encode({"schema": row.schema, **msgspec.structs.asdict(row)})


def check_lights_path(path: Path, frames: int) -> None:
    """Raises UserError unless `frames` frames can be written there: .json holds exactly one, .jsonl any number."""
    if path.suffix not in (".json", ".jsonl"):
        raise UserError(f"{path}: lights are written as .json or .jsonl; change the suffix")
    if path.suffix == ".json" and frames != 1:
        raise UserError(f"{path}: a .json holds one frame and there are {frames}; name it .jsonl")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: there is no such folder; make it first")


def write_lights(path: Path, rows: list[LightsRow]) -> None:
    """Writes .json (exactly one frame) or .jsonl. Raises UserError for another suffix or several frames in a .json."""
    check_lights_path(path, len(rows))
    with written_whole(path) as part:
        part.write_bytes(b"".join(lights_json(row) + b"\n" for row in rows))


class LightsFile:
    """A .jsonl file that grows by a frame at a time; a line that a killed writer left half is taken away on opening."""

    def __init__(self, path: Path) -> None:
        """Raises UserError when the file cannot be written or holds something else."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "a+b")  # noqa: SIM115, it stays open as long as its writer
        except OSError as error:
            raise UserError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error
        self._file.seek(0)
        lines = self._file.read().split(b"\n")
        self._file.truncate(sum(len(line) + 1 for line in lines[:-1]))
        self.count = len(lines) - 1  # frames in it

    def append(self, lights: LightSet, sequence: int, time_s: float, coverage: Coverage) -> None:
        """Adds a frame; it is out of this process's hands when the call returns."""
        self._file.write(lights_json(lights_row(lights, sequence, time_s, coverage)) + b"\n")
        self._file.flush()
        self.count += 1
