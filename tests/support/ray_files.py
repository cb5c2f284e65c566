"""Ray files of tests (IES TM-25)."""

from pathlib import Path

import numpy as np

from vemlight.renderer.luminaire.rayfile import TEXT_BYTES, TEXTS, TM25_HEADER

LUMINOUS = [1, 1, 0, 0, 1, 0, 0, 0]


def ray_file(path: Path, rows: np.ndarray, flags: list[int], spectrum: np.ndarray | None = None, **fields) -> Path:
    """A TM-25 file of `rows` (n, items); header fields by name."""
    header = np.zeros(1, TM25_HEADER)
    values = {"magic": b"TM25", "version": 2013, "luminous_flux": rows[:, -1].sum(), "rays": len(rows), "flags": flags} | fields
    for key, value in values.items():
        header[key] = value
    data = header.tobytes() + "a lamp".encode("utf-32-le").ljust(TEXTS * TEXT_BYTES, b"\0")
    if spectrum is not None:
        data += np.int32(len(spectrum)).tobytes() + spectrum.astype("<f4").tobytes()
    data += bytes(-len(data) % 32)
    path.write_bytes(data + rows.astype("<f4").tobytes())
    return path
