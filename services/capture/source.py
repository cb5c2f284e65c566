"""Where frames come from: files replayed by index, each made into a polar map of radiance.

Frames are lat-long images, fisheye images of radiance (with a lens file) or of raw codes (with a response file too), or polar
maps. What a frame is stands in its EXR header as `vemlight:kind`; without it, a lens file makes it fisheye and a response file
raw. PNG files are raw: gray ones of one colour, or of the mosaic that the settings' `format` names, others of three channels.
lens.toml and response.toml are looked for beside the frames when the settings name none. A frame's nan, inf and negative values
stay in the cells that they touch.
"""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from vemlight.capture.exr_header import bright_cells_text
from vemlight.capture.frames import Frame, FrameMaker, Mosaic
from vemlight.capture.recorder import Recorder
from vemlight.capture.sequence import MANIFEST, PNG, Entry, check_digest, frame_paths, read_manifest
from vemlight.capture.v4l2 import Camera, Raw, mosaic_of
from vemlight.errors import UserError
from vemlight.light.images import read_codes, read_radiance, write_exr
from vemlight.settings import Capture, is_camera

AHEAD = 2  # frames made before they are asked for
BUNDLED = Path(__file__).parents[2] / "replay_data" / "outdoor"


class Source(Protocol):
    """Frames by index."""

    fps: float

    def __len__(self) -> int: ...

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1, the same bits each time. Raises UserError for what the user must mend."""
        ...


class Files:
    """Image files in order, frame by frame, from `start` to `end` and at `speed` as the settings say."""

    def __init__(self, settings: Capture, paths: list[Path], entries: list[Entry] | None):
        """Raises UserError when start and end leave nothing, or the first file is damaged."""
        end = min(settings.end or len(paths), len(paths))
        if settings.start >= end:
            raise UserError(f"{paths[0].parent}: has frames 0 to {len(paths) - 1}; [capture] start and end leave none of them")
        self.paths = paths[settings.start : end]
        self._entries = entries[settings.start : end] if entries else None
        self._maker = FrameMaker(settings, paths[0].parent)
        self._checked: set[int] = set()
        self._speed = settings.speed
        self._mosaic: Mosaic | None = mosaic_of(settings.format)
        self.fps = settings.fps * settings.speed
        if self.paths[0].suffix.lower() != PNG:
            self.fps = recorded_rate(read_radiance(self.paths[0])[1], settings.fps) * settings.speed

    def __len__(self) -> int:
        return len(self.paths)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises UserError for a file that is damaged, changed or of another size than the first one read."""
        path = self.paths[k]
        if self._entries and k not in self._checked:
            check_digest(path, self._entries[k].sha256)
            self._checked.add(k)
        time_s = self._entries[k].time_s / self._speed if self._entries else k / self.fps
        if path.suffix.lower() == PNG:
            codes = read_codes(path)
            if codes.ndim == 3 and self._mosaic:
                raise UserError(f"{path}: is in colour, which no mosaic is; leave out [capture] format")
            mosaic: Mosaic | None = None if codes.ndim == 3 else "mono" if self._mosaic is None else self._mosaic
            return self._maker.frame_from_codes(str(path), codes, mosaic, time_s)
        image, attributes = read_radiance(path)
        return self._maker.frame(str(path), image, attributes, time_s)


def recorded_rate(attributes: dict[str, Any], otherwise: float) -> float:
    """Frames a second that a file's header tells, or `otherwise` where it tells none that can be."""
    try:
        rate = float(Fraction(attributes["framesPerSecond"]))
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError):
        return otherwise
    return rate if 0 < rate <= 1000 else otherwise


class Prefetched:
    """A source whose next frames are made in a thread while the last one is in use."""

    def __init__(self, source: Source):
        self._source = source
        self.fps = source.fps
        self._thread = ThreadPoolExecutor(1, "reader")
        self._coming: dict[int, Future[Frame]] = {}

    def __len__(self) -> int:
        return len(self._source)

    def frame(self, k: int) -> Frame:
        """See Source."""
        wanted = [(k + n) % len(self) for n in range(min(AHEAD, len(self) - 1) + 1)]
        for index in [index for index in self._coming if index not in wanted]:
            self._coming.pop(index).cancel()
        for index in wanted:
            if index not in self._coming:
                self._coming[index] = self._thread.submit(self._source.frame, index)
        return self._coming.pop(k).result()


class Live:
    """A camera's frames as they come."""

    def __init__(self, settings: Capture):
        """Raises UserError for a camera, lens or response that cannot be used, and for a lens of another size."""
        self._maker = FrameMaker(settings, Path.cwd())
        width, height = self._maker.lens.size if self._maker.lens else (0, 0)
        self._camera = Camera(
            settings.source, form=settings.format, width=settings.width or width, height=settings.height or height, fps=settings.fps
        )
        self.fps = self._camera.fps
        # a dark frame makes the weights before the stream begins, and refuses a lens of another size
        dark = np.zeros((self._camera.height, self._camera.width), np.uint8 if self._camera.form.bits == 8 else np.uint16)
        try:
            self._maker.frame_from_codes(settings.source, dark, self._camera.form.mosaic, 0.0)
        except UserError:
            self._camera.close()
            raise
        self.recorder = Recorder(Path(settings.record), beside=self._maker.files) if settings.record else None
        self._first_ns: int | None = None
        self._count = 0

    @property
    def state(self) -> str:
        """What was got, or that the camera is gone, or why nothing is recorded; for a log."""
        return self.recorder.trouble if self.recorder and self.recorder.trouble else self._camera.state

    def next(self, wait_s: float) -> Frame | None:
        """The next frame, or None when none came within `wait_s` (s); `state` then says why.

        Raises UserError for another size or format than was agreed on.
        """
        raw = self._camera.read(wait_s)
        if raw is None:
            return None
        self._first_ns = raw.monotonic_ns if self._first_ns is None else self._first_ns
        time_s = (raw.monotonic_ns - self._first_ns) / 1e9
        self._count += raw.lost + 1
        if self.recorder:
            self.recorder.put(raw.codes, raw_attributes(raw, self.fps), self._count - 1, time_s)
        frame = self._maker.frame_from_codes(self._camera.path, raw.codes, raw.mosaic, time_s)
        return frame._replace(lost=raw.lost, monotonic_ns=raw.monotonic_ns)

    def close(self) -> None:
        """Ends the stream and the recording."""
        self._camera.close()
        if self.recorder:
            self.recorder.close()


def polar_file(frame: Path, lens: Path, response: Path | None, out: Path, settings: Capture | None = None) -> None:
    """Writes the polar map of one fisheye frame to the EXR `out`, in the size and coverage of the settings (90 x 360 hemisphere).

    Raises UserError for a file that cannot be used, OSError when the disk refuses.
    """
    settings = msgspec.structs.replace(
        settings or Capture(), source=str(frame), lens=str(lens), response=str(response) if response else ""
    )
    made = Files(settings, [frame], None).frame(0)
    write_exr(out, made.radiance, map_attributes(made, settings.fps))


def record(settings: Capture, frames: int) -> Recorder:
    """Records `frames` frames (0: all that a file source has) of the settings' source to [capture] record; gives back the counts.

    Cameras are recorded as raw codes, files as polar maps. Raises UserError for a source or folder that cannot be used.
    """
    if not settings.record:
        raise UserError("[capture] record names no folder; name one to record to")
    if is_camera(settings.source):
        live = Live(settings)
        try:
            had = 0
            while had < frames or not frames:
                had += live.next(0.5) is not None
        finally:
            live.close()
        assert live.recorder is not None
        return live.recorder
    source = open_source(msgspec.structs.replace(settings, record=""))
    recorder = Recorder(Path(settings.record))
    try:
        for k in range(min(frames or len(source), len(source))):
            frame = source.frame(k)
            while not recorder.put(frame.radiance, map_attributes(frame, source.fps), k, frame.time_s):
                recorder.dropped -= 1  # files wait: nothing is lost by reading them later
                time.sleep(0.01)
    finally:
        recorder.close()
    return recorder


def raw_attributes(raw: Raw, fps: float) -> dict[str, Any]:
    """What the header of a camera's frame says; nanoseconds are text, because the format's integers have 32 bits."""
    seen_s = time.time() - (time.monotonic_ns() - raw.monotonic_ns) / 1e9
    return {
        "vemlight:kind": "codes",
        "vemlight:mosaic": raw.mosaic,
        "vemlight:monotonic_ns": str(raw.monotonic_ns),
        "vemlight:kernel_sequence": str(raw.sequence),
        "colorInteropID": "data",
        "framesPerSecond": Fraction(fps).limit_denominator(1001),
        "capDate": time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(seen_s)),
        "utcOffset": 0.0,
    }


def map_attributes(frame: Frame, fps: float) -> dict[str, Any]:
    """What the header of a polar map's EXR says."""
    attributes: dict[str, Any] = {
        "vemlight:kind": "polar",
        "vemlight:coverage": frame.coverage,
        "vemlight:strong": bright_cells_text(frame.bright_cells),
        "vemlight:black": frame.black,
        "vemlight:saturated": frame.saturated,
        "framesPerSecond": Fraction(fps).limit_denominator(1001),
    }
    if frame.luminance_scale is not None:
        attributes |= {"whiteLuminance": frame.luminance_scale, "vemlight:luminance_scale": repr(frame.luminance_scale)}
    return attributes


def open_source(settings: Capture) -> Source:
    """The files that the settings name, read ahead. Raises UserError when they are not there or not whole."""
    if settings.record:
        raise UserError("[capture] record is for cameras; `vemlight record` records files")
    path = Path(settings.source) if settings.source else BUNDLED
    if not path.exists():
        if not settings.source:
            raise UserError("[capture] source: is empty and the bundled sequence is not installed here; name a file or folder")
        raise UserError(f"{path}: there is no such file or folder; check [capture] source")
    if not path.is_dir():
        return Files(settings, [path], None)
    if (path / MANIFEST).exists():
        entries = read_manifest(path)
        return Prefetched(Files(settings, [path / entry.name for entry in entries], entries))
    return Prefetched(Files(settings, frame_paths(path), None))
