"""Frames written to disk as they arrive, without delaying the source: a bounded queue, and a thread that writes EXR files and manifest."""

import queue
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.manifest import MANIFEST, ManifestWriter
from vemlight.errors import UserError
from vemlight.files import one_line, written_whole
from vemlight.light.images import write_exr

QUEUE_FRAMES = 8  # that wait for the disk: a third of a second at 25 a second, 100 MB at 1024 x 1024 RGB


class QueuedFrame(NamedTuple):
    """A frame that waits for the disk."""

    pixels: np.ndarray
    attributes: Mapping[str, Any]
    sequence: int
    time_s: float


class Recorder:
    """Writes frames to a folder as NAME_000000.exr, numbered by their sequence, and lists each in manifest.jsonl once it is complete.

    `written`, `dropped` (the queue was full) and `failed` (the disk refused) count frames; `nbytes` is what those written take;
    `last_error` says why the last one failed, `why_refused` without the folder, and `refusing` whether that was the newest.
    """

    def __init__(self, folder: Path, name: str = "frame", calibration: tuple[Path, ...] = ()):
        """Copies the `calibration` files (lens and response) into the folder.

        Raises UserError when the folder cannot be made or holds a recording.
        """
        self.folder, self.written, self.dropped, self.failed, self.last_error, self.refusing = folder, 0, 0, 0, "", False
        self._name, self.nbytes, self.why_refused = name, 0, ""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / MANIFEST).exists():
                raise UserError(f"{folder}: holds a recording already; name another folder, or remove it")
            for path in calibration:
                with written_whole(folder / path.name) as part:
                    shutil.copyfile(path, part)
            self._manifest = ManifestWriter(folder, [folder / path.name for path in calibration])
        except OSError as error:
            raise UserError(f"{folder}: cannot be recorded to ({error.strerror}); name a folder that can be written") from error
        self._queue: queue.Queue[QueuedFrame | None] = queue.Queue(QUEUE_FRAMES)
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def put(self, pixels: np.ndarray, attributes: Mapping[str, Any], sequence: int, time_s: float) -> bool:
        """Queues a frame, whose pixels must not change afterwards; False when it had to be dropped. Never waits."""
        try:
            self._queue.put_nowait(QueuedFrame(pixels, attributes, sequence, time_s))
        except queue.Full:
            self.dropped += 1
            return False
        return True

    def put_waiting(self, pixels: np.ndarray, attributes: Mapping[str, Any], sequence: int, time_s: float) -> None:
        """Queues a frame, waiting for room in the queue: for sources that lose nothing by it."""
        self._queue.put(QueuedFrame(pixels, attributes, sequence, time_s))

    def close(self) -> None:
        """Writes the frames in the queue and the manifest's last line, and ends the thread."""
        self._queue.put(None)
        self._thread.join()
        try:
            self._manifest.close()
        except OSError as error:
            self.last_error = f"{self.folder}: the recording could not be closed ({error.strerror}); it counts as cut off"

    def _write_all(self) -> None:
        while (frame := self._queue.get()) is not None:
            try:
                self._write(frame)
            except OSError as error:
                self.failed += 1
                reason = error.strerror or one_line(error)
                self.why_refused = f"frames are not recorded ({reason}) until there is room"
                self.last_error = f"{self.folder}: {self.why_refused}"
                self.refusing = True
            else:
                self.written += 1
                self.refusing = False

    def _write(self, frame: QueuedFrame) -> None:
        path = self.folder / f"{self._name}_{frame.sequence:06d}.exr"
        # imageCounter is a 32-bit integer
        attributes = {"imageCounter": frame.sequence % 2**31, "vemlight:time_s": repr(frame.time_s), **frame.attributes}
        pixels = frame.pixels if frame.pixels.dtype in (np.float16, np.float32) else frame.pixels.astype(np.float32)
        write_exr(path, pixels, attributes)
        try:
            self._manifest.add(path, frame.sequence, frame.time_s)
            self.nbytes += path.stat().st_size
        except OSError:  # a frame that the manifest does not list is no part of the recording
            path.unlink(missing_ok=True)
            raise
