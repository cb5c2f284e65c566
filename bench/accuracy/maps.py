"""The real maps that the charts are made on: lat-long files in hdri/ of the folder that VEMLIGHT_DATA names."""

import os
from pathlib import Path

KINDS = {
    "kloppenheim_05": "a sun",
    "potsdamer_platz": "an overcast sky",
    "aerodynamics_workshop": "an interior",
    "studio_small_03": "lamps",
}


def maps() -> list[Path]:
    """All of them, by name."""
    folder = os.environ.get("VEMLIGHT_DATA")
    if not folder:
        raise SystemExit("set VEMLIGHT_DATA to the folder that holds hdri/")
    return sorted(p for p in (Path(folder) / "hdri").iterdir() if p.suffix in (".hdr", ".exr"))


def chosen() -> dict[str, Path]:
    """The map of each kind."""
    return {kind: next(p for p in maps() if p.stem.startswith(name)) for name, kind in KINDS.items()}
