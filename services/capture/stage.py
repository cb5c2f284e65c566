"""Capture as the beginning of the pipeline: the frames of a recording or a camera as messages."""

import sys

import msgspec
import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.source import Live, open_source
from vemlight.runtime import wire
from vemlight.runtime.channels import Service

MapMessage = tuple[wire.MapMessage, tuple[np.ndarray, ...]]


class CaptureSource:
    """Recorded frames; see `vemlight.runtime.loop.Source`."""

    service: Service = "capture"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises UserError when the source is not there or not whole."""
        self._source = open_source(settings.capture)
        self.fps = self._source.fps
        wanted = settings.capture.frames or None
        self.limit = min(len(self), wanted or len(self)) if settings.mode == "lossless" else wanted
        self._source.frame(0)  # weights are made and loops compiled before the first frame is due

    def __len__(self) -> int:
        return len(self._source)

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Raises UserError for a damaged file."""
        return map_message(self._source.frame(index), wire.stamp(sequence, time_s))


class CaptureCamera:
    """A camera's frames as they come; see `vemlight.runtime.loop.Camera`."""

    service: Service = "capture"

    def __init__(self, settings: settings.Capture) -> None:
        """Raises UserError for a camera, lens or response that cannot be used."""
        self._live = Live(settings)
        self.limit = settings.frames or None
        self._said = ""
        self._sequence = -1

    def message(self, wait_s: float) -> tuple[MapMessage | None, int]:
        """The next frame, if one came within `wait_s`, and how many were lost before it. Numbers go on over the lost ones.

        Raises UserError when the camera comes back with another size.
        """
        frame = self._live.next(wait_s)
        if self._live.state != self._said:
            self._said = self._live.state
            print(f"vemlight: {self._said}", file=sys.stderr, flush=True)
        if frame is None:
            return None, 0
        self._sequence += frame.lost + 1
        stamp = wire.stamp(self._sequence, frame.time_s)
        if frame.monotonic_ns is not None:  # the kernel's stamp: both clocks are moved back by the frame's age
            age_ns = max(0, stamp.monotonic_ns - frame.monotonic_ns)  # some drivers stamp the end of a frame before it has come
            stamp = msgspec.structs.replace(
                stamp, monotonic_ns=stamp.monotonic_ns - age_ns, captured_ns=stamp.captured_ns - age_ns
            )
        return map_message(frame, stamp), frame.lost

    def close(self) -> None:
        self._live.close()


def map_message(frame: Frame, stamp: wire.Stamp) -> MapMessage:
    """What is nan, infinite or negative in the frame is counted as invalid and travels as 0."""
    good = np.isfinite(frame.radiance) & (frame.radiance >= 0)
    rows, cols, _ = frame.radiance.shape
    header = wire.MapMessage(
        stamp=stamp,
        rows=rows,
        cols=cols,
        coverage=frame.coverage,
        bright_samples=len(frame.bright_cells.cells),
        luminance_scale=frame.luminance_scale,
        report=wire.MapReport(
            invalid_cells=int(np.count_nonzero(~good.all(axis=-1))), black_pixels=frame.black, saturated_pixels=frame.saturated
        ),
    )
    return header, (np.where(good, frame.radiance, np.float32(0)), *frame.bright_cells)
