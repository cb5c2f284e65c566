"""Frames written as they come, without holding anything up: a bounded queue, and a thread that writes EXR and manifest."""

import os
import queue
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from vemlight.capture.sequence import MANIFEST, file_entry
from vemlight.errors import UserError
from vemlight.light.images import write_exr

WAITING = 8  # frames that may wait for the disk: a third of a second at 25 a second, 100 MB at 1024 x 1024 RGB


class _Item(NamedTuple):
    pixels: np.ndarray
    attributes: Mapping[str, Any]
    sequence: int
    time_s: float


class Recorder:
    """Writes frames to a folder as NAME_000000.exr, numbered by their sequence, and lists each in manifest.jsonl once it is whole.

    `written`, `dropped` (the queue was full) and `failed` (the disk refused) count frames; `trouble` says why the last one failed.
    """

    def __init__(self, folder: Path, name: str = "frame", beside: tuple[Path, ...] = ()):
        """Copies the files `beside` (lens and response) into the folder. Raises UserError when it cannot be made or holds a recording."""
        self.folder, self.written, self.dropped, self.failed, self.trouble = folder, 0, 0, 0, ""
        self._name = name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / MANIFEST).exists():
                raise UserError(f"{folder}: holds a recording already; name another folder, or remove it")
            for path in beside:
                shutil.copyfile(path, folder / path.name)
            self._manifest = open(folder / MANIFEST, "ab", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise UserError(f"{folder}: cannot be recorded to ({error.strerror}); name a folder that can be written") from error
        self._queue: queue.Queue[_Item | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def put(self, pixels: np.ndarray, attributes: Mapping[str, Any], sequence: int, time_s: float) -> bool:
        """Hands over a frame, which must not change afterwards; False when it had to be dropped. Never waits."""
        try:
            self._queue.put_nowait(_Item(pixels, attributes, sequence, time_s))
        except queue.Full:
            self.dropped += 1
            return False
        return True

    def close(self) -> None:
        """Writes what waits, and ends."""
        self._queue.put(None)
        self._thread.join()
        self._manifest.close()

    def _write_all(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                self._write(item)
            except OSError as error:
                self.failed += 1
                self.trouble = f"{self.folder}: frame {item.sequence} was not recorded ({error.strerror or error}); free some space"
            else:
                self.written += 1

    def _write(self, item: _Item) -> None:
        path = self.folder / f"{self._name}_{item.sequence:06d}.exr"
        attributes = {"imageCounter": item.sequence % 2**31, "vemlight:time_s": repr(item.time_s), **item.attributes}
        pixels = item.pixels if item.pixels.dtype in (np.float16, np.float32) else item.pixels.astype(np.float32)
        write_exr(path, pixels, attributes)
        end = self._manifest.seek(0, os.SEEK_END)
        line = msgspec.json.encode(file_entry(path, item.sequence, item.time_s)) + b"\n"
        try:
            if self._manifest.write(line) != len(line):
                raise OSError(f"{MANIFEST}: the disk is full")
        except OSError:
            # half a line would spoil the list, and a frame outside it would be no part of the recording
            self._manifest.truncate(end)
            path.unlink(missing_ok=True)
            raise
