"""`vemlight calibrate webcam`: the response of a camera in colour, by exposures that it takes itself of a scene at rest."""

import time
from pathlib import Path

import msgspec
import numpy as np

from vemlight.capture.calibration.bracket_response import BracketResponseReport, calibrate_from_exposures
from vemlight.capture.camera_controls import EXPOSURE_NAME
from vemlight.capture.camera_source import open_camera
from vemlight.capture.colour_coding import LOWEST, colour_coding
from vemlight.capture.exposure_camera import PER_SIGNAL
from vemlight.capture.exposure_cycle import SETTLING
from vemlight.capture.genicam_camera import GenicamCamera
from vemlight.capture.planes import Planes, codes_from_planes
from vemlight.capture.scatter import ONE_THREAD
from vemlight.capture.v4l2 import V4l2Camera
from vemlight.errors import UserError
from vemlight.settings import Capture

STEP = 2.0  # from one exposure to the next: a stop; pairs are then well exposed in both over half of the range
MAX_SHOTS = 10
MEANS = 4  # frames of each exposure, whose mean has half of a frame's noise
SILENT_S = 10.0  # without a frame
RATIO = 16.0  # between the exposures that are recommended: each sees what the next one's noise hides


def calibrate_webcam(settings: Capture, out: Path, accept: bool) -> tuple[BracketResponseReport, tuple[float, ...]]:
    """Writes the response file `out`; returns the report, and exposures that span what the camera can.

    Raises UserError for a camera that cannot be used, sends raw codes, or has no control of its exposure, and as
    `calibrate_from_exposures`.
    """
    camera = open_camera(settings, None)
    try:
        if camera.form.mosaic or camera.controls is None:
            raise UserError(f"{camera.path}: sends raw codes ({camera.form.name}), not a picture in colour; calibrate it from patches")
        control = camera.controls.time_control if settings.exposure_control == EXPOSURE_NAME else settings.exposure_control
        unit_s = camera.controls.unit_s
        counts = _counts(*camera.controls.limits(control), 1 / camera.fps / unit_s)
        # the table of the coding is not used: its signals are what is calibrated
        coding = colour_coding(msgspec.structs.replace(settings, transfer="srgb"), camera.path, camera.tags, camera.unsaid)
        shots, bits = [], 8
        for count in counts:
            value = camera.controls.written(control, count)
            if value is None or value <= 0:
                raise UserError(f"{camera.path}: does not take {control} = {count}; see `vemlight doctor`")
            total = 0.0
            for k in range(SETTLING + MEANS):
                planes = _next(camera)
                if k >= SETTLING:
                    bits = planes.layout.bits
                    spans = np.tile([0, planes.width], (planes.height, 1))
                    total = total + codes_from_planes(planes, coding, spans, ONE_THREAD).astype(np.float64) / PER_SIGNAL + LOWEST
            shots.append((np.clip(np.asarray(total) / MEANS, 0, 1), value * unit_s))
    finally:
        camera.close()
    ordered = sorted(shots, key=lambda shot: -shot[1])
    distinct = [shot for n, shot in enumerate(ordered) if n == 0 or ordered[n - 1][1] > 1.1 * shot[1]]
    if len(distinct) < 2:
        fault = f"its {control} has one value alone, {ordered[0][1]:g} s"
        raise UserError(f"{camera.path}: {fault}; calibrate it from patches")
    report = calibrate_from_exposures(camera.path, distinct, bits, out, accept)
    longest, shortest = distinct[0][1], distinct[-1][1]
    steps = max(1, round(np.log(longest / shortest) / np.log(RATIO)))
    return report, tuple(float(exposure) for exposure in np.geomspace(longest, shortest, steps + 1))


def _counts(least: float, most: float, of_a_frame: float) -> list[int]:
    """Values of the control in steps of a stop, from the longest that fits into a frame down. of_a_frame: its duration in that unit."""
    count, counts = float(min(most, of_a_frame)), []
    while round(count) >= max(least, 1) and len(counts) < MAX_SHOTS:
        counts.append(round(count))
        count /= STEP
    return counts or [round(max(least, 1))]


def _next(camera: V4l2Camera | GenicamCamera) -> Planes:
    """The planes of the next frame. Raises UserError when none comes."""
    until_s = time.monotonic() + SILENT_S
    while time.monotonic() < until_s:
        raw = camera.read(0.5)
        if raw is not None and raw.planes is not None:
            return raw.planes
    raise UserError(f"{camera.path}: sends no frames ({camera.state}); check it")
