"""Recording of what a camera sends, begun and ended from the page: where to, how much room is left and how long that lasts."""

import os
import shutil
import time
from itertools import chain, count
from pathlib import Path
from typing import Any

from vemlight.capture.recorder import Recorder
from vemlight.capture.stage import CaptureCamera, CaptureSource
from vemlight.errors import UserError
from vemlight.settings import Capture

MIN_FREE = 512 * 2**20  # bytes of the disk that a recording leaves: a full one stops more than this program. 0.1 to 2 GB would do
RATE_S = 5.0  # over which the rate of bytes is measured
NO_FOLDER = "nothing says where to: set [capture] recordings = FOLDER"
NO_CAMERA = "only cameras and streams are recorded: files are there already"


class LiveRecording:
    """At most one at a time."""

    def __init__(self, settings: Capture) -> None:
        self._folder = Path(settings.recordings) if settings.recordings else None
        self._recorder: Recorder | None = None
        self._wanted = False
        self._rate = 0.0
        self._since = (0.0, 0)
        self.refusal = ""

    def obey(self, wanted: bool, source: CaptureCamera | CaptureSource) -> None:
        """Begins or ends a recording of `source` where that has changed."""
        if wanted == self._wanted:
            return
        self._wanted = wanted
        self.refusal = self.why_not(source) if wanted else ""
        if not wanted:
            self._end(source)
        elif not self.refusal:
            self._begin(source)

    def leave(self, source: CaptureCamera | CaptureSource) -> None:
        """Ends a recording because `source` plays no more. None begins by itself on the next source: it has to be asked for anew."""
        if self._recorder:
            self.refusal = f"the recording {self._recorder.folder.name} has ended: another source plays"
        self._end(source)

    def why_not(self, source: CaptureCamera | CaptureSource) -> str:
        """Why nothing can be recorded now; empty where it can."""
        if not isinstance(source, CaptureCamera):
            return NO_CAMERA
        if self._folder is None:
            return NO_FOLDER
        if source.recorder and source.recorder is not self._recorder:
            return "all of it is recorded already, by [capture] record"
        return f"the disk has under {MIN_FREE >> 20} MB left; make room" if self._free() < MIN_FREE else ""

    def _begin(self, source: CaptureCamera | CaptureSource) -> None:
        assert self._folder
        assert isinstance(source, CaptureCamera)
        name = time.strftime("%Y-%m-%d_%H-%M-%S")
        names = chain([name], (f"{name}_{k}" for k in count(2)))  # another one may have begun in the same second
        try:
            folder = next(folder for folder in map(self._folder.joinpath, names) if not os.path.lexists(folder))
            self._recorder = Recorder(folder, calibration=source.calibration)
        except UserError as error:
            self.refusal = str(error).replace(f"{self._folder}/", "")  # where it lies is nobody's concern on a page
            return
        source.recorder, self._rate, self._since = self._recorder, 0.0, (time.monotonic(), 0)

    def _end(self, source: CaptureCamera | CaptureSource) -> None:
        if self._recorder and isinstance(source, CaptureCamera):
            source.recorder = None
            self._recorder.close()
            self._recorder = None

    def _free(self) -> int:
        """Bytes of the disk that recordings go to; 0 where it cannot be asked."""
        folder = self._folder
        while folder and not os.path.exists(folder) and folder != folder.parent:  # which raises nothing, unlike Path.exists
            folder = folder.parent
        try:
            return shutil.disk_usage(folder).free if folder else 0
        except OSError:
            return 0

    def said(self, source: CaptureCamera | CaptureSource) -> dict[str, Any]:
        """Of a `wire.SourceMessage`. A recording ends when the disk is nearly full."""
        free, recorder = self._free(), self._recorder
        if recorder and isinstance(source, CaptureCamera) and free < MIN_FREE:
            self._end(source)
            left = f"the disk has under {MIN_FREE >> 20} MB left; make room, and record again"
            self.refusal = f"the recording {recorder.folder.name} has ended: {left}"
            recorder = None
        if recorder is None:
            return {"free_bytes": free, "why_not_record": self.why_not(source)[:256]}
        # A disk may refuse with room left, for a quota or as it is read-only now; the light would be on and nothing recorded.
        self.refusal = f"the recording {recorder.folder.name}: {recorder.why_refused}" if recorder.refusing else ""
        began_s, before = self._since
        if (passed_s := time.monotonic() - began_s) > RATE_S:
            self._rate, self._since = (recorder.nbytes - before) / passed_s, (time.monotonic(), recorder.nbytes)
        return {
            "recording": recorder.folder.name, "recorded_frames": recorder.written, "recorded_bytes": recorder.nbytes,
            "record_bytes_s": self._rate, "free_bytes": free,
        }  # fmt: skip
