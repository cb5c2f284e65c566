"""Levels of fixtures as the page and other programs read them: one JSON object."""

import msgspec
import numpy as np

from vemlight.runtime import wire

LIMITED, OFF_GAMUT = 1, 2  # marks of the message
DIGITS = 4  # of levels and places: a sixteenth of what the eye sees of a level, a tenth of a millimetre


def levels_json(header: wire.LevelsMessage, *arrays: np.ndarray) -> bytes:
    """The rig and its levels as `vemlight.levels/1`."""
    positions, aims, emitters, levels, light, marks = (array.tolist() for array in arrays)
    ends = np.cumsum(emitters).tolist()
    fixtures = [
        {
            "name": name, "at": _rounded(at), "aim": _rounded(aim),
            "levels": _rounded(levels[end - count : end]), "light": _rounded(colour),
            "limited": bool(mark & LIMITED), "off_gamut": bool(mark & OFF_GAMUT),
        }
        for name, at, aim, count, end, colour, mark in zip(header.names, positions, aims, emitters, ends, light, marks, strict=True)
    ]  # fmt: skip
    content = {
        "schema": "vemlight.levels/1", "sequence": header.stamp.sequence, "time_s": header.stamp.time_s, "target": header.target,
        "solve_ms": header.report.solve_ms, "fixtures": fixtures, "unmatched": header.report.unmatched_ratio,
        "unmatched_rgb": header.unmatched_rgb, "unmatched_at": header.unmatched_at, "missing_there": header.missing_there,
        "text": header.text,
    }  # fmt: skip
    return msgspec.json.encode(content)


def _rounded(values: list[float]) -> list[float]:
    return [round(value, DIGITS) for value in values]
