"""The recordings of a rig's cameras, opened for commands that read them offline."""

from pathlib import Path
from typing import Any

import msgspec

from vemlight import settings
from vemlight.capture.source import FrameSource, open_source
from vemlight.errors import UserError, of_setting
from vemlight.fuse.rig_file import RigCamera
from vemlight.settings_file import section_from_options
from vemlight.source_names import is_live, shown_source

ROWS = {"hemisphere": 90, "sphere": 180}  # one degree of elevation a row


def recording_of(path: Path, camera: RigCamera, coverage: str, fps: float | None = None, frames: int = 0) -> FrameSource:
    """The frames of one camera of the rig file `path`, the first `frames` of them, all where that is 0. fps: where they do not say it.

    Raises UserError for a camera that is live, and for a recording that cannot be used.
    """
    with of_setting(f"{path}: camera {camera.name}"):
        if is_live(camera.source):
            shown = shown_source(camera.source)
            raise UserError(f"{shown}: is live; record all cameras at once (vemlight record), and name the recordings")
        given: dict[str, Any] = {"source": camera.source, "response": camera.response, "coverage": coverage, "rows": ROWS[coverage]}
        capture = section_from_options(settings.Capture, {**given, "lens": camera.lens or None, "fps": fps})
        return open_source(msgspec.structs.replace(capture, end=frames))
