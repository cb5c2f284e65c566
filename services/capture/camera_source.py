"""A camera's frames as they arrive, each made into a polar map of radiance, and recorded if the settings say so."""

import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.recorder import Recorder
from vemlight.capture.v4l2 import RawFrame, V4l2Camera
from vemlight.errors import UserError
from vemlight.settings import Capture


class CameraSource:
    """A camera's frames as they arrive."""

    def __init__(self, settings: Capture):
        """Raises UserError for a camera, lens or response that cannot be used, and for a lens of another size."""
        self._maker = FrameMaker(settings, Path.cwd())
        width, height = self._maker.lens.size if self._maker.lens else (0, 0)
        self._camera = V4l2Camera(
            settings.source, form=settings.format, width=settings.width or width, height=settings.height or height, fps=settings.fps
        )
        self.fps = self._camera.fps
        # a dark frame computes the weights before the stream begins, and refuses a lens of another size
        dark = np.zeros((self._camera.height, self._camera.width), np.uint8 if self._camera.form.bits == 8 else np.uint16)
        try:
            self._maker.frame_from_codes(settings.source, dark, self._camera.form.mosaic, 0.0)
        except UserError:
            self._camera.close()
            raise
        self.recorder = Recorder(Path(settings.record), calibration=self._maker.files) if settings.record else None
        self._first_ns: int | None = None
        self._count = 0

    @property
    def state(self) -> str:
        """For a log: what the camera sends, that it is gone, or why nothing is recorded."""
        return self.recorder.last_error if self.recorder and self.recorder.refusing else self._camera.state

    @property
    def unrecorded(self) -> int:
        """Frames that were to be recorded and are not, because the disk was full or too slow."""
        return self.recorder.failed + self.recorder.dropped if self.recorder else 0

    def next(self, wait_s: float) -> Frame | None:
        """The next frame, or None when none came within `wait_s`; `state` then says why.

        Raises UserError when the camera sends another size or format than was agreed on.
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


def raw_attributes(raw: RawFrame, fps: float) -> dict[str, Any]:
    """The EXR attributes of a camera's frame; nanoseconds are text, because the format's integers have 32 bits."""
    captured_s = time.time() - (time.monotonic_ns() - raw.monotonic_ns) / 1e9
    return {
        "vemlight:kind": "codes",
        "vemlight:mosaic": raw.mosaic,
        "vemlight:monotonic_ns": str(raw.monotonic_ns),
        "vemlight:kernel_sequence": str(raw.sequence),
        "colorInteropID": "data",
        "framesPerSecond": Fraction(fps).limit_denominator(1001),
        "capDate": time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(captured_s)),
        "utcOffset": 0.0,
    }
