"""Reads files of lights frame by frame, `vemlight.lights/1` and `/2`, however long they are."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.files import check_regular, decoded_json, one_line
from vemlight.journal import MAX_LINE_BYTES
from vemlight.light.light_set import LightSet, LightsRow, NearLights, are_covariances
from vemlight.light.near_lights import MAX_METRES, MAX_NEAR_LIGHTS, near_lights_from_rows
from vemlight.light.sphere import Coverage

SUFFIXES = (".json", ".jsonl")
MAX_FILE_BYTES = 2**40  # read line by line: a day at 30 Hz has 50 GB
MAX_LIGHTS = 100_000  # of a frame, as on the wire
MAX_ID = 2**63 - 1
MAX_TIME_S = 1e12  # as on the wire
UNIT = 1e-3  # by which a direction's squared length may be off: three decimals of each number are enough
NO_COVARIANCE = (0.0,) * 6
TURNED = "convert the file, or make it again with `vemlight lights`"


class LightsFrame(NamedTuple):
    """One frame of a file. row_json: its JSON as it stands there. near: None where no near lights were sought."""

    schema: str
    sequence: int
    time_s: float
    coverage: Coverage
    lights: LightSet
    row_json: bytes
    near: NearLights | None = None


class _Named(msgspec.Struct):
    schema: str = ""


_rows = msgspec.json.Decoder(LightsRow)


def is_lights_file(path: str | Path) -> bool:
    """Whether a name is that of a file of lights."""
    return Path(path).suffix.lower() in SUFFIXES


def lights_frames(path: Path) -> Iterator[LightsFrame]:
    """The frames of a .json (one frame) or .jsonl file, in order; one line is in memory at a time.

    Raises UserError that names the line: for what is no frame of lights, a schema that is not known, numbers that no light has (nan,
    negative irradiance, a direction that is no unit vector, a covariance that no directions have), an id twice, a time that does not rise,
    near lights without the place that the directions are true for.
    """
    is_single = path.suffix.lower() == ".json"
    check_regular(path, MAX_LINE_BYTES if is_single else MAX_FILE_BYTES)
    time_s = -1.0
    with open(path, "rb") as file:
        number = 0
        while line := file.read() if is_single else file.readline(MAX_LINE_BYTES):
            number += 1
            if len(line) == MAX_LINE_BYTES:
                raise UserError(f"{path}: line {number}: has {MAX_LINE_BYTES} bytes or more, which no frame has; is it the right file?")
            if not line.strip():
                continue
            frame = _frame(f"{path}: line {number}", line.strip())
            if frame.time_s <= time_s:
                raise UserError(
                    f"{path}: line {number}: time_s {frame.time_s:g} is not after {time_s:g} of the frame before; "
                    "give each recording its own file"
                )
            time_s = frame.time_s
            yield frame
    if time_s < 0:
        raise UserError(f"{path}: holds no frame; make it again with `vemlight lights`")


def _frame(where: str, line: bytes) -> LightsFrame:
    try:
        row = _rows.decode(line)
    except (ValueError, RecursionError, OverflowError, MemoryError) as error:
        raise UserError(f"{where}: {_fault(line, error)}") from error
    if row.sequence < 0 or not 0 <= row.time_s <= MAX_TIME_S:
        raise UserError(f"{where}: sequence {row.sequence} or time_s {row.time_s:g} is below 0 or too large; {TURNED}")
    if len(row.lights) > MAX_LIGHTS:
        raise UserError(f"{where}: has {len(row.lights)} lights, at most {MAX_LIGHTS} are read; merge some: `vemlight lights --clusters`")
    if any(not 0 <= light.id <= MAX_ID for light in row.lights):
        raise UserError(f"{where}: an id is below 0 or above 2^63 - 1; {TURNED}")
    lights = light_set_from_row(row)
    if fault := _impossible(lights):
        raise UserError(f"{where}: {fault}; {TURNED}")
    return LightsFrame(row.schema, row.sequence, row.time_s, row.coverage, lights, line, _near_lights(where, row))


def _near_lights(where: str, row: LightsRow) -> NearLights | None:
    """The row's near lights. Raises UserError for what none can be."""
    if row.at is msgspec.UNSET and row.points is msgspec.UNSET:
        return None
    if row.at is msgspec.UNSET or row.points is msgspec.UNSET:
        raise UserError(f"{where}: has one of the keys at and points, which go together; {TURNED}")
    if row.schema == "vemlight.lights/1":
        raise UserError(f"{where}: has points, which are of schema vemlight.lights/2, and says vemlight.lights/1; {TURNED}")
    if len(row.points) > MAX_NEAR_LIGHTS:
        raise UserError(f"{where}: has {len(row.points)} near lights, at most {MAX_NEAR_LIGHTS} are read; {TURNED}")
    if any(not 0 <= point.id <= MAX_ID for point in row.points) or not all(abs(x) <= MAX_METRES for x in row.at):
        raise UserError(f"{where}: a near light's id is below 0 or above 2^63 - 1, or at is beyond {MAX_METRES:g} m; {TURNED}")
    points = near_lights_from_rows(row.points)
    if fault := points.fault():
        raise UserError(f"{where}: near lights {fault}; {TURNED}")
    return NearLights(points, row.at)


def light_set_from_row(row: LightsRow) -> LightSet:
    """The row's lights as arrays; covariances where the schema has them, 0 for points."""
    covariances = None
    with np.errstate(over="ignore"):  # what is beyond float32 becomes inf
        numbers = np.array([(*light.direction, *light.irradiance) for light in row.lights], np.float32).reshape(-1, 6)
        extended = any(light.covariance for light in row.lights)
        if extended or (row.schema == "vemlight.lights/2" and (row.points is msgspec.UNSET or not row.lights)):
            covariances = np.array([light.covariance or NO_COVARIANCE for light in row.lights], np.float32).reshape(-1, 6)
    return LightSet.of(np.array([light.id for light in row.lights], np.int64), numbers[:, :3], numbers[:, 3:], covariances)


def _impossible(lights: LightSet) -> str:
    """What no light has; empty where all is well."""
    ids, directions, irradiance, covariances = lights
    if not (np.isfinite(directions).all() and np.isfinite(irradiance).all()):
        return "a direction or irradiance is too large for a float32"
    faults = (
        (np.abs(np.einsum("ij,ij->i", directions, directions) - 1) >= UNIT, "has a direction that is no unit vector"),
        ((irradiance < 0).any(axis=1), "has negative irradiance"),
    )
    for wrong, text in faults:
        if wrong.any():
            return f"light {ids[np.argmax(wrong)]} {text}"
    if len(set(ids.tolist())) < len(ids):
        return "an id stands there twice"
    if covariances is not None and not are_covariances(covariances):
        return "a covariance is one that no directions have"
    return ""


def _fault(line: bytes, error: BaseException) -> str:
    """Why a line is no frame: by its schema's name where it has one."""
    try:
        schema = decoded_json(line, _Named).schema
    except ValueError:
        return "is not a frame of lights in JSON; is it the right file, and whole?"
    if schema not in ("vemlight.lights/1", "vemlight.lights/2"):
        return f"schema {schema[:40] or '(none)'} is not vemlight.lights/1 or /2, which are read; is it the right file?"
    return f"is not a frame of lights ({one_line(error).replace('`', '').replace('$', 'frame')}); {TURNED}"
