"""A set of directional lights and its file form: one JSON object a frame, one a line in .jsonl.

`vemlight.lights/1` holds directions; in `vemlight.lights/2` a light may have a covariance, and a frame near lights.
"""

from collections import deque
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.journal import JOURNAL_START, Journal, JournalPoint
from vemlight.light.near_lights import NearLightRow, NearLightSet, near_light_rows
from vemlight.light.sphere import Coverage

MAX_ROUNDING = 1e-6  # of a covariance: ten roundings of float32
MATRIX_OF_SIX = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]  # which of a covariance's six numbers each cell of its matrix is
SIX_OF_MATRIX = [0, 1, 2, 4, 5, 8]  # and back, of its nine cells in a row


class LightSet(NamedTuple):
    """Directional lights of one frame, brightest meaning first only where a method says so.

    ids: (n,) int64, stable while a light lives. directions: (n, 3) float32 unit vectors from the scene to the light.
    irradiance: (n, 3) float32, RGB on a plane that faces the light. covariances: (n, 6) float32, xx xy xz yy yz zz of the directions of a
    light's light about their mean sqrt(1 - xx - yy - zz) x direction, weighted by luminance; None: all lights are points.
    """

    ids: np.ndarray
    directions: np.ndarray
    irradiance: np.ndarray
    covariances: np.ndarray | None = None

    @staticmethod
    def none() -> "LightSet":
        return LightSet.of(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))

    @staticmethod
    def of(ids: np.ndarray, directions: np.ndarray, irradiance: np.ndarray, covariances: np.ndarray | None = None) -> "LightSet":
        """The arrays in their fixed types."""
        extents = None if covariances is None else np.ascontiguousarray(covariances, np.float32)
        return LightSet(
            np.ascontiguousarray(ids, np.int64), np.ascontiguousarray(directions, np.float32), np.ascontiguousarray(irradiance, np.float32),
            extents,
        )  # fmt: skip


def are_covariances(covariances: np.ndarray) -> bool:
    """Whether directions can vary so: (n, 6) finite, no eigenvalue below 0 and no trace above 1 by more than MAX_ROUNDING.

    No eigenvalue is below -r where no principal minor of the matrix plus r times one is below 0 (Sylvester's criterion of semidefinite
    matrices): a twentieth of the time of the eigenvalues.
    """
    if not np.isfinite(covariances).all():
        return False
    xx, xy, xz, yy, yz, zz = covariances.astype(np.float64).T
    if (xx + yy + zz).max(initial=0.0) > 1 + MAX_ROUNDING:
        return False
    xx, yy, zz = xx + MAX_ROUNDING, yy + MAX_ROUNDING, zz + MAX_ROUNDING
    of_yz = yy * zz - yz**2
    minors = (xx, yy, zz, of_yz, xx * yy - xy**2, xx * zz - xz**2, xx * of_yz - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))
    return all(minor.min(initial=0.0) >= 0 for minor in minors)


class ErrorOfLights(msgspec.Struct, frozen=True):
    """Per cent, at hard edges, relative to what each surface receives. estimate: of these lights. limit: what was asked for."""

    estimate: float
    limit: float


class LightRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, gc=False):  # no cycles: half the time to read
    id: int
    direction: tuple[float, float, float]
    irradiance: tuple[float, float, float]
    covariance: tuple[float, float, float, float, float, float] | None = None  # left out: a point


class LightsRow(msgspec.Struct, frozen=True, kw_only=True):
    """One frame's lights as they stand in a file; readers pass over keys that they do not know."""

    schema: Literal["vemlight.lights/1", "vemlight.lights/2"] = "vemlight.lights/1"
    sequence: int
    time_s: float
    coverage: Coverage
    error_percent: ErrorOfLights | msgspec.UnsetType = msgspec.UNSET  # left out where the number of lights is fixed
    clipped: bool | msgspec.UnsetType = msgspec.UNSET  # true where the map holds less light than there was; else left out
    estimated_lux: float | msgspec.UnsetType = msgspec.UNSET  # with clipped: what was estimated of it, on a level surface; else left out
    at: tuple[float, float, float] | msgspec.UnsetType = msgspec.UNSET  # with points: the place, m, that the directions are true for
    points: list[NearLightRow] | msgspec.UnsetType = msgspec.UNSET  # near lights, which `lights` are without; left out: none were sought
    lights: list[LightRow]


class NearLights(NamedTuple):
    """The near lights of a frame, and the place (x, y, z) m for which its directional lights are true."""

    points: NearLightSet
    at: tuple[float, float, float]


def lights_row(
    lights: LightSet,
    sequence: int,
    time_s: float,
    coverage: Coverage,
    error: ErrorOfLights | None = None,
    clipped: bool = False,
    near: NearLights | None = None,
    estimated_lux: float = 0.0,
) -> LightsRow:
    """The frame's record; float32 values are written with the digits that bring them back exactly.

    clipped: light of the frame was clipped in its shortest exposure, too, so that the lights are a lower bound, or, with estimated_lux, an
    estimate. near: of several cameras.
    """
    soft = lights.covariances is not None
    extents = [tuple(c) for c in lights.covariances.tolist()] if lights.covariances is not None else [None] * len(lights.ids)
    rows = [
        LightRow(i, (d[0], d[1], d[2]), (e[0], e[1], e[2]), c)
        for i, d, e, c in zip(lights.ids.tolist(), lights.directions.tolist(), lights.irradiance.tolist(), extents, strict=True)
    ]
    return LightsRow(
        schema="vemlight.lights/2" if soft or near else "vemlight.lights/1",
        sequence=sequence,
        time_s=time_s,
        coverage=coverage,
        error_percent=msgspec.UNSET if error is None else error,
        clipped=clipped or msgspec.UNSET,
        estimated_lux=estimated_lux or msgspec.UNSET,
        at=near.at if near else msgspec.UNSET,
        points=near_light_rows(near.points) if near else msgspec.UNSET,
        lights=rows,
    )


def lights_json(row: LightsRow) -> bytes:
    """The record as one line of JSON with the schema's name in it."""
    fields = {key: value for key, value in msgspec.structs.asdict(row).items() if value is not msgspec.UNSET}
    return msgspec.json.encode({"schema": row.schema, **fields})


def check_lights_path(path: Path, frames: int) -> None:
    """Raises UserError unless `frames` frames can be written there: .json holds exactly one, .jsonl any number."""
    if path.suffix not in (".json", ".jsonl"):
        raise UserError(f"{path}: lights are written as .json or .jsonl; change the suffix")
    if path.suffix == ".json" and frames != 1:
        raise UserError(f"{path}: a .json holds one frame and there are {frames}; name it .jsonl")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: there is no such folder; make it first")


class LightsFile:
    """A .jsonl file that grows by a frame at a time, as a journal (services/journal.py): its lines have a key `chain` more.

    `count`: frames in it. `end`: the point behind the last.
    """

    def __init__(self, path: Path, can_be_made_again: bool, checked_until: JournalPoint = JOURNAL_START) -> None:
        """Opens it and removes what is not whole, with a notice where that is more than a crash leaves.

        checked_until: a point, so that a long file need not be read again; one that is not in the file is ignored. Raises UserError when
        the file cannot be written, holds something else, or is damaged and frames cannot be made again.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._journal = Journal(path)
            if not self._journal.holds(checked_until):
                checked_until = JOURNAL_START
            whole = deque((point for _, point in self._journal.lines(checked_until)), maxlen=1)
            end = whole[0] if whole else checked_until
            if self._journal.keep(end, can_be_made_again) > 1:
                notice(f"{path}: line {end.lines + 1} is damaged; its lights and those that follow are made again")
        except OSError as error:
            raise UserError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error

    @property
    def count(self) -> int:
        return self._journal.end.lines

    @property
    def end(self) -> JournalPoint:
        return self._journal.end

    def append(
        self,
        lights: LightSet,
        sequence: int,
        time_s: float,
        coverage: Coverage,
        error: ErrorOfLights | None = None,
        near: NearLights | None = None,
        clipped: bool = False,
        estimated_lux: float = 0.0,
    ) -> None:
        """Adds a frame; it is on the disk when the call returns. Raises OSError when the disk refuses."""
        self._journal.append(lights_json(lights_row(lights, sequence, time_s, coverage, error, clipped, near, estimated_lux)))

    def close(self) -> None:
        self._journal.close()
