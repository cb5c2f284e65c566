"""Capture as a source of the pipeline: the frames of a recording or a camera as messages."""

import numpy as np

from services import settings, wire
from services.capture.source import open_source


class CaptureSource:
    """See `services.loop.Source`."""

    def __init__(self, settings: settings.Capture) -> None:
        """Raises BadInput when the source is not there or not whole."""
        self._source = open_source(settings)
        self.fps = self._source.fps

    def __len__(self) -> int:
        return len(self._source)

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """What is nan, infinite or negative is counted as spoilt and travels as 0. Raises BadInput for a damaged file."""
        stamp = wire.stamp(sequence, time_s)
        frame = self._source.frame(index)
        good = np.isfinite(frame.radiance) & (frame.radiance >= 0)
        rows, cols, _ = frame.radiance.shape
        header = wire.Map(
            stamp=stamp,
            rows=rows,
            cols=cols,
            coverage=frame.coverage,
            luminance_scale=frame.luminance_scale,
            spoilt=int(np.count_nonzero(~good.all(axis=-1))),
            black=frame.black,
            saturated=frame.saturated,
        )
        return header, (np.where(good, frame.radiance, np.float32(0)),)
