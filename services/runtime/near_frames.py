"""The near lights of the last frames, for those who receive lights and `points` each as they come."""

import numpy as np

from vemlight.light.light_set import NearLights
from vemlight.light.near_lights import NearLightSet
from vemlight.runtime import stamps, wire

LAST_FRAMES = 32  # many times what lights are behind their map


class NearFrames:
    """Keeps them by their number."""

    def __init__(self) -> None:
        self._frames: dict[int, NearLights] = {}  # the newest last

    def take(self, header: wire.PointsMessage, arrays: tuple[np.ndarray, ...]) -> None:
        if header.stamp.sequence <= next(reversed(self._frames), -1):  # who was restarted counts from 0 again
            self._frames.clear()
        self._frames[header.stamp.sequence] = NearLights(NearLightSet(*arrays), header.at)
        if len(self._frames) > LAST_FRAMES:
            del self._frames[next(iter(self._frames))]

    @property
    def newest(self) -> NearLights | None:
        """None before the first, and where there is one camera."""
        return next(reversed(self._frames.values()), None)

    def of(self, stamp: stamps.Stamp) -> NearLights | None:
        """Those on the stamp, or where they have not come the newest."""
        return self._frames.get(stamp.sequence, self.newest)
