"""Cameras of the Linux kernel (Video4Linux2): frames by its streaming calls, with its time stamps and sequence numbers.

linuxpy provides the structures and calls; formats are enumerated here from the bare structure, because linuxpy's own list lacks some
codes.
"""

import errno
import fcntl
import os
import select
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.camera_controls import CameraControls, controls_of
from vemlight.capture.jpeg_frames import JpegDecoder
from vemlight.capture.mosaic import Mosaic
from vemlight.capture.pixel_formats import FORMATS, MJPEG, PICTURE_RANK, PixelFormat, codes_from_bytes, planes_from_bytes
from vemlight.capture.planes import Planes, layout_of
from vemlight.capture.v4l2_buffers import FilledBuffer, FrameBuffers
from vemlight.capture.v4l2_colour import colour_of_format
from vemlight.errors import UserError

DEFAULT_FPS = 25.0  # assumed of cameras without a rate of their own, which an external trigger drives
DISCONNECTED = (errno.ENODEV, errno.ENXIO, errno.EIO, errno.ENOENT, errno.EBADF)  # what calls to an unplugged camera return
MAX_FORMATS = 1000  # of one camera: the enumeration ends with EINVAL, which a faulty driver may never return; 100 or more do


class RawFrame(NamedTuple):
    """One frame as the camera sent it: raw codes, or the planes of a picture in colour."""

    codes: np.ndarray | None  # (height, width) uint8 or uint16
    mosaic: Mosaic | None
    sequence: int  # the kernel's number
    monotonic_ns: int  # the kernel's time stamp, on the monotonic clock
    lost: int  # frames between the previous one and this one
    planes: Planes | None = None
    exposure_s: float | None = None  # where the camera tells each frame's


class CameraInfo(NamedTuple):
    """A camera on this machine."""

    path: str
    card: str  # the driver's name of it
    formats: list[str]  # names of those that can be read here
    others: tuple[str, ...] = ()  # four letters of those that it has as well
    controls: tuple[str, ...] = ()  # names of those that have one number each
    is_free: bool = True  # False: another program has it


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
                codes = _offered(device)
                known = [FORMATS[code].name for code in codes if code in FORMATS]
                others = tuple(_letters(code) for code in codes if code not in FORMATS)
                cameras.append(CameraInfo(str(path), card, known, others, tuple(controls_of(device))))
        except OSError:
            continue
        finally:
            os.close(device)
    return cameras


def _letters(code: int) -> str:
    text = (code & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1").strip()
    return text if text.isprintable() else f"{code:#x}"


def _capabilities(device: int) -> tuple[str, bool]:
    # name of the card, and whether it streams video to us
    from linuxpy.video import device as v4l2

    answer = v4l2.read_capabilities(device)
    capabilities = v4l2.Capability(answer.device_caps)
    captures = capabilities & (v4l2.Capability.VIDEO_CAPTURE | v4l2.Capability.VIDEO_CAPTURE_MPLANE)
    return answer.card.decode(errors="replace"), bool(captures) and v4l2.Capability.STREAMING in capabilities


def _is_multiplanar(device: int) -> bool:
    from linuxpy.video import device as v4l2

    return v4l2.Capability.VIDEO_CAPTURE not in v4l2.Capability(v4l2.read_capabilities(device).device_caps)


def _offered(device: int) -> list[int]:
    # codes of all formats that the camera offers
    from linuxpy.video import device as v4l2

    kind = v4l2.BufferType.VIDEO_CAPTURE_MPLANE if _is_multiplanar(device) else v4l2.BufferType.VIDEO_CAPTURE
    codes = []
    for index in range(MAX_FORMATS):
        description = v4l2.raw.v4l2_fmtdesc(index=index, type=kind)
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

    def __init__(
        self,
        path: str,
        *,
        form: str = "",
        width: int = 0,
        height: int = 0,
        fps: float = 0.0,
        in_colour: bool = False,
        controls: Mapping[str, int] | None = None,
    ):
        """Asks for the format, size and rate named (0: the camera's own size and rate), and sets the `controls`.

        Without a format, the deepest one of raw codes known here, or with `in_colour` the best of pictures in colour.
        `name`, `form`, `width`, `height` and `fps` are then what the camera agreed to, `tags` and `unsaid` what it says of its colours;
        the stream begins with the first `read`. Raises UserError when the camera cannot be used.
        """
        self.path = path
        self._requested = (form, width, height, fps)
        self._in_colour, self._wanted = in_colour, dict(controls or {})
        self._device = -1
        self._buffers: FrameBuffers | None = None
        self.controls: CameraControls | None = None
        self._streams, self._last = False, -1
        try:
            self._open()
        except UserError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise UserError(f"{path}: cannot be opened as a camera ({error.strerror}); check the path, or free it") from error

    def _open(self) -> None:
        from linuxpy.video import device as v4l2

        self._device = os.open(self.path, os.O_RDWR | os.O_NONBLOCK)
        self.name, streams = _capabilities(self._device)
        if not streams:
            raise UserError(f"{self.path}: {self.name} streams no video; name a camera")
        form, width, height, fps = self._requested
        self._multiplanar = _is_multiplanar(self._device)
        kind = v4l2.BufferType.VIDEO_CAPTURE_MPLANE if self._multiplanar else v4l2.BufferType.VIDEO_CAPTURE
        planes = self._agree_on_format(kind, form, width, height)
        try:
            if self._multiplanar:
                self.fps = _multiplanar_rate(self._device, fps)
            else:
                if fps:
                    v4l2.set_fps(self._device, kind, fps)
                self.fps = float(v4l2.get_fps(self._device, kind))
        except (OSError, ZeroDivisionError):
            self.fps = fps or DEFAULT_FPS
        self.controls = CameraControls(self._device, self.path, self._wanted)
        self._buffers = FrameBuffers(self._device, self._multiplanar, planes)
        self._jpeg = JpegDecoder() if self.form.layout == MJPEG else None
        self._streams, self._last = False, -1
        self.state = f"{self.path}: {self.name}, {self.form.name} {self.width}x{self.height} at {self.fps:g} a second"

    def _agree_on_format(self, kind: Any, form: str, width: int, height: int) -> int:
        """Returns how many buffers a frame has.

        The driver may change what it is asked for; only another format is refused here, as the size is checked with the lens.
        """
        from linuxpy.video import device as v4l2

        current = v4l2.get_raw_format(self._device, kind).fmt.pix  # width, height and format lie alike in both structures
        code = self._choose_format(form)
        v4l2.set_format(self._device, kind, width or current.width, height or current.height, code)
        answer = v4l2.get_raw_format(self._device, kind).fmt
        pix = answer.pix_mp if self._multiplanar else answer.pix
        if pix.pixelformat not in FORMATS or (form and FORMATS[pix.pixelformat].name != form):
            raise UserError(f"{self.path}: {self.name} refuses format {FORMATS[code].name}; choose another [capture] format")
        self.form, self.width, self.height = FORMATS[pix.pixelformat], int(pix.width), int(pix.height)
        rows_of = pix.plane_fmt[: pix.num_planes] if self._multiplanar else [pix]
        self._strides = [int(plane.bytesperline) for plane in rows_of]
        layout = layout_of(self.form.layout)
        self.tags, self.unsaid = colour_of_format(pix, layout is not None and layout.is_rgb, self.form.layout == MJPEG)
        return len(self._strides)

    def _choose_format(self, form: str) -> Any:
        # the code of the format that was asked for, else of the deepest, or of the best in colour
        offered = [code for code in _offered(self._device) if code in FORMATS]
        names = ", ".join(FORMATS[code].name for code in offered)
        if form:
            for code in offered:
                if FORMATS[code].name == form:
                    return code
            raise UserError(f"{self.path}: {self.name} has no format {form} but {names or 'none that is read here'}; set [capture] format")
        if not offered:
            raise UserError(f"{self.path}: {self.name} has no format that is read here; use another camera, or see `vemlight doctor`")
        return min(offered, key=lambda code: (bool(FORMATS[code].mosaic) == self._in_colour, _rank(FORMATS[code]), code))

    def read(self, wait_s: float) -> RawFrame | None:
        """The next frame, or None when none came within `wait_s`: the camera may be gone, and is then looked for again.

        Raises UserError when it returns with another format or size.
        """
        if self._device < 0 and not self._reopened():
            select.select([], [], [], wait_s)
            return None
        assert self._buffers is not None
        try:
            if not self._streams:
                self._buffers.stream()
                self._streams = True
            ready, _, broken = select.select([self._device], [], [self._device], wait_s)
            if not ready and not broken:
                return None
            with self._buffers.filled() as filled:
                return self._frame(filled)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            if error.errno not in DISCONNECTED:
                raise
            self._close()
            self.state = f"{self.path}: is gone ({error.strerror}); waiting for it"
            return None

    def _frame(self, filled: FilledBuffer) -> RawFrame | None:
        """The frame, copied out of the kernel's memory; None for a damaged one, which the next counts as lost, by its number."""
        codes = planes = None
        try:
            if not filled.planes:
                return None
            if self.form.mosaic:
                codes = codes_from_bytes(filled.planes[0], self.form, self.width, self.height, self._strides[0])
            elif self._jpeg:
                planes = self._jpeg.planes(self.path, bytes(filled.planes[0]), self.width, self.height)
                if planes is None:
                    return None
            else:
                planes = planes_from_bytes(filled.planes, self.form, self.width, self.height, self._strides)
        except ValueError as error:
            raise UserError(f"{self.path}: {error}, which it had agreed to send; set [capture] width and height") from error
        lost = frames_between(self._last, filled.sequence)
        self._last = filled.sequence
        return RawFrame(codes, self.form.mosaic, filled.sequence, filled.monotonic_ns, lost, planes)

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
        if self._buffers:
            self._buffers.close()
        self._buffers = None
        if self._device >= 0:
            os.close(self._device)
        self._device = -1

    def close(self) -> None:
        """Ends the stream, and sets the controls to what they were."""
        if self._device >= 0 and self.controls:
            self.controls.restore()
        self._close()
        self.state = f"{self.path}: closed"


def _multiplanar_rate(device: int, fps: float) -> float:
    """Asks for a rate, if it is not 0, and returns the one in use; linuxpy does this for single-planar cameras alone."""
    from linuxpy.video import device as v4l2

    parameters = v4l2.raw.v4l2_streamparm()
    parameters.type = v4l2.BufferType.VIDEO_CAPTURE_MPLANE
    if fps:
        period = Fraction(1) / Fraction(fps).limit_denominator(1001)
        parameters.parm.capture.timeperframe.numerator, parameters.parm.capture.timeperframe.denominator = period.as_integer_ratio()
        fcntl.ioctl(device, v4l2.IOC.S_PARM.value, parameters)
    fcntl.ioctl(device, v4l2.IOC.G_PARM.value, parameters)
    period = parameters.parm.capture.timeperframe
    return period.denominator / period.numerator


def _rank(form: PixelFormat) -> tuple[int, bool]:
    """Of raw formats the deepest comes first, of pictures in colour the best."""
    return (-form.bits, form.mosaic != "mono") if form.mosaic else (PICTURE_RANK[form.name], False)


def frames_between(last: int, sequence: int) -> int:
    """Frames lost between two of the kernel's 32-bit sequence numbers; a `last` of -1 means that there is no earlier one.

    A number that repeats or goes back, as drivers send under load and after a restart, counts as no loss.
    """
    lost = (sequence - last - 1) % 2**32
    return 0 if last < 0 or lost >= 2**31 else lost
