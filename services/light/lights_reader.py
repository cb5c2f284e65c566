"""Reads files of lights frame by frame, `vemlight.lights/1` and `/2`, however long they are."""

import codecs
import struct
from collections.abc import Iterator
from itertools import accumulate, chain, pairwise
from pathlib import Path
from typing import BinaryIO, NamedTuple

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
BLOCK_BYTES = 2**17  # of lines whose arrays are made and checked at once: 20 of 72 lights, whose objects stay in the processor's cache
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
    """The frames of a .json (one frame) or .jsonl file, in order; in memory is BLOCK_BYTES of lines at a time, and one line at least.

    Raises UserError that names the line, after the frames before it: for what is no frame of lights, a schema that is not known, numbers
    that no light has (nan, negative irradiance, a direction that is no unit vector, a covariance that no directions have), an id twice, a
    time that does not rise, near lights without the place that the directions are true for.
    """
    is_single = path.suffix.lower() == ".json"
    check_regular(path, MAX_LINE_BYTES if is_single else MAX_FILE_BYTES)
    time_s = -1.0
    with open(path, "rb", buffering=BLOCK_BYTES) as file:  # 8 kB, as without it, are less than a line
        for block in _blocks(_lines(path, file, is_single)):
            for where, frame in _frames(block):
                if frame.time_s <= time_s:
                    raise UserError(
                        f"{where}: time_s {frame.time_s:g} is not after {time_s:g} of the frame before; give each recording its own file"
                    )
                time_s = frame.time_s
                yield frame
    if time_s < 0:
        raise UserError(f"{path}: holds no frame; make it again with `vemlight lights`")


def _lines(path: Path, file: BinaryIO, is_single: bool) -> Iterator[tuple[str, bytes]]:
    """Each line that is not empty, and where it stands; one that is too long is given cut off."""
    number = 0
    while line := file.read() if is_single else file.readline(MAX_LINE_BYTES):
        number += 1
        if number == 1:
            line = line.removeprefix(codecs.BOM_UTF8)
        if stripped := line if len(line) == MAX_LINE_BYTES else line.strip():
            yield f"{path}: line {number}", stripped


def _blocks(lines: Iterator[tuple[str, bytes]]) -> Iterator[list[tuple[str, bytes]]]:
    block, size = [], 0
    for line in lines:
        block.append(line)
        size += len(line[1])
        if size >= BLOCK_BYTES:
            yield block
            block, size = [], 0
    yield block


def _frames(block: list[tuple[str, bytes]]) -> Iterator[tuple[str, LightsFrame]]:
    """The frames of some lines and where they stand. Raises UserError at the first line that is none."""
    rows: list[LightsRow] = []
    late: UserError | None = None
    for where, line in block:
        try:
            rows.append(_row(where, line))
        except UserError as error:
            late = error
            break
    sets, all_possible = _light_sets(rows)
    for (where, line), row, lights in zip(block, rows, sets, strict=False):
        if not all_possible and (fault := _impossible(lights)):
            raise UserError(f"{where}: {fault}; {TURNED}")
        yield where, LightsFrame(row.schema, row.sequence, row.time_s, row.coverage, lights, line, _near_lights(where, row))
    if late:
        raise late


def _row(where: str, line: bytes) -> LightsRow:
    if len(line) == MAX_LINE_BYTES:
        raise UserError(f"{where}: has {MAX_LINE_BYTES} bytes or more, which no frame has; is it the right file?")
    try:
        row = _rows.decode(line)
    except (ValueError, RecursionError, OverflowError, MemoryError) as error:
        raise UserError(f"{where}: {_fault(line, error)}") from error
    if row.sequence < 0 or not 0 <= row.time_s <= MAX_TIME_S:
        raise UserError(f"{where}: sequence {row.sequence} or time_s {row.time_s:g} is below 0 or too large; {TURNED}")
    if len(row.lights) > MAX_LIGHTS:
        raise UserError(f"{where}: has {len(row.lights)} lights, at most {MAX_LIGHTS} are read; merge some: `vemlight lights --clusters`")
    ids = {light.id for light in row.lights}
    if ids and not 0 <= min(ids) <= max(ids) <= MAX_ID:
        raise UserError(f"{where}: an id is below 0 or above 2^63 - 1; {TURNED}")
    if len(ids) < len(row.lights):
        raise UserError(f"{where}: an id stands there twice; {TURNED}")
    return row


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


def _light_sets(rows: list[LightsRow]) -> tuple[list[LightSet], bool]:
    """Each row's lights, parts of larger arrays, and whether all are possible; covariances where the schema has them, 0 for points."""
    lights = list(chain.from_iterable(row.lights for row in rows))
    extents = [light.covariance for light in lights]
    any_extended = any(extents)
    soft = [_has_extents(row, any_extended) for row in rows]
    directions = _floats([light.direction for light in lights], 3)
    irradiance = _floats([light.irradiance for light in lights], 3)
    covariances = _floats([extent or NO_COVARIANCE for extent in extents] if any(soft) else [], 6)
    ids = np.frombuffer(struct.pack(f"{len(lights)}q", *[light.id for light in lights]), np.int64)
    ends = [0, *accumulate(len(row.lights) for row in rows)]
    sets = [
        LightSet(ids[a:b], directions[a:b], irradiance[a:b], covariances[a:b] if is_soft else None)
        for is_soft, (a, b) in zip(soft, pairwise(ends), strict=True)
    ]
    return sets, not _impossible(LightSet(ids, directions, irradiance, covariances))


def _floats(rows: list[tuple[float, ...]], width: int) -> np.ndarray:
    """(n, width) float32, in a third of the time that np.array takes of tuples; what is beyond becomes inf."""
    packed = struct.pack(f"{width * len(rows)}d", *chain.from_iterable(rows))
    with np.errstate(over="ignore"):
        return np.frombuffer(packed).astype(np.float32).reshape(-1, width)


def _has_extents(row: LightsRow, can_be_extended: bool) -> bool:
    if row.schema == "vemlight.lights/2" and (row.points is msgspec.UNSET or not row.lights):
        return True
    return can_be_extended and any(light.covariance for light in row.lights)


def _impossible(lights: LightSet) -> str:
    """What no light has; empty where all is well."""
    ids, directions, irradiance, covariances = lights
    if not (np.isfinite(directions).all() and np.isfinite(irradiance).all()):
        return "a direction or irradiance is too large for a float32"
    faults = (
        (np.abs(np.einsum("ij,ij->i", directions, directions) - 1) >= UNIT, "has a direction that is no unit vector"),
        (irradiance < 0, "has negative irradiance"),
    )
    for wrong, text in faults:
        if wrong.any():
            return f"light {ids[np.argmax(wrong) * len(ids) // wrong.size]} {text}"
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
