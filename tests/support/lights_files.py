"""Reads files of lights, as other programs do."""

from pathlib import Path

import msgspec
import numpy as np

from vemlight.light.light_set import LightSet, LightsRow


def read_lights(path: Path) -> list[LightsRow]:
    """All frames of a .json (one frame) or .jsonl file."""
    text = path.read_bytes()
    return [msgspec.json.decode(line, type=LightsRow) for line in (text.splitlines() if path.suffix == ".jsonl" else [text])]


def light_set_from_row(row: LightsRow) -> LightSet:
    n = len(row.lights)
    extents = [light.covariance or (0.0,) * 6 for light in row.lights]
    return LightSet.of(
        np.array([light.id for light in row.lights], np.int64),
        np.array([light.direction for light in row.lights], np.float32).reshape(n, 3),
        np.array([light.irradiance for light in row.lights], np.float32).reshape(n, 3),
        np.array(extents, np.float32).reshape(n, 6) if row.schema == "vemlight.lights/2" else None,
    )
