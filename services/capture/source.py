"""Image files replayed by index, each made into a polar map of radiance.

PNG, JPEG and TIFF are pictures by their transfer or raw codes by a response file (`vemlight.capture.still_source`). lens.toml and
response.toml are looked for beside the frames when the settings name none.
"""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vemlight.capture.bracket_source import BracketSource
from vemlight.capture.exposure_recording import EXPOSURES, ExposureRecording
from vemlight.capture.film_source import FilmSource
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.manifest import MANIFEST, ManifestEntry, check_digest, read_manifest
from vemlight.capture.sequence import FrameFile, frame_files
from vemlight.capture.still_source import StillReader, check_radiance_settings, is_still
from vemlight.errors import UserError
from vemlight.light.film_file import FILM_SUFFIXES
from vemlight.light.images import read_radiance
from vemlight.light.primaries import PRIMARIES, rec709_from_primaries
from vemlight.settings import Capture

READ_AHEAD = 2  # frames made before they are asked for: one in hand and one in the making; any value from 1 to 8 does
MAX_FPS = 1000  # of a header: as for the settings' fps
BUNDLED = Path(__file__).parent / "bundled"  # in the repository a link to replay_data/outdoor, in a wheel its files


class FrameSource(Protocol):
    """Frames by index."""

    @property
    def fps(self) -> float:
        """Frames a second."""
        ...

    def __len__(self) -> int: ...

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1, the same bits each time. Raises UserError for a file that cannot be used."""
        ...


class FilesOfFrames(FrameSource, Protocol):
    """A source that says which files it reads."""

    def paths(self, k: int) -> tuple[Path, ...]:
        """The files of frame k."""
        ...

    @property
    def calibration(self) -> tuple[Path, ...]:
        """The lens and response files."""
        ...


class FileSource:
    """Image files in order, from `start` to `end` and at `speed` as the settings say."""

    def __init__(self, settings: Capture, files: list[FrameFile], entries: list[ManifestEntry] | None):
        """Raises UserError when start and end leave nothing, or the first file is damaged."""
        end = min(settings.end or len(files), len(files))
        if settings.start >= end:
            frames = f"frames 0 to {len(files) - 1}, of which [capture] start and end leave none"
            raise UserError(f"{files[0].path.parent}: has {frames}; correct them")
        self._files = files[settings.start : end]
        self._entries = entries[settings.start : end] if entries else None
        self._maker = FrameMaker(settings, files[0].path.parent)
        self._verified: set[int] = set()
        self._speed = settings.speed
        self._stills = StillReader(settings, self._maker)
        self.fps = settings.fps * settings.speed
        self._layer, self._primaries = settings.layer, settings.primaries
        self._opened: tuple[np.ndarray, dict[str, Any]] | None = None  # the first image, until it is asked for
        if not is_still(self._files[0].path):
            check_radiance_settings(settings, self._files[0].path)
            self._opened = self._read(self._files[0].path)
            self.fps = recorded_fps(self._opened[1], settings.fps) * settings.speed

    def __len__(self) -> int:
        return len(self._files)

    def paths(self, k: int) -> tuple[Path, ...]:
        return (self._files[k].path,)

    @property
    def calibration(self) -> tuple[Path, ...]:
        return self._maker.files

    def check(self) -> None:
        """Raises UserError for a first frame from which no map can be made, without making one."""
        path = self._files[0].path
        if is_still(path):
            self._stills.check(path)
        else:
            image, attributes = self._image(0)
            self._maker.check(str(path), image.shape, attributes)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises UserError for a file that is damaged, changed or of another size than the first one read."""
        path, offset = self._files[k]
        if self._entries and k not in self._verified:
            check_digest(path, self._entries[k].sha256)
            self._verified.add(k)
        time_s = self._entries[k].time_s / self._speed if self._entries else (offset - self._files[0].offset) / self.fps
        if is_still(path):
            return self._stills.frame(path, time_s)
        return self._maker.frame(str(path), *self._image(k), time_s)

    def _read(self, path: Path) -> tuple[np.ndarray, dict[str, Any]]:
        """An image of radiance in Rec. 709, by the settings' primaries where the file states none."""
        image, attributes = read_radiance(path, self._layer)
        if self._primaries and "chromaticities" not in attributes:
            image = (image @ rec709_from_primaries(PRIMARIES[self._primaries]).T).astype(np.float32)
        return image, attributes

    def _image(self, k: int) -> tuple[np.ndarray, dict[str, Any]]:
        """Image k with its attributes; what was read on opening is not read again."""
        opened, self._opened = self._opened, None
        return opened if opened and k == 0 else self._read(self._files[k].path)


def recorded_fps(attributes: dict[str, Any], default: float) -> float:
    """Frames a second in a file's header, or `default` where there is no valid rate."""
    try:
        fps = float(Fraction(attributes["framesPerSecond"]))
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError):
        return default
    return fps if 0 < fps <= MAX_FPS else default


class ReadAheadSource:
    """A source whose next frames are made in a thread while the current one is in use."""

    def __init__(self, source: FrameSource):
        self._source = source
        self.fps = source.fps
        self._thread = ThreadPoolExecutor(1, "reader")
        self._pending: dict[int, Future[Frame]] = {}

    def __len__(self) -> int:
        return len(self._source)

    def frame(self, k: int) -> Frame:
        """See FrameSource."""
        wanted = [(k + n) % len(self) for n in range(min(READ_AHEAD, len(self) - 1) + 1)]
        for index in [index for index in self._pending if index not in wanted]:
            self._pending.pop(index).cancel()
        for index in wanted:
            if index not in self._pending:
                self._pending[index] = self._thread.submit(self._source.frame, index)
        return self._pending.pop(k).result()


def open_source(settings: Capture) -> FrameSource:
    """The files that the settings name, read ahead. Raises UserError when they are missing or incomplete."""
    source = open_files(settings)
    return ReadAheadSource(source) if len(source) > 1 else source


def open_files(settings: Capture) -> FileSource | FilmSource | BracketSource | ExposureRecording:
    """The files that the settings name. Raises UserError when they are missing or incomplete."""
    if settings.record:
        raise UserError("[capture] record is for cameras; `vemlight record` records files")
    path = Path(settings.source) if settings.source else BUNDLED
    if not os.path.exists(path):  # False for a name that is none, too
        raise UserError(f"{path}: there is no such file or folder; check the path")
    if settings.controls:
        raise UserError(f"{path}: --control, [capture] controls: is for cameras, and this is no camera; leave it out")
    if settings.brackets:
        return BracketSource(settings, path)
    if settings.layer and path.is_file() and path.suffix.lower() != ".exr":
        raise UserError(f"{path}: --layer, [capture] layer: is of EXR files, and this is another; leave it out")
    if not path.is_dir() and path.suffix.lower() in FILM_SUFFIXES:
        return FilmSource(settings, path)
    if not path.is_dir():
        return FileSource(settings, [FrameFile(path, 0)], None)
    if (path / MANIFEST).exists():
        entries = read_manifest(path)
        first = path / entries[0].name
        if not is_still(first) and EXPOSURES in (attributes := read_radiance(first)[1]):
            return ExposureRecording(settings, path, entries, recorded_fps(attributes, settings.fps) * settings.speed, attributes)
        return FileSource(settings, [FrameFile(path / entry.name, k) for k, entry in enumerate(entries)], entries)
    return FileSource(settings, frame_files(path), None)
