"""The commands `vemlight record` and `vemlight polar`: sources written to files."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import InvalidCells
from vemlight.capture.live_frames import open_live
from vemlight.capture.masking import MaskedSource
from vemlight.capture.recorder import Recorder
from vemlight.capture.recording_attributes import map_attributes
from vemlight.capture.source import open_files, open_source
from vemlight.errors import Interrupted, UserError
from vemlight.files import notice
from vemlight.light.images import write_exr
from vemlight.settings import Capture
from vemlight.source_names import is_live

CAMERA_WAIT_S = 0.5  # for a camera's next frame, before Ctrl-C is looked for; any value from 0.01 to 5 does


def record(settings: Capture, frames: int) -> Recorder:
    """Records `frames` frames of the settings' source to the folder [capture] record; returns the closed recorder with its counts.

    0 frames: all that files have, and a camera's until Ctrl-C. Cameras are recorded as raw codes, files and streams as polar maps.
    Raises UserError for a source or folder that cannot be used.
    """
    if not settings.record:
        raise UserError("[capture] record names no folder; name one to record to")
    return _record_live(settings, frames) if is_live(settings.source) else _record_files(settings, frames)


def _record_live(settings: Capture, frames: int) -> Recorder:
    source = open_live(settings)
    assert source.recorder is not None
    with _closed_in_the_end(source.recorder, source.close):
        received = 0
        while received < frames or not frames:
            received += source.next(CAMERA_WAIT_S) is not None
    return source.recorder


@contextmanager
def _closed_in_the_end(recorder: Recorder, close: Callable[[], None]) -> Iterator[None]:
    """Closes a recording, however its source ended. Ctrl-C becomes Interrupted, which says how many frames there are."""
    try:
        yield
    except KeyboardInterrupt as error:
        close()
        raise Interrupted(f"the recording ends here: {recorder.written} frames are in {recorder.folder}") from error
    except BaseException:
        close()
        raise
    close()


def _record_files(settings: Capture, frames: int) -> Recorder:
    source = MaskedSource(open_source(msgspec.structs.replace(settings, record="")), settings)
    recorder, invalid_cells = Recorder(Path(settings.record)), InvalidCells()
    if frames > len(source):
        notice(f"{settings.source or 'the bundled sequence'}: has {len(source)} frames, not {frames}; all of them are recorded")
    with _closed_in_the_end(recorder, recorder.close):
        for k in range(min(frames or len(source), len(source))):
            frame = source.frame(k)
            invalid_cells.add(frame.radiance)
            recorder.put_waiting(frame.radiance, map_attributes(frame, source.fps), k, frame.time_s)
            if recorder.refusing:  # with holes it would be of no use
                break
    invalid_cells.say()
    return recorder


def polar_file(settings: Capture, out: Path) -> Frame:
    """Writes the polar map of the first frame of the settings' source to the EXR `out`, in their size and coverage; returns it.

    Raises UserError for a file that cannot be used, OSError when the disk refuses.
    """
    source = MaskedSource(open_files(settings), settings)
    made = source.frame(0)
    write_exr(out, made.radiance, map_attributes(made, source.fps))
    invalid_cells = InvalidCells()
    invalid_cells.add(made.radiance)
    invalid_cells.say()
    return made
