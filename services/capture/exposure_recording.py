"""A recording of frames whose exposure changes from one to the next, played as the camera was: each frame a map of all light."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vemlight.capture.exposure_cycle import SETTLING, ExposureCycle
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.live_brackets import LiveBrackets
from vemlight.capture.manifest import ManifestEntry, check_digest
from vemlight.capture.still_source import StillReader
from vemlight.errors import UserError
from vemlight.files import decoded_json
from vemlight.light.images import read_radiance
from vemlight.setting_keys import ExposureTimes
from vemlight.settings import Capture

EXPOSURES = "vemlight:exposures"  # JSON in each frame's header: what the camera was asked for, falling, s
EXPOSURE = "vemlight:exposure"  # text: the frame's own, one of these, where it was recognised


class ExposureRecording:
    """The frames of such a recording; see `vemlight.capture.source.FrameSource`.

    A frame depends on those before it. In order each is read once; a jump back plays from the first again, so frame k has the same bits
    whatever was asked for before.
    """

    def __init__(self, settings: Capture, folder: Path, entries: list[ManifestEntry], fps: float, attributes: dict[str, Any]) -> None:
        """fps, attributes: of the first frame. Raises UserError for one that cannot be played, and when start and end leave nothing."""
        self._settings, self._folder, self.fps = settings, folder, fps
        self._cycle = ExposureCycle(exposures_from_attributes(str(folder / entries[0].name), attributes))
        known = EXPOSURE in attributes
        played = entries if known else entries[SETTLING - 1 :]  # the virtual camera leaves in what a camera sends before it obeys
        end = min(settings.end or len(played), len(played))
        if settings.start >= end:
            frames = f"frames 0 to {len(played) - 1}, of which [capture] start and end leave none"
            raise UserError(f"{folder}: has {frames}; correct them")
        self._entries, self._start = played[:end], settings.start
        self._maker = FrameMaker(settings, folder)
        self._stills = StillReader(settings, self._maker)
        self._restart()

    def __len__(self) -> int:
        return len(self._entries) - self._start

    def paths(self, k: int) -> tuple[Path, ...]:
        """The file of frame k, without those before it that it depends on."""
        return (self._folder / self._entries[self._start + k].name,)

    @property
    def calibration(self) -> tuple[Path, ...]:
        return self._maker.files

    def check(self) -> None:
        """Raises UserError for a first frame from which no map can be made."""
        self.frame(0)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises UserError for a file that is damaged, changed, or of an exposure that was not asked for."""
        wanted = self._start + k
        if wanted < self._next:
            if wanted == self._next - 1 and self._last is not None:
                return self._last
            self._restart()
        while self._next <= wanted:
            self._last = self._made(self._next)
            self._next += 1
        assert self._last is not None
        return self._last

    def _restart(self) -> None:
        self._next, self._last = 0, None
        self._live: LiveBrackets | None = None

    def _made(self, number: int) -> Frame:
        entry = self._entries[number]
        path = self._folder / entry.name
        check_digest(path, entry.sha256)
        attributes = read_radiance(path)[1]
        still = self._stills.codes(path)
        if self._live is None:
            self._live = LiveBrackets(self._maker, str(self._folder), self._cycle, still.values, still.mosaic)
        time_s = (entry.time_s - self._entries[self._start].time_s) / self._settings.speed
        return self._live.frame(still.codes, time_s, self._exposure(str(path), attributes))[0]

    def _exposure(self, name: str, attributes: dict[str, Any]) -> int | None:
        told = attributes.get(EXPOSURE)
        if told is None:
            return None
        for n, exposure in enumerate(self._cycle.exposures):
            if told == repr(exposure):
                return n
        raise UserError(f"{name}: its exposure of {str(told)[:20]} is none of those that were asked for; record again")


def exposures_from_attributes(name: str, attributes: dict[str, Any]) -> tuple[float, ...]:
    """The exposures that a header says the camera was asked for, falling. Raises UserError for what are none."""
    try:
        exposures = decoded_json(attributes[EXPOSURES], ExposureTimes)
    except (ValueError, TypeError) as error:
        raise UserError(f"{name}: {EXPOSURES} in its header: {error}; record again") from error
    return checked_exposures(name, exposures)


def checked_exposures(name: str, exposures: tuple[float, ...]) -> tuple[float, ...]:
    """Falling. Raises UserError unless there are two or more that differ by a tenth at least."""
    ordered = tuple(sorted(exposures, reverse=True))
    if len(ordered) < 2 or np.min(np.divide(ordered[:-1], ordered[1:])) < 1.1:
        listed = ", ".join(f"{exposure:g}" for exposure in ordered)
        raise UserError(f"{name}: exposures {listed} are not two or more that differ by a tenth; take steps of 4 to 32 times")
    return ordered


def exposures_text(exposures: tuple[float, ...]) -> str:
    """What `exposures_from_attributes` reads."""
    return msgspec.json.encode(exposures).decode()
