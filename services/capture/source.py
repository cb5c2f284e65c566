"""Where frames come from: files replayed by index, each made into a polar map of radiance.

Frames are lat-long images, fisheye images of radiance (with a lens file) or of raw codes (with a response file too), or polar
maps. What a frame is stands in its EXR header as `vemlight:kind`; without it, a lens file makes it fisheye and a response file
raw. lens.toml and response.toml are looked for beside the frames when the settings name none. A frame's nan, inf and negative
values stay in the cells that they touch.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import msgspec

from services.capture.frames import Frame, FrameMaker
from services.capture.sequence import MANIFEST, Entry, check_digest, frame_paths, read_manifest
from services.files import BadInput
from services.images import read_radiance, write_exr
from services.settings import Capture

BUNDLED = Path(__file__).parents[2] / "replay_data" / "outdoor"


class Source(Protocol):
    """Frames by index."""

    fps: float

    def __len__(self) -> int: ...

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1, the same bits each time. Raises BadInput for what the user must mend."""
        ...


class Files:
    """Image files in order, frame by frame."""

    def __init__(self, settings: Capture, paths: list[Path], entries: list[Entry] | None):
        self.paths = paths
        self.entries = entries
        self._maker = FrameMaker(settings, paths[0].parent)
        self._checked: set[int] = set()
        rate = read_radiance(paths[0])[1].get("framesPerSecond")
        self.fps = float(Fraction(rate)) if rate else settings.fps

    def __len__(self) -> int:
        return len(self.paths)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises BadInput for a file that is damaged, changed or of another size than the first one read."""
        path = self.paths[k]
        if self.entries and k not in self._checked:
            check_digest(path, self.entries[k].sha256)
            self._checked.add(k)
        image, attributes = read_radiance(path)
        time_s = self.entries[k].time_s if self.entries else k / self.fps
        return self._maker.frame(str(path), image, attributes, time_s)


def polar_file(frame: Path, lens: Path, response: Path | None, out: Path, settings: Capture | None = None) -> None:
    """Writes the polar map of one fisheye frame to the EXR `out`, in the size and coverage of the settings (90 x 360 hemisphere).

    Raises BadInput for a file that cannot be used, OSError when the disk refuses.
    """
    settings = msgspec.structs.replace(
        settings or Capture(), source=str(frame), lens=str(lens), response=str(response) if response else ""
    )
    made = Files(settings, [frame], None).frame(0)
    attributes: dict[str, Any] = {"vemlight:kind": "polar", "vemlight:coverage": made.coverage}
    if made.luminance_scale is not None:
        attributes["whiteLuminance"] = made.luminance_scale
    write_exr(out, made.radiance, attributes)


def open_source(settings: Capture) -> Source:
    """The source that the settings name. Raises BadInput when it is not there or not whole."""
    path = Path(settings.source) if settings.source else BUNDLED
    if not path.exists():
        if not settings.source:
            raise BadInput("replay_data/ is not beside the services folder; name a file or folder as [capture] source")
        raise BadInput(f"{path}: there is no such file or folder; check [capture] source")
    if not path.is_dir():
        return Files(settings, [path], None)
    if (path / MANIFEST).exists():
        entries = read_manifest(path)
        return Files(settings, [path / entry.name for entry in entries], entries)
    return Files(settings, frame_paths(path), None)
