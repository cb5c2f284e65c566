"""`vemlight calibrate lens`: from photographs of a board to the lens file and a picture of what it rests on."""

import math
from pathlib import Path

import cv2
import msgspec
import numpy as np

from vemlight.capture.calibration.boards import CalibrationBoard, read_views
from vemlight.capture.calibration.lens_fit import PARAMETERS, LensReport, fit_lens
from vemlight.capture.lens import Lens, angle_from_radius, centred_points, check_lens, pixel_from_direction, write_lens
from vemlight.errors import UserError
from vemlight.light.images import write_png
from vemlight.light.sphere import direction_from_angles
from vemlight.runtime.progress import awaited

# RMS by the image's longer side, half a degree across 180: a board of another size than stated leaves 20e-3, a good set 0.5e-3, so any
# value from 1e-3 to 10e-3 does.
MAX_RMS_FRACTION = 3e-3
RIM_BRIGHTNESS = 1 / 3  # of the middle's median: a pixel below is outside the image circle; 0.2 to 0.5 do
RIM_STEP_DEG = 0.5  # by which the rim is lowered until the polynomial is monotonic there; 0.1 to 1 do
ERROR_SCALE = 50  # of the errors in the picture


def calibrate_lens(
    images: list[Path], board: CalibrationBoard, out: Path, *, rim_deg: float = 0.0, accept: bool = False, picture: Path | None = None
) -> LensReport:
    """Finds the lens from photographs of `board`, writes the lens file `out` and, if named, a PNG of coverage and residuals.

    The rim is `rim_deg`, or (0) where the photographs end: at the edge of the image circle, else at the farthest corner of the image.
    Raises UserError for images that cannot be used (too few, blurred, of two sizes, or with another board), and for a lens that fits its
    corners badly, unless `accept` allows it.
    """
    found = read_views(images, board)
    with awaited(f"fitting the lens to {len(found.views)} views"):
        report = fit_lens(found.views, found.size, found.without_board)
    limit = MAX_RMS_FRACTION * max(found.size)
    if report.rms_px > limit and not accept:
        fits = f"the lens fits the corners to {report.rms_px:.1f} px only, {limit:.1f} or less is expected"
        raise UserError(f"{fits}; see whether the board has {board.corners[0]} x {board.corners[1]} inner corners, or --accept it")
    rim = rim_deg or rim_from_brightness(report.lens, found.brightest)
    lens = _with_rim(report.lens, max(rim, report.reach_deg), required=bool(rim_deg))
    write_lens(out, lens)
    report = report._replace(lens=lens)
    if picture:
        write_png(picture, coverage_picture(report, found.brightest)[..., ::-1])
    return report


def lens_summary(report: LensReport) -> str:
    """The report in lines for a terminal."""
    lens, px = report.lens, "px RMS"
    reach = f"corners reach {report.reach_deg:.1f} degrees, the rim is at {lens.rim_deg:.1f}"
    lines = [f"{report.rms_px:.3f} {px} over {lens.views} views; {reach}"]
    lines += [f"  {name}: {rms:.3f} {px}" for name, rms in report.views.items()]
    lines += [f"  {name}: left out, {rms:.3f} {px}" for name, rms in report.rejected.items()]
    lines += [f"  {name}: no board found" for name in report.without_board]
    if report.outliers:
        lines.append(f"  {report.outliers} single corners left out")
    values: dict[str, float] = dict(zip(map(str, PARAMETERS), (*lens.f, *lens.c, *lens.k, *lens.p), strict=True))
    return "\n".join([*lines, *(f"{name} = {values[name]:.6g} +- {sigma:.2g}" for name, sigma in report.sigma.items())])


def rim_from_brightness(lens: Lens, brightest: np.ndarray) -> float:
    """Angle in degrees at which the image circle ends, from the `brightest` value of each pixel, (height, width) uint8.

    That is the first ring of which less than half is lit, as across a sharp edge the fraction falls from 1 to 0 within a pixel or two;
    without such an edge, the farthest corner of the image.
    """
    height, width = brightest.shape
    radius = np.hypot(*centred_points(lens)) * lens.f[0]
    ring = radius.astype(int)
    lit = brightest > np.median(brightest[radius < min(height, width) / 4]) * RIM_BRIGHTNESS
    lit_fraction = np.bincount(ring.ravel(), lit.ravel()) / np.maximum(np.bincount(ring.ravel()), 1)
    # a ring is judged when enough of it lies in the image: at least as many pixels as a quarter circle has
    judged = np.flatnonzero(np.bincount(ring.ravel()) > 0.5 * math.pi * np.arange(len(lit_fraction)))
    dark = judged[(lit_fraction[judged] < 0.5) & (judged > min(height, width) / 4)]
    edge = float(dark[0]) if len(dark) else float(radius.max())
    return math.degrees(min(angle_from_radius(edge / lens.f[0], lens.intrinsics), math.pi))


def _with_rim(lens: Lens, rim_deg: float, required: bool) -> Lens:
    # the lens up to `rim_deg`, or to where its polynomial would turn back unless that rim is required
    for degrees in [rim_deg] if required else np.arange(rim_deg, lens.rim_deg, -RIM_STEP_DEG):
        wider = msgspec.structs.replace(lens, rim_deg=min(float(degrees), 180.0))
        try:
            check_lens(wider)
            return wider
        except UserError:
            if required:
                raise
    return lens


def coverage_picture(report: LensReport, brightest: np.ndarray) -> np.ndarray:
    """Image (height, width, 3) uint8, BGR: the corners with their errors magnified, over circles each 30 degrees and the rim."""
    image = cv2.cvtColor((brightest * 0.5).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    lens = report.lens
    middle = (round(lens.c[0]), round(lens.c[1]))
    for degrees in (*range(30, int(lens.rim_deg), 30), lens.rim_deg):
        circle = pixel_from_direction(direction_from_angles(math.radians(degrees), np.radians(np.arange(0, 360, 3))), lens)
        cv2.polylines(image, [np.rint(circle).astype(np.int32)], True, (200, 160, 60), 1, cv2.LINE_AA)
        top = (middle[0] + 3, round(circle[:, 1].min()) + 14)
        cv2.putText(image, f"{degrees:.0f}", top, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (200, 160, 60), 1)
    for x, y, dx, dy in report.residuals:
        start, end = (round(x), round(y)), (round(x + ERROR_SCALE * dx), round(y + ERROR_SCALE * dy))
        cv2.line(image, start, end, (60, 200, 255), 1, cv2.LINE_AA)
        cv2.circle(image, start, 2, (80, 255, 80), -1, cv2.LINE_AA)
    text = f"{lens.views} views, {report.rms_px:.2f} px RMS, corners out to {report.reach_deg:.0f} degrees; errors x {ERROR_SCALE}"
    cv2.putText(image, text, (8, image.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return image
