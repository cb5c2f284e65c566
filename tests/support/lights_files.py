"""Files of lights: read as other programs do, and written at once."""

from pathlib import Path

import msgspec
import numpy as np

from vemlight.light.light_set import LightSet, LightsRow, check_lights_path, lights_json


def read_lights(path: Path) -> list[LightsRow]:
    """All frames of a .json (one frame) or .jsonl file."""
    text = path.read_bytes()
    return [msgspec.json.decode(line, type=LightsRow) for line in (text.splitlines() if path.suffix == ".jsonl" else [text])]


def write_lights(path: Path, rows: list[LightsRow]) -> None:
    """Writes .json (exactly one frame) or .jsonl. Raises UserError for another suffix or several frames in a .json."""
    check_lights_path(path, len(rows))
    path.write_bytes(b"".join(lights_json(row) + b"\n" for row in rows))


def light_set_from_row(row: LightsRow) -> LightSet:
    n = len(row.lights)
    extents = [light.covariance or (0.0,) * 6 for light in row.lights]
    return LightSet.of(
        np.array([light.id for light in row.lights], np.int64),
        np.array([light.direction for light in row.lights], np.float32).reshape(n, 3),
        np.array([light.irradiance for light in row.lights], np.float32).reshape(n, 3),
        np.array(extents, np.float32).reshape(n, 6) if row.schema == "vemlight.lights/2" else None,
    )
