"""Whether the files that a run reads are still the same: a digest of their names, sizes and times, for content would take too long."""

import hashlib
import os
import re
from pathlib import Path

from vemlight.runtime.instances import rig_cameras
from vemlight.settings import Settings

BESIDE = ("lens.toml", "response.toml")  # that are looked for beside a frame
MAX_TEXT_BYTES = 2**24  # read of a file that names others; the longest glTF of the tests has 2 MB
NAMES = {  # how a file of a scene names others
    ".toml": re.compile(r"""["']([^"'\n]{1,255})["']"""),
    ".gltf": re.compile(r'"uri"\s*:\s*"([^"\n]{1,255})"'),
    ".obj": re.compile(r"^\s*mtllib\s+(.{1,255}?)\s*$", re.MULTILINE),
    ".mtl": re.compile(r"^\s*(?:map_|bump|disp|norm)\w*\s.*?(\S{1,255})\s*$", re.MULTILINE),
}


def input_digests(settings: Settings) -> dict[str, str]:
    """For each path in the settings that is not empty, the SHA-256 of the names, sizes and times of the files behind it."""
    paths = {
        "[capture] source": settings.capture.source,
        **{f"[capture] lens {n}" if n else "[capture] lens": name for n, name in enumerate(settings.capture.lenses)},
        "[capture] response": settings.capture.response,
        "[renderer] scene": settings.renderer.scene,
        "[plate] source": settings.plate.source,
    }
    if settings.rig.file:
        paths["[rig] file"] = settings.rig.file
        for camera in rig_cameras(settings.rig.file):
            files = {"source": camera.source, "lens": camera.lens, "response": camera.response}
            paths |= {f"camera {camera.name}: {key}": path for key, path in files.items()}
    return {key: _digest(Path(path)) for key, path in paths.items() if path}


def _digest(path: Path) -> str:
    lines = []
    for file in sorted(_files(path)):
        status = file.stat()
        lines.append(f"{file}\0{status.st_size}\0{status.st_mtime_ns}\n")
    return hashlib.sha256("".join(lines).encode(errors="surrogateescape")).hexdigest()


def _files(path: Path) -> set[Path]:
    """The files of a folder; or a file, what may lie beside it, and those that it names and that are there."""
    if path.is_dir():
        return {entry for entry in path.iterdir() if entry.is_file() and not entry.name.startswith(".")}
    found: set[Path] = set()
    waiting = [path, *(path.with_name(name) for name in BESIDE)]
    while waiting:
        file = waiting.pop()
        if file not in found and os.path.isfile(file):  # False, too, for names that no file can have
            found.add(file)
            waiting += [file.parent / name for name in _names(file)]
    return found


def _names(path: Path) -> list[str]:
    """What a file names that may be files."""
    if pattern := NAMES.get(path.suffix.lower()):
        with open(path, encoding="utf-8", errors="replace") as file:
            return pattern.findall(file.read(MAX_TEXT_BYTES))
    return []
