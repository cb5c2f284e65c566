"""Capture as the first stage of the pipeline: the frames of files or of a camera as messages."""

import sys
from pathlib import Path

import msgspec
import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import valid_values
from vemlight.capture.live_frames import open_live
from vemlight.capture.masking import Masking
from vemlight.capture.recent import RecentFrames
from vemlight.capture.recorder import Recorder
from vemlight.capture.source import FrameSource, open_files, open_source
from vemlight.capture.thumbnails import NO_THUMBNAILS, ThumbnailNews, Thumbnails
from vemlight.errors import of_setting, printable_line
from vemlight.files import notice
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import Instance
from vemlight.runtime.playback import Playback
from vemlight.runtime.reports import MapReport
from vemlight.source_names import is_path, shown_source

MAX_NAME = 200  # letters of a source's name on the page
MapMessage = tuple[wire.MapMessage, tuple[np.ndarray, ...]]


class CaptureSource:
    """Frames of files; see `vemlight.runtime.source_loop.Source`."""

    def __init__(
        self, settings: settings.Settings, service: Instance = "capture", source: FrameSource | None = None, name: str = ""
    ) -> None:
        """`source`: instead of the files that the settings name, called `name`. Raises UserError when it is missing or incomplete."""
        self.service = service
        with of_setting("[capture] source" if service == "capture" else service):
            self._source = source or open_source(settings.capture)
        self._again = (lambda: source) if source else lambda: open_files(settings.capture)
        self._configured = self._masks = settings.capture.masks
        self._masking = Masking(settings.capture)
        self.fps = self._source.fps
        limit = settings.capture.frames or None
        if limit and limit > len(self):
            then = "all of them are played" if settings.mode == "lossless" else "they are played again from the first"
            notice(f"{settings.capture.source or 'the bundled sequence'}: has {len(self)} frames, not {limit}; {then}")
        self.limit = min(len(self), limit or len(self)) if settings.mode == "lossless" else limit
        self._source.frame(0)  # computes the weights and compiles the loops before the first frame is due
        self.name = name or source_name(settings.capture)
        self._played = Playback.start(len(self), self.fps)
        self._thumbnails: Thumbnails | None = None
        self._news = ThumbnailNews()

    def __len__(self) -> int:
        return len(self._source)

    def on_played(self, playback: Playback) -> None:
        self._played = playback
        if not self._thumbnails:  # from the first frame that is played on: a run that makes files has none
            self._thumbnails = Thumbnails(len(self), lambda: self._again().frame)

    def about(self) -> wire.Message:
        """Where it stands, and its thumbnails now and then."""
        made = self._thumbnails.made() if self._thumbnails else NO_THUMBNAILS
        sent = made if self._news.due(len(made[0])) else NO_THUMBNAILS
        played = self._played
        header = wire.SourceMessage(
            name=self.name, frames=len(self), fps=self.fps, position=played.index, at_end=played.at_end, thumbnails=len(sent[0])
        )
        return header, sent

    def close(self) -> None:
        """Ends the making of thumbnails."""
        if self._thumbnails:
            self._thumbnails.close()

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Raises UserError for a damaged file."""
        frame = self._masking.masked(self._source.frame(index), self._masks)
        return map_message(frame, stamps.stamp(sequence, time_s))

    def on_control(self, control: wire.ControlMessage) -> None:
        self._masks = self._configured if control.masks is None else control.masks


class CaptureCamera:
    """The frames of a camera or stream as they arrive; see `vemlight.runtime.source_loop.Camera`."""

    def __init__(self, settings: settings.Capture, service: Instance = "capture") -> None:
        """Raises UserError for a camera, lens or response that cannot be used."""
        self.service = service
        self._source = open_live(settings)
        self._configured = self._masks = settings.masks
        self._masking = Masking(settings)
        self._paused = False
        self._shown: Frame | None = None
        self.name = source_name(settings)
        self.recent: RecentFrames | None = None  # to look at again; None: none are kept
        self.limit = settings.frames or None
        self._logged = ""
        self._sequence = -1

    def message(self, wait_s: float) -> tuple[MapMessage | None, int]:
        """The next frame, if one came within `wait_s`, and the number lost before it. Sequence numbers count lost frames too.

        Raises UserError when the camera returns with another size.
        """
        frame = self._source.next(wait_s)
        if self._source.state != self._logged:
            self._logged = self._source.state
            print(f"vemlight: {self._logged}", file=sys.stderr, flush=True)
        if frame is None:
            return None, 0
        if self.recent:
            self.recent.add(frame)
        self._sequence += frame.lost + 1
        stamp = stamps.stamp(self._sequence, frame.time_s)
        if frame.monotonic_ns is not None:  # the kernel's stamp: both clocks go back by the age of the frame
            age_ns = max(0, stamp.monotonic_ns - frame.monotonic_ns)  # some drivers stamp the end of a frame before it has arrived
            stamp = msgspec.structs.replace(stamp, monotonic_ns=stamp.monotonic_ns - age_ns, captured_ns=stamp.captured_ns - age_ns)
        if not self._paused or self._shown is None:
            self._shown = frame
        return map_message(self._masking.masked(self._shown, self._masks), stamp), frame.lost

    def on_control(self, control: wire.ControlMessage) -> None:
        """Paused, the frame that was shown last is sent again and again."""
        self._masks = self._configured if control.masks is None else control.masks
        self._paused = control.paused

    def on_played(self, playback: Playback) -> None:
        pass

    def about(self) -> wire.Message:
        """Its name; a camera has no place where it stands."""
        return wire.SourceMessage(name=self.name, frames=0, fps=self._source.fps), NO_THUMBNAILS

    @property
    def recorder(self) -> Recorder | None:
        """What the frames are recorded by, if they are; another may be set between two frames."""
        return self._source.recorder

    @recorder.setter
    def recorder(self, recorder: Recorder | None) -> None:
        self._source.recorder = recorder

    @property
    def calibration(self) -> tuple[Path, ...]:
        """Lens and response files that a recording needs beside its frames."""
        return self._source.calibration

    @property
    def unwritten(self) -> int:
        return self._source.unrecorded

    def close(self) -> None:
        self._source.close()


def source_name(settings: settings.Capture) -> str:
    """What a source is called on the page: the last part of its path; never more of it, which pages are shown to others."""
    if not settings.source:
        return "bundled sequence"
    name = Path(settings.source).name if is_path(settings.source) else shown_source(settings.source)
    return printable_line(name)[:MAX_NAME]


def map_message(frame: Frame, stamp: stamps.Stamp) -> MapMessage:
    """The frame as a message: pixels that are nan, infinite or negative are counted as invalid and set to 0."""
    valid = valid_values(frame.radiance)
    rows, cols, _ = frame.radiance.shape
    invalid_cells = int(np.count_nonzero(~valid.all(axis=-1)))
    if invalid_cells:
        notice("the map has cells that are nan, infinite or negative and count as dark; the status counts those of the newest frame")
    header = wire.MapMessage(
        stamp=stamp,
        rows=rows,
        cols=cols,
        coverage=frame.coverage,
        bright_samples=len(frame.bright_cells.cells),
        luminance_scale=frame.luminance_scale,
        clipped=frame.clipped,
        report=MapReport(
            invalid_cells=invalid_cells,
            black_pixels=frame.black,
            saturated_pixels=frame.saturated,
            estimated_lux=frame.estimated_lux,
            masked_cells=frame.masked_cells,
        ),
    )
    return header, (np.where(valid, frame.radiance, np.float32(0)), *frame.bright_cells)
