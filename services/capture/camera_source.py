"""A camera's frames as they arrive, each made into a polar map of radiance, and recorded if the settings say so."""

import json
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.capture.camera_controls import CameraControls
from vemlight.capture.colour_coding import colour_coding
from vemlight.capture.exposure_camera import ExposureCamera, values_from_coding
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.genicam_camera import GenicamCamera
from vemlight.capture.genicam_controls import GenicamControls
from vemlight.capture.lens import Lens
from vemlight.capture.pixel_formats import MJPEG
from vemlight.capture.planes import Planes, codes_from_planes, layout_of
from vemlight.capture.recorder import Recorder
from vemlight.capture.recording_attributes import map_attributes
from vemlight.capture.response import Response
from vemlight.capture.scatter import Threads
from vemlight.capture.still_source import StillReader
from vemlight.capture.v4l2 import RawFrame, V4l2Camera
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.settings import Capture
from vemlight.source_names import is_genicam

EXPOSURE_ERROR = 0.05  # between the exposure that a frame tells and the one that was read back; rows round it by a per cent or two


def open_camera(settings: Capture, response: Response | None, lens: Lens | None = None) -> V4l2Camera | GenicamCamera:
    """The camera that the settings name, for that response and lens. Raises UserError when it cannot be used."""
    if is_genicam(settings.source):  # a size is a part of the sensor there, which a lens file does not place
        return GenicamCamera(
            settings.source, form=settings.format, width=settings.width, height=settings.height, fps=settings.fps,
            response_bits=response.bits if response else None, controls=settings.controls,
        )  # fmt: skip
    width, height = lens.size if lens else (0, 0)
    return V4l2Camera(
        settings.source, form=settings.format, width=settings.width or width, height=settings.height or height, fps=settings.fps,
        in_colour=response is None, controls=settings.controls,
    )  # fmt: skip


class CameraSource:
    """A camera's frames as they arrive."""

    def __init__(self, settings: Capture):
        """Raises UserError for a camera, lens or response that cannot be used, and for a lens of another size."""
        self._maker = FrameMaker(settings, Path.cwd())
        self._camera = open_camera(settings, self._maker.response, self._maker.lens)
        self.fps, self._coding = self._camera.fps, None
        self._exposures: ExposureCamera | None = None
        self._threads = Threads(settings.threads)
        try:
            self._check_response(settings)
            if self._camera.form.mosaic is None:
                camera = self._camera
                self._coding = colour_coding(settings, camera.path, camera.tags, camera.unsaid, self._maker.response)
            # a dark frame computes the weights before the stream begins, and refuses a lens of another size
            self._made(self._dark(), 0.0)
            if settings.exposures:
                self._exposures = self._changing_exposures(settings)
        except UserError:
            self._camera.close()
            raise
        self.calibration = tuple(self._maker.files)
        self.recorder = Recorder(Path(settings.record), calibration=self.calibration) if settings.record else None
        self._first_ns: int | None = None
        self._count = 0

    @property
    def state(self) -> str:
        """For a log: what the camera sends, that it is gone, or why nothing is recorded."""
        return self.recorder.last_error if self.recorder and self.recorder.refusing else self._camera.state

    @property
    def unrecorded(self) -> int:
        """Frames that were to be recorded and are not, because the disk was full or too slow."""
        return self.recorder.failed + self.recorder.dropped if self.recorder else 0

    def next(self, wait_s: float) -> Frame | None:
        """The next frame, or None when none came within `wait_s`; `state` then says why.

        Raises UserError when the camera sends another size or format than was agreed on.
        """
        raw = self._camera.read(wait_s)
        if raw is None:
            return None
        if self._exposures and self._camera.controls and not self._exposures.received(self._camera.controls):
            return None
        self._first_ns = raw.monotonic_ns if self._first_ns is None else self._first_ns
        time_s = (raw.monotonic_ns - self._first_ns) / 1e9
        self._count += raw.lost + 1
        of_exposures: dict[str, Any] = {}
        if self._exposures:
            frame, of_exposures = self._exposures.frame(self._codes(raw), time_s, raw.exposure_s)
        else:
            frame = self._made(raw, time_s)
            self._check_exposure(raw)
        if self.recorder:
            attributes = raw_attributes(raw, self.fps, self._camera.controls)
            if self._exposures:
                attributes = self._exposures.without_exposure(attributes)
            if raw.codes is not None:
                attributes |= of_exposures
            if raw.codes is None:  # a picture in colour is recorded as its map
                attributes |= map_attributes(frame, self.fps)
            self.recorder.put(frame.radiance if raw.codes is None else raw.codes, attributes, self._count - 1, time_s)
        return frame._replace(lost=raw.lost, monotonic_ns=raw.monotonic_ns)

    def _changing_exposures(self, settings: Capture) -> ExposureCamera:
        """Raises UserError for a camera without controls, and as ExposureCamera."""
        camera, dark, response = self._camera, self._dark(), self._maker.response
        if camera.controls is None:
            raise UserError(f"{camera.path}: has no controls, and exposures need one; leave exposures out")
        if dark.codes is not None:
            values = StillReader(settings, self._maker).raw_codes(camera.path, dark.codes, dark.mosaic, 0).values
        else:
            assert dark.planes is not None
            assert self._coding is not None
            values = values_from_coding(self._coding, dark.planes.layout.bits, response.exposure_s if response else 1.0)
        return ExposureCamera(settings, self._maker, camera.path, camera.controls, values, camera.form.mosaic, self.fps)

    def _check_response(self, settings: Capture) -> None:
        """Raises UserError for a GenICam camera of raw codes without response file, and says what is in one: such sensors are linear."""
        form = self._camera.form
        if form.mosaic and self._maker.response is None and is_genicam(settings.source):
            says = f'kind = "linear", bits = {form.bits}, a = 0.0 (better: its code of darkness), b = {2**form.bits - 1}.0'
            fault = f"sends raw codes ({form.name}), which need a response file"
            raise UserError(f"{self._camera.path}: {fault}; a linear sensor's says {says}")

    def _check_exposure(self, raw: RawFrame) -> None:
        """Says it where frames tell another exposure than the one that is set."""
        held_s = self._camera.controls.exposure_s if self._camera.controls else None
        if raw.exposure_s and held_s and abs(raw.exposure_s - held_s) > EXPOSURE_ERROR * held_s:
            notice(f"{self._camera.path}: frames tell other exposures than the {held_s:g} s that is set; its light may change by itself")

    def _codes(self, raw: RawFrame) -> np.ndarray:
        """The codes of a frame of changing exposure."""
        if raw.codes is not None:
            return raw.codes
        assert raw.planes is not None
        assert self._coding is not None
        spans = self._maker.spans(self._camera.path, (raw.planes.height, raw.planes.width), None)
        return codes_from_planes(raw.planes, self._coding, spans, self._threads)

    def _made(self, raw: RawFrame, time_s: float) -> Frame:
        if raw.planes is not None:
            assert self._coding is not None
            frame = self._maker.frame_from_planes(self._camera.path, raw.planes, self._coding, time_s)
            return frame._replace(clipped=frame.saturated > 0)
        assert raw.codes is not None
        return self._maker.frame_from_codes(self._camera.path, raw.codes, raw.mosaic, time_s)

    def _dark(self) -> RawFrame:
        """A frame of zeros, as the camera sends them; JPEG files are mostly decoded to 4:2:2."""
        form, width, height = self._camera.form, self._camera.width, self._camera.height
        if form.mosaic:
            return RawFrame(np.zeros((height, width), np.uint8 if form.bits == 8 else np.uint16), form.mosaic, 0, 0, 0)
        layout = layout_of("yuv422p" if form.layout == MJPEG else form.layout)
        assert layout is not None
        samples = width * max(component.step for component in layout.components)
        plane = np.zeros((height, samples), np.uint8 if layout.item == 1 else np.uint16)
        return RawFrame(None, None, 0, 0, 0, Planes((plane,) * 3, width, height, layout))

    def close(self) -> None:
        """Ends the stream and the recording."""
        self._camera.close()
        if self.recorder:
            self.recorder.close()


def raw_attributes(raw: RawFrame, fps: float, controls: CameraControls | GenicamControls | None = None) -> dict[str, Any]:
    """The EXR attributes of a camera's frame; nanoseconds are text, because the format's integers have 32 bits."""
    captured_s = time.time() - (time.monotonic_ns() - raw.monotonic_ns) / 1e9
    held: dict[str, Any] = {"vemlight:controls": json.dumps(controls.values)} if controls and controls.values else {}
    if exposure_s := raw.exposure_s or (controls.exposure_s if controls else None):
        held["expTime"] = exposure_s
    return {
        **held,
        "vemlight:kind": "codes",
        **({"vemlight:mosaic": raw.mosaic} if raw.mosaic else {}),
        "vemlight:monotonic_ns": str(raw.monotonic_ns),
        "vemlight:kernel_sequence": str(raw.sequence),
        "colorInteropID": "data",
        "framesPerSecond": Fraction(fps).limit_denominator(1001),
        "capDate": time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(captured_s)),
        "utcOffset": 0.0,
    }
