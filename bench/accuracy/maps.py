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
    found = sorted(p for p in (Path(folder) / "hdri").glob("*") if p.suffix in (".hdr", ".exr"))
    if not found:
        raise SystemExit(f"{folder}: there is no hdri/*.hdr or .exr in it; VEMLIGHT_DATA names the folder above hdri/")
    return found


def chosen() -> dict[str, Path]:
    """The map of each kind by the kind's name; of a folder without those maps its first four, by their own names."""
    found = maps()
    known = {kind: next((p for p in found if p.stem.startswith(name)), None) for name, kind in KINDS.items()}
    whole = {kind: path for kind, path in known.items() if path}
    return whole if len(whole) == len(KINDS) else {path.stem: path for path in found[: len(KINDS)]}


def one(kind: str) -> Path:
    """The map of one kind, or the first one of a folder without it."""
    return chosen().get(kind) or maps()[0]
