"""Cameras of the Linux kernel (Video4Linux2): raw frames by its streaming calls, with its time stamps and sequence numbers.

linuxpy provides the structures and calls; formats are enumerated here from the bare structure, because linuxpy's own list lacks some
codes.
"""

import errno
import fcntl
import os
import select
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.frames import Mosaic
from vemlight.capture.pixel_formats import FORMATS, codes_from_bytes
from vemlight.errors import UserError

BUFFERS = 4  # frames that the kernel keeps while we are busy, 160 ms at 25 a second; further ones are lost and counted; 2 to 32 do
DEFAULT_FPS = 25.0  # assumed of cameras without a rate of their own, which an external trigger drives
DISCONNECTED = (errno.ENODEV, errno.ENXIO, errno.EIO, errno.ENOENT, errno.EBADF)  # what calls to an unplugged camera return
MAX_FORMATS = 1000  # of one camera: the enumeration ends with EINVAL, which a faulty driver may never return; 100 or more do


class RawFrame(NamedTuple):
    """One frame as the camera sent it."""

    codes: np.ndarray  # (height, width) uint8 or uint16
    mosaic: Mosaic
    sequence: int  # the kernel's number
    monotonic_ns: int  # the kernel's time stamp, on the monotonic clock
    lost: int  # frames between the previous one and this one


class CameraInfo(NamedTuple):
    """A camera on this machine."""

    path: str
    card: str  # the driver's name of it
    formats: list[str]  # names of those that can be read here


def list_cameras() -> list[CameraInfo]:
    """The cameras on this machine, /dev/video0 first; those that cannot be opened are left out."""
    cameras = []
    for path in sorted(Path("/dev").glob("video*"), key=lambda p: (len(p.name), p.name)):
        try:
            device = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except OSError:
            continue
        try:
            card, streams = _capabilities(device)
            if streams:
                cameras.append(CameraInfo(str(path), card, [FORMATS[code].name for code in _offered(device) if code in FORMATS]))
        except OSError:
            continue
        finally:
            os.close(device)
    return cameras


def _capabilities(device: int) -> tuple[str, bool]:
    # name of the card, and whether it streams video to us
    from linuxpy.video import device as v4l2

    answer = v4l2.read_capabilities(device)
    wanted = v4l2.Capability.VIDEO_CAPTURE | v4l2.Capability.STREAMING
    return answer.card.decode(errors="replace"), v4l2.Capability(answer.device_caps) & wanted == wanted


def _offered(device: int) -> list[int]:
    # codes of all formats that the camera offers
    from linuxpy.video import device as v4l2

    codes = []
    for index in range(MAX_FORMATS):
        description = v4l2.raw.v4l2_fmtdesc(index=index, type=v4l2.BufferType.VIDEO_CAPTURE)
        try:
            fcntl.ioctl(device, v4l2.IOC.ENUM_FMT.value, description)
        except OSError as error:
            if error.errno == errno.EINVAL:
                break
            raise
        codes.append(int(description.pixelformat))
    return codes


class V4l2Camera:
    """A camera that streams. It may disappear and return; `state` describes it in words."""

    def __init__(self, path: str, *, form: str = "", width: int = 0, height: int = 0, fps: float = 0.0):
        """Asks for the format, size and rate named (empty or 0: the deepest format known here, the camera's own size and rate).

        `name`, `form`, `width`, `height` and `fps` are then what the camera agreed to; the stream begins with the first `read`.
        Raises UserError when the camera cannot be used.
        """
        self.path = path
        self._requested = (form, width, height, fps)
        self._device, self._buffers = -1, []
        self._streams, self._last = False, -1
        try:
            self._open()
        except UserError:
            self._close()
            raise
        except OSError as error:
            self._close()
            raise UserError(f"{path}: cannot be opened as a camera ({error.strerror}); check the path, or free it") from error

    def _open(self) -> None:
        from linuxpy.video import device as v4l2

        self._device = os.open(self.path, os.O_RDWR | os.O_NONBLOCK)
        self.name, streams = _capabilities(self._device)
        if not streams:
            raise UserError(f"{self.path}: {self.name} streams no video; name a camera")
        form, width, height, fps = self._requested
        self._agree_on_format(form, width, height)
        kind = v4l2.BufferType.VIDEO_CAPTURE
        try:
            if fps:
                v4l2.set_fps(self._device, kind, fps)
            self.fps = float(v4l2.get_fps(self._device, kind))
        except (OSError, ZeroDivisionError):
            self.fps = fps or DEFAULT_FPS
        v4l2.request_buffers(self._device, kind, v4l2.Memory.MMAP, BUFFERS)
        for index in range(BUFFERS):
            buffer = v4l2.query_buffer(self._device, kind, v4l2.Memory.MMAP, index)
            self._buffers.append(v4l2.mmap_from_buffer(self._device, buffer))
            v4l2.enqueue_buffer_raw(self._device, buffer)
        self._streams, self._last = False, -1
        self.state = f"{self.path}: {self.name}, {self.form.name} {self.width}x{self.height} at {self.fps:g} a second"

    def _agree_on_format(self, form: str, width: int, height: int) -> None:
        # the driver may change what it is asked for; only another format is refused here, as the size is checked with the lens
        from linuxpy.video import device as v4l2

        kind = v4l2.BufferType.VIDEO_CAPTURE
        current = v4l2.get_raw_format(self._device, kind).fmt.pix
        code = self._choose_format(form)
        v4l2.set_format(self._device, kind, width or current.width, height or current.height, code)
        agreed = v4l2.get_raw_format(self._device, kind).fmt.pix
        if agreed.pixelformat not in FORMATS or (form and FORMATS[agreed.pixelformat].name != form):
            raise UserError(f"{self.path}: {self.name} refuses format {FORMATS[code].name}; choose another [capture] format")
        self.form, self.width, self.height = FORMATS[agreed.pixelformat], int(agreed.width), int(agreed.height)
        self._stride = int(agreed.bytesperline)

    def _choose_format(self, form: str) -> Any:
        # the code of the format that was asked for, else of the deepest
        offered = [code for code in _offered(self._device) if code in FORMATS]
        names = ", ".join(FORMATS[code].name for code in offered)
        if form:
            for code in offered:
                if FORMATS[code].name == form:
                    return code
            raise UserError(f"{self.path}: {self.name} has no format {form} but {names or 'none that is read here'}; set [capture] format")
        if not offered:
            raise UserError(f"{self.path}: {self.name} has no raw format (GREY, Y10, Y12, Y16 or Bayer); use another camera")
        return max(offered, key=lambda code: (FORMATS[code].bits, FORMATS[code].mosaic == "mono", -code))

    def read(self, wait_s: float) -> RawFrame | None:
        """The next frame, or None when none came within `wait_s`: the camera may be gone, and is then looked for again.

        Raises UserError when it returns with another format or size.
        """
        if self._device < 0 and not self._reopened():
            select.select([], [], [], wait_s)
            return None
        try:
            if not self._streams:
                self._stream()
            ready, _, broken = select.select([self._device], [], [self._device], wait_s)
            if not ready and not broken:
                return None
            return self._dequeue()
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            if error.errno not in DISCONNECTED:
                raise
            self._close()
            self.state = f"{self.path}: is gone ({error.strerror}); waiting for it"
            return None

    def _stream(self) -> None:
        from linuxpy.video import device as v4l2

        v4l2.stream_on(self._device, v4l2.BufferType.VIDEO_CAPTURE)
        self._streams = True

    def _dequeue(self) -> RawFrame | None:
        from linuxpy.video import device as v4l2

        buffer = v4l2.dequeue_buffer(self._device, v4l2.BufferType.VIDEO_CAPTURE, v4l2.Memory.MMAP)
        try:
            damaged = v4l2.BufferFlag.ERROR in v4l2.BufferFlag(buffer.flags)
            codes = None if damaged else self._codes(buffer)
            sequence = int(buffer.sequence)
            monotonic_ns = buffer.timestamp.secs * 10**9 + buffer.timestamp.usecs * 1000
        finally:
            v4l2.enqueue_buffer_raw(self._device, buffer)
        if codes is None:
            return None  # the next frame counts it as lost, by its number
        lost = frames_between(self._last, sequence)
        self._last = sequence
        return RawFrame(codes, self.form.mosaic, sequence, monotonic_ns, lost)

    def _codes(self, buffer: Any) -> np.ndarray:
        # copied out of the kernel's memory
        try:
            with memoryview(self._buffers[buffer.index])[: buffer.bytesused] as data:
                return codes_from_bytes(data, self.form, self.width, self.height, self._stride)
        except ValueError as error:
            raise UserError(f"{self.path}: {error}, which it had agreed to send; set [capture] width and height") from error

    def _reopened(self) -> bool:
        before = (self.form, self.width, self.height)
        try:
            self._open()
        except (OSError, UserError):
            self._close()
            return False
        if (self.form, self.width, self.height) != before:
            found = f"{self.form.name} {self.width}x{self.height}"
            self._close()
            raise UserError(f"{self.path}: came back with {found} instead of {before[0].name} {before[1]}x{before[2]}; start again")
        return True

    def _close(self) -> None:
        for mapped in self._buffers:
            mapped.close()
        self._buffers = []
        if self._device >= 0:
            os.close(self._device)
        self._device = -1

    def close(self) -> None:
        """Ends the stream."""
        self._close()
        self.state = f"{self.path}: closed"


def frames_between(last: int, sequence: int) -> int:
    """Frames lost between two of the kernel's 32-bit sequence numbers; a `last` of -1 means that there is no earlier one.

    A number that repeats or goes back, as drivers send under load and after a restart, counts as no loss.
    """
    lost = (sequence - last - 1) % 2**32
    return 0 if last < 0 or lost >= 2**31 else lost
