"""Capture as the first stage of the pipeline: the frames of files or of a camera as messages."""

import sys

import msgspec
import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import valid_values
from vemlight.capture.live_frames import open_live
from vemlight.capture.masking import Masking
from vemlight.capture.source import open_source
from vemlight.errors import of_setting
from vemlight.files import notice
from vemlight.runtime import wire
from vemlight.runtime.channels import Service

MapMessage = tuple[wire.MapMessage, tuple[np.ndarray, ...]]


class CaptureSource:
    """Frames of files; see `vemlight.runtime.source_loop.Source`."""

    service: Service = "capture"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises UserError when the source is missing or incomplete."""
        with of_setting("[capture] source"):
            self._source = open_source(settings.capture)
        self._configured = self._masks = settings.capture.masks
        self._masking = Masking(settings.capture)
        self.fps = self._source.fps
        limit = settings.capture.frames or None
        if limit and limit > len(self):
            then = "all of them are played" if settings.mode == "lossless" else "they are played again from the first"
            notice(f"{settings.capture.source or 'the bundled sequence'}: has {len(self)} frames, not {limit}; {then}")
        self.limit = min(len(self), limit or len(self)) if settings.mode == "lossless" else limit
        self._source.frame(0)  # computes the weights and compiles the loops before the first frame is due

    def __len__(self) -> int:
        return len(self._source)

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Raises UserError for a damaged file."""
        frame = self._masking.masked(self._source.frame(index), self._masks)
        return map_message(frame, wire.stamp(sequence, time_s))

    def on_control(self, control: wire.ControlMessage) -> None:
        self._masks = self._configured if control.masks is None else control.masks


class CaptureCamera:
    """The frames of a camera or stream as they arrive; see `vemlight.runtime.source_loop.Camera`."""

    service: Service = "capture"

    def __init__(self, settings: settings.Capture) -> None:
        """Raises UserError for a camera, lens or response that cannot be used."""
        self._source = open_live(settings)
        self._configured = self._masks = settings.masks
        self._masking = Masking(settings)
        self._paused = False
        self._shown: Frame | None = None
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
        self._sequence += frame.lost + 1
        stamp = wire.stamp(self._sequence, frame.time_s)
        if frame.monotonic_ns is not None:  # the kernel's stamp: both clocks go back by the age of the frame
            age_ns = max(0, stamp.monotonic_ns - frame.monotonic_ns)  # some drivers stamp the end of a frame before it has arrived
            stamp = msgspec.structs.replace(
                stamp, monotonic_ns=stamp.monotonic_ns - age_ns, captured_ns=stamp.captured_ns - age_ns
            )
        if not self._paused or self._shown is None:
            self._shown = frame
        return map_message(self._masking.masked(self._shown, self._masks), stamp), frame.lost

    def on_control(self, control: wire.ControlMessage) -> None:
        """Paused, the frame that was shown last is sent again and again."""
        self._masks = self._configured if control.masks is None else control.masks
        self._paused = control.paused

    @property
    def unwritten(self) -> int:
        return self._source.unrecorded

    def close(self) -> None:
        self._source.close()


def map_message(frame: Frame, stamp: wire.Stamp) -> MapMessage:
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
        report=wire.MapReport(
            invalid_cells=invalid_cells, black_pixels=frame.black, saturated_pixels=frame.saturated, masked_cells=frame.masked_cells
        ),
    )
    return header, (np.where(valid, frame.radiance, np.float32(0)), *frame.bright_cells)
