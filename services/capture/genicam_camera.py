"""Machine-vision cameras by GenICam: frames with the exposures and time stamps that their chunks tell.

GenICam SFNC 2.7 and PFNC 2.4. One camera a process: producers serve no second reader in it.
"""

import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from vemlight.capture.genicam_controls import US, GenicamControls
from vemlight.capture.genicam_producers import Connection, connect, faults, info_of, offered_formats, on_incomplete
from vemlight.capture.pixel_formats import PFNC_FORMATS, PFNC_PICTURES, PixelFormat, codes_from_bytes, planes_from_bytes
from vemlight.capture.v4l2 import DEFAULT_FPS, RawFrame
from vemlight.errors import UserError
from vemlight.files import notice, one_line
from vemlight.light.colour_tags import ColourTags
from vemlight.source_names import GENICAM

POLL_S = 1e-3  # between two looks for a frame: the package keeps Python's lock while it waits. It adds half of that to a frame's age
LOOK_S = 1e-4  # that a look takes; the package looks again and again until then
SILENT_S = 2.0  # without a frame, after which the camera is asked whether it is there: a trigger may be slow. 1 to 5 s do
RETRY_S = 1.0  # between two searches for one that is gone; a search takes up to a second itself
SET_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
RATES = ("ResultingFrameRate", "AcquisitionResultingFrameRate", "ResultingFrameRateAbs", *SET_RATES)
FOLLOWED = 256  # stamps by which a camera's clock is laid on the host's; 50 to 1000 do
JUDGED_NS, CLOCK_ERROR = 2 * 10**9, 0.1  # after which a camera's clock is believed, or not, where it goes so much too fast or slow
IMAGE_PAYLOADS = (1, 4)  # of a buffer: an image, or one with chunks; others hold several parts or none (GenTL, PAYLOADTYPE_INFO_IDS)
BIG_ENDIAN = 2  # GenTL, PIXELENDIANNESS_IDS


class GenicamCamera:
    """A camera that streams; as `vemlight.capture.v4l2.V4l2Camera`. It may disappear and return; `state` describes it in words."""

    def __init__(
        self,
        source: str,
        *,
        form: str = "",
        width: int = 0,
        height: int = 0,
        fps: float = 0.0,
        response_bits: int | None = None,
        controls: Mapping[str, int] | None = None,
    ) -> None:
        """Asks for the format, size and rate named (0: the camera's own size and rate), and sets the `controls`.

        response_bits: of a code of the response file; None without one. Without a format, with one, the sensor's codes of so many bits,
        else the best of colour. Raises UserError when the camera cannot be used, and for raw codes of other bits than the response's.
        """
        self.path, self._wanted = source, source.removeprefix(GENICAM)
        self._requested, self._response_bits, self._controls = (form, width, height, fps), response_bits, dict(controls or {})
        self._connection: Connection | None = None
        self._retry_s = 0.0
        self.unsaid = ColourTags("linear", "bt709", "rgb", "full")
        self.controls: GenicamControls | None = None
        try:
            self._open()
        except UserError:
            self.close()
            raise
        except faults() as error:
            self.close()
            raise UserError(f"{source}: cannot be used ({one_line(error)}); check it with its maker's program") from error

    def _open(self) -> None:
        self._connection = connect(self.path, self._wanted)
        self._wanted, self.name = self._connection.id, self._connection.name  # after an outage this one, and not another first
        self._nodes = self._connection.acquirer.remote_device.node_map
        form, width, height, fps = self._requested
        self.controls = GenicamControls(self._nodes, self.path, self.controls)
        self._agree_on_format(self.controls, form, width, height)
        self.controls.hold(self._controls)
        self.fps = self._agree_on_rate(self.controls, fps)
        self._has_chunks = self._switch_on_chunks(self.controls)
        self.controls.read_back()
        self._clock = CameraClock(self.path)
        self._last, self._incomplete, self._streams, self._heard_s = -1, 0, False, time.monotonic()
        self.tags = ColourTags("linear" if self.controls.is_linear else None, None, "rgb", "full")
        self.state = f"{self.path}: {self.name}, {self.form.name} {self.width}x{self.height} at {self.fps:g} a second"

    def _agree_on_format(self, controls: GenicamControls, form: str, width: int, height: int) -> None:
        chosen = chosen_format(f"{self.path}: {self.name}", offered_formats(self._nodes), form, self._response_bits)
        if not controls.settle("PixelFormat", chosen.name):
            raise UserError(f"{self.path}: {self.name} refuses format {chosen.name}; choose another [capture] format")
        self.form = chosen
        for name, pixels, offset in (("Width", width, "OffsetX"), ("Height", height, "OffsetY")):
            if offset in self._controls:
                controls.settle(offset, 0)  # room for the size; it is set with the other controls
            if pixels:
                controls.settle(name, pixels)
        self.width, self.height = int(self._nodes.Width.value), int(self._nodes.Height.value)
        if chosen.packing:  # compiles the loop before the first frame is due
            codes_from_bytes(memoryview(bytes(16)), chosen, 4, 1, 4 * chosen.stored_bits // 8)

    def _agree_on_rate(self, controls: GenicamControls, fps: float) -> float:
        if fps and controls.read("TriggerMode") != "On":
            controls.settle("AcquisitionFrameRateEnable", True)
            for name in SET_RATES:
                if controls.read(name) is not None:
                    least, most = controls.limits(name)
                    controls.settle(name, min(max(fps, least), most))
        read = [float(rate) for name in RATES if (rate := controls.read(name))]
        return read[0] if read and controls.read("TriggerMode") != "On" else fps or DEFAULT_FPS

    def _switch_on_chunks(self, controls: GenicamControls) -> bool:
        """Whether frames will tell their exposure or time in chunks."""
        if not any(hasattr(self._nodes, name) for name in ("ChunkExposureTime", "ChunkTimestamp")):
            return False
        controls.settle("ChunkModeActive", True)
        for chunk in ("ExposureTime", "Timestamp"):
            if controls.settle("ChunkSelector", chunk):
                controls.settle("ChunkEnable", True)
        return controls.read("ChunkModeActive") is True

    def read(self, wait_s: float) -> RawFrame | None:
        """The next frame, or None when none came within `wait_s`: the camera may be gone, and is then looked for again.

        Raises UserError when it returns with another format or size.
        """
        if self._connection is None and not self._reopened():
            time.sleep(wait_s)
            return None
        assert self._connection is not None
        acquirer = self._connection.acquirer
        try:
            if not self._streams:
                on_incomplete(acquirer, self._count_incomplete)
                acquirer.start()
                self._streams, self._heard_s = True, time.monotonic()
            buffer = self._fetched(acquirer, wait_s)
            if buffer is None:
                if time.monotonic() - self._heard_s > SILENT_S:
                    self._nodes.Width.get_value(False, True)  # from the camera itself: raises when it is gone
                    self._heard_s = time.monotonic()
                return None
            self._heard_s = time.monotonic()
            try:
                return self._frame(buffer)
            finally:
                buffer.parent.queue_buffer(buffer)
        except faults() as error:
            self._drop()
            self.state, self._retry_s = f"{self.path}: is gone ({one_line(error)}); waiting for it", time.monotonic() + RETRY_S
            return None

    @staticmethod
    def _fetched(acquirer: Any, wait_s: float) -> Any:
        until_s = time.monotonic() + wait_s
        while (buffer := acquirer.try_fetch(timeout=LOOK_S, is_raw=True)) is None and time.monotonic() < until_s:
            time.sleep(POLL_S)
        return buffer

    def _count_incomplete(self) -> None:
        self._incomplete += 1

    def _frame(self, buffer: Any) -> RawFrame:
        """The frame, copied out of the package's memory, with what its chunks tell."""
        arrived_ns = time.monotonic_ns()
        if buffer.payload_type not in IMAGE_PAYLOADS:
            raise UserError(f"{self.path}: sends frames of several parts (payload {buffer.payload_type}); switch them off at the camera")
        size = info_of(buffer, "width") or self.width, info_of(buffer, "height") or self.height
        if size != (self.width, self.height):
            sent = f"sent a picture of {size[0]}x{size[1]} and had agreed to {self.width}x{self.height}"
            raise UserError(f"{self.path}: {sent}; set [capture] width and height")
        codes = planes = None
        data, form = memoryview(buffer.raw_buffer)[info_of(buffer, "image_offset") or 0 :], self.form
        if form.dtype == "<u2" and info_of(buffer, "pixel_endianness") == BIG_ENDIAN:
            form = form._replace(dtype=">u2")
        padding = info_of(buffer, "padding_x") or 0
        if form.mosaic:
            codes = codes_from_bytes(data, form, self.width, self.height, -(-self.width * form.stored_bits // 8) + padding)
        else:
            samples = 4 if form.layout in ("rgba", "bgra") else 3
            planes = planes_from_bytes([data], form, self.width, self.height, [samples * self.width + padding])
        number = info_of(buffer, "frame_id")
        lost = max(frames_missing(self._last, number) if number is not None else 0, self._incomplete)
        self._last, self._incomplete = number if number is not None else -1, 0
        monotonic_ns = self._clock.monotonic_ns(self._stamp_s(buffer), arrived_ns)
        return RawFrame(codes, form.mosaic, number or 0, monotonic_ns, lost, planes, self._chunk_exposure_s())

    def _told(self, name: str) -> Any:
        return self.controls.read(name) if self.controls else None

    def _chunk_exposure_s(self) -> float | None:
        exposure_us = self._told("ChunkExposureTime") if self._has_chunks else None
        return exposure_us * US if exposure_us else None

    def _stamp_s(self, buffer: Any) -> float | None:
        """The camera's own time of a frame in s, None where it tells none."""
        ticks = self._told("ChunkTimestamp") if self._has_chunks else None
        if ticks:
            return ticks / (self._told("GevTimestampTickFrequency") or 1e9)  # ns but in GigE Vision 1
        if nanoseconds := info_of(buffer, "timestamp_ns"):
            return nanoseconds / 1e9
        ticks, per_s = info_of(buffer, "timestamp"), info_of(buffer.parent.parent, "timestamp_frequency")
        return ticks / per_s if ticks and per_s else None

    def _reopened(self) -> bool:
        if time.monotonic() < self._retry_s:
            return False
        before = (self.form, self.width, self.height)
        try:
            self._open()
        except (UserError, *faults()):
            self._drop()
            self._retry_s = time.monotonic() + RETRY_S
            return False
        if (self.form, self.width, self.height) != before:
            found = f"{self.form.name} {self.width}x{self.height}"
            self.close()
            raise UserError(f"{self.path}: came back with {found} instead of {before[0].name} {before[1]}x{before[2]}; start again")
        return True

    def _drop(self) -> None:
        """Lets go of a camera, which may not be there any more."""
        connection, self._connection = self._connection, None
        if connection:
            with suppress(*faults()):
                connection.harvester.reset()

    def close(self) -> None:
        """Ends the stream, and sets the controls to what they were."""
        if self._connection:
            with suppress(*faults()):
                self._connection.acquirer.stop()  # while it streams, formats are locked
            if self.controls:
                self.controls.restore()
        self._drop()
        self.state = f"{self.path}: closed"


def chosen_format(camera: str, offered: list[str], form: str, response_bits: int | None) -> PixelFormat:
    """The format that was asked for, else the best. Raises UserError where there is none, and for raw codes of other bits.

    The sensor's own colours go before gray, which cameras make of them, and packed codes before others, which take more of the cable.
    """
    if form and form not in offered:
        raise UserError(f"{camera} has no format {form[:20]} but {', '.join(offered)}; set [capture] format")
    if form and form not in PFNC_FORMATS:
        raise UserError(f"{camera}: format {form[:20]} is not read; set [capture] format to one that `vemlight doctor` lists")
    known = [PFNC_FORMATS[name] for name in ([form] if form else offered) if name in PFNC_FORMATS]
    if not known:
        raise UserError(f"{camera} has no format that is read here but {', '.join(offered)}; use another camera")
    raw = [known_one for known_one in known if known_one.mosaic]
    fitting = [known_one for known_one in raw if known_one.bits == response_bits]
    if response_bits and raw and not fitting:
        bits = " and ".join(map(str, sorted({known_one.bits for known_one in raw})))
        fault = f"{form or 'what it sends'} has codes of {bits} bits and the response file is for {response_bits}"
        raise UserError(f"{camera}: {fault}; set [capture] format, or name the response of that one")
    if fitting:
        return min(fitting, key=lambda one: (one.mosaic == "mono", not one.packing))
    ranks = [name for name, _ in PFNC_PICTURES]
    pictures = [known_one for known_one in known if not known_one.mosaic]
    return min(pictures, key=lambda one: ranks.index(one.name)) if pictures else max(raw, key=lambda one: one.bits)


def frames_missing(last: int, number: int) -> int:
    """Frames between two numbers of a camera; a `last` of -1 means that there is no earlier one.

    They count on for ever, or (GigE Vision 1) from 1 to 65535 and again from 1. One that repeats or goes back counts as no loss.
    """
    if last < 0 or number > last:
        return max(number - last - 1, 0) if last >= 0 else 0
    missing = (number - last - 1) % 65535
    return missing if last <= 65535 and missing < 2**15 else 0


class CameraClock:
    """Lays a camera's stamps on this host's clock, by the frames that came quickest; the shortest delay of the cable remains in them."""

    def __init__(self, path: str) -> None:
        self._path, self._first = path, (0, 0)
        self._last_ns, self._is_followed = -1, True
        self._delays_ns: deque[int] = deque(maxlen=FOLLOWED)

    def monotonic_ns(self, stamp_s: float | None, arrived_ns: int) -> int:
        """The stamp on this host's monotonic clock; where there is none that can be believed, the time of the arrival, and a notice."""
        if stamp_s is None:
            notice(f"{self._path}: tells no time of its frames; they are stamped as they arrive")
            return arrived_ns
        stamp_ns = round(stamp_s * 1e9)
        if stamp_ns <= self._last_ns or self._last_ns < 0:
            self._delays_ns.clear()
            self._first = stamp_ns, arrived_ns
        self._last_ns = stamp_ns
        passed_ns, seen_ns = stamp_ns - self._first[0], arrived_ns - self._first[1]
        if self._is_followed and seen_ns > JUDGED_NS and abs(passed_ns - seen_ns) > CLOCK_ERROR * seen_ns:
            self._is_followed = False
            pace = f"its clock runs {passed_ns / seen_ns:.2g} times as fast as this host's"
            notice(f"{self._path}: {pace}; frames are stamped as they arrive")
        if not self._is_followed:
            return arrived_ns
        self._delays_ns.append(arrived_ns - stamp_ns)
        return stamp_ns + min(self._delays_ns)
