"""The lens found from photographs of a flat board.

Everything is fitted on rays, so that boards beyond 90 degrees from the axis count like all others. A start comes from trying focal lengths:
each turns corners into rays of an equidistant lens, and a board's plane into a linear problem. Then all poses and the lens are fitted
together to the corners' pixels, with a robust loss; views that do not fit are left out and named.
"""

import datetime
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vemlight.capture.calibration.boards import Board, View, read_views
from vemlight.capture.lens import Lens, angle_from_radius, check_lens, radius_from_angle, write_lens
from vemlight.errors import UserError
from vemlight.runtime.progress import awaited

FEWEST = 3  # views: two planes leave the focal length and the centre to each other
LOSS_PX = 1.0  # corners farther off than this pull in proportion to their distance, not to its square
BAD_VIEW = 2.5  # times the median of the views' RMS
BAD_VIEW_PX = 0.5  # and never below this: a set may be even better
PRIOR = 0.3  # expected size of each term k_n theta^(2n) at the rim of the corners; one pixel's weight, felt only where corners say nothing
WORST = 3e-3  # RMS by the image's longer side, half a degree across 180; a board of another size than told leaves 20e-3, a good set 0.5e-3
WILD = 6.0  # corners farther off than this many medians are no corners: of 10^5 Gaussian errors one is
SIMPLER = 1.012  # fewer terms are taken when the RMS rises by no more than this: what is not needed runs wild beyond the corners.
# Errors of photographs repeat from view to view, and let a needless term take 0.01; one that an equisolid lens needs takes 0.015 to 0.02
Vector = Callable[[np.ndarray], np.ndarray]
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")


class LensReport(NamedTuple):
    """What a calibration found."""

    lens: Lens
    rms_px: float  # over the kept views' corners
    views: dict[str, float]  # RMS in px of each view kept
    rejected: dict[str, float]  # RMS in px under the final lens of each view left out
    without: list[str]  # images in which no board was found
    wild: int  # corners of kept views that were left out
    sigma: dict[str, float]  # standard deviation of each parameter that was fitted
    reach_deg: float  # angle off the axis of the outermost corner
    residuals: np.ndarray  # (n, 4): pixel x, y and the error's x, y


def calibrate_lens(
    images: list[Path], board: Board, out: Path, *, rim_deg: float = 0.0, accept: bool = False, picture: Path | None = None
) -> LensReport:
    """Finds the lens from photographs of `board`, writes the lens file `out` and, if named, a PNG of coverage and residuals.

    The rim is `rim_deg`, or (0) where the photographs end: at the edge of the image circle, else at the farthest corner of the image.
    Raises UserError for images that cannot be used: too few, blurred, of two sizes, or with another board; and for a lens that fits its
    corners badly, which is let through by `accept`.
    """
    views, without, size, brightest = read_views(images, board)
    with awaited(f"fitting the lens to {len(views)} views"):
        report = fit_lens(views, size, without)
    if report.rms_px > WORST * max(size) and not accept:
        fits = f"the lens fits the corners to {report.rms_px:.1f} px only, {WORST * max(size):.1f} or less is expected"
        raise UserError(f"{fits}: see whether the board has {board.corners[0]} x {board.corners[1]} inner corners, or --accept it")
    rim = rim_deg or _rim_deg(report.lens, brightest)
    lens = _with_rim(report.lens, max(rim, report.reach_deg), asked=bool(rim_deg))
    write_lens(out, lens)
    report = report._replace(lens=lens)
    if picture:
        cv2.imwrite(str(picture), coverage_picture(report, brightest))
    return report


def lens_summary(report: LensReport) -> str:
    """The report in lines for a terminal."""
    lens, px = report.lens, "px RMS"
    reach = f"corners reach {report.reach_deg:.1f} degrees, the rim is at {lens.rim_deg:.1f}"
    lines = [f"{report.rms_px:.3f} {px} over {lens.views} views; {reach}"]
    lines += [f"  {name}: {rms:.3f} {px}" for name, rms in report.views.items()]
    lines += [f"  {name}: left out, {rms:.3f} {px}" for name, rms in report.rejected.items()]
    lines += [f"  {name}: no board found" for name in report.without]
    if report.wild:
        lines.append(f"  {report.wild} single corners left out")
    values: dict[str, float] = dict(zip(map(str, NAMES), (*lens.f, *lens.c, *lens.k), strict=True))
    return "\n".join([*lines, *(f"{name} = {values[name]:.6g} +- {sigma:.2g}" for name, sigma in report.sigma.items())])


def fit_lens(views: list[View], size: tuple[int, int], without: list[str] | None = None) -> LensReport:
    """The lens from corners alone; its rim is where the outermost corner lies. Raises UserError for too few views."""
    _enough(views, without or [])
    kept = list(views)
    lens, poses = _start(kept, size)
    while True:
        lens, poses, jacobian, miss = _fit(kept, lens, poses, 4)
        rms = np.array([_rms([m]) for m in miss])
        worst = int(rms.argmax())
        if rms[worst] <= max(BAD_VIEW * np.median(rms), BAD_VIEW_PX):
            break
        kept.pop(worst)
        poses = np.delete(poses, worst, axis=0)
        _enough(kept, without or [])
    near = [np.linalg.norm(m, axis=1) <= WILD * np.median(np.linalg.norm(np.concatenate(miss), axis=1)) for m in miss]
    wild = sum(int(np.count_nonzero(~good)) for good in near)
    kept = [View(v.name, v.pixels[good], v.points[good]) for v, good in zip(kept, near, strict=True)]
    lens, poses, jacobian, miss = _fit(kept, lens, poses, 4)
    for terms in (1, 2, 3):
        simpler = _fit(kept, np.where(np.arange(8) < 4 + terms, lens, 0.0), poses, terms)
        if _rms(simpler[3]) <= SIMPLER * _rms(miss):
            lens, poses, jacobian, miss = simpler
            break
    rms = np.array([_rms([m]) for m in miss])
    names = {view.name for view in kept}
    pixels, errors = np.concatenate([v.pixels for v in kept]), np.concatenate(miss)
    total = _rms(miss)
    # each corner has two errors, so that one has half the variance of the distance
    scale = np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale)) * total**2 / 2
    deviation = np.sqrt(np.diag(covariance)) / scale
    sigma = {str(name): float(deviation[n]) for n, name in enumerate(NAMES[: jacobian.shape[1] - 6 * len(kept)])}
    reach = max(float(_off_axis(_seen(poses[n : n + 1], np.zeros(len(v.points), int), v.points)).max()) for n, v in enumerate(kept))
    rejected = {view.name: _view_rms(view, lens, reach) for view in views if view.name not in names}
    found = Lens(
        size=size,
        f=(float(lens[0]), float(lens[1])),
        c=(float(lens[2]), float(lens[3])),
        k1=float(lens[4]),
        k2=float(lens[5]),
        k3=float(lens[6]),
        k4=float(lens[7]),
        rim_deg=math.degrees(reach),
        views=len(kept),
        rms_px=total,
        date=datetime.date.today().isoformat(),
    )
    check_lens(found)
    by_view = {view.name: float(r) for view, r in zip(kept, rms, strict=True)}
    return LensReport(found, total, by_view, rejected, without or [], wild, sigma, found.rim_deg, np.hstack([pixels, errors]))


def _rms(errors: list[np.ndarray]) -> float:
    return math.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1)))


def _enough(views: list[View], without: list[str]) -> None:
    if len(views) < FEWEST:
        hint = f"; none was found in {', '.join(without[:3])}{' ..' if len(without) > 3 else ''}: check --board" if without else ""
        raise UserError(f"only {len(views)} usable views of the board and {FEWEST} are needed{hint}; take more, sharp, from all sides")


def _start(views: list[View], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    # the focal length, of an equidistant lens in the image's middle, whose rays see the boards flattest
    centre = (np.array(size) - 1) / 2
    best = (math.inf, np.empty(0), np.empty(0))
    for half_view in np.radians(np.arange(30.0, 130.0, 5.0)):
        f = max(size) / 2 / half_view
        miss, poses = [], []
        for view in views:
            rays = _equidistant_rays(view.pixels, f, centre)
            pose, off = _pose(rays, view.points)
            poses.append(pose)
            miss.append(off * f)
        score = float(np.mean(np.minimum(np.concatenate(miss), 30.0)))  # px; a view that fails altogether counts no more than this
        if score < best[0]:
            best = score, np.array([f, f, *centre, 0, 0, 0, 0]), np.array(poses)
    return best[1], best[2]


def _equidistant_rays(pixels: np.ndarray, f: float, centre: np.ndarray) -> np.ndarray:
    away = (pixels - centre) / f
    theta = np.minimum(np.linalg.norm(away, axis=1), math.pi)
    return np.column_stack([away * np.sinc(theta / math.pi)[:, None], np.cos(theta)])


def _pose(rays: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector and position (6,) of a board whose `points` (n, 2) lie on `rays` (n, 3), and the angles missed (n,) in rad.

    ray x (H (X, Y, 1)) = 0 is linear in H = (r1 r2 t) and takes rays in any direction.
    """
    scale = np.abs(points).max()
    plane = np.column_stack([points / scale, np.ones(len(points))])
    rows = np.einsum("abc,nb,nd->nacd", LEVI_CIVITA, rays, plane).reshape(-1, 9)
    h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    if np.sum(rays * (plane @ h.T)) < 0:  # the board lies before the rays, not behind them
        h = -h
    unit = math.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1])) or 1.0
    u, _, vt = np.linalg.svd(np.column_stack([h[:, :2] / unit, np.cross(h[:, 0], h[:, 1]) / unit**2]))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    position = h[:, 2] / unit * scale
    seen = np.column_stack([points, np.zeros(len(points))]) @ rotation.T + position
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    off = 2 * np.arcsin(np.clip(np.linalg.norm(seen - rays, axis=1) / 2, 0, 1))
    return np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), position]), off


LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI_CIVITA[_i, _j, _k], LEVI_CIVITA[_j, _i, _k] = 1.0, -1.0


def _seen(poses: np.ndarray, which: np.ndarray, points: np.ndarray) -> np.ndarray:
    # board points (n, 2) in camera axes (n, 3); the board of point i has the pose poses[which[i]]
    axes = Rotation.from_rotvec(poses[:, :3]).as_matrix()[which]
    return axes[..., 0] * points[:, :1] + axes[..., 1] * points[:, 1:] + poses[which, 3:]


def _off_axis(seen: np.ndarray) -> np.ndarray:
    return np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2])


def _project(seen: np.ndarray, lens: np.ndarray) -> np.ndarray:
    # pixels (n, 2) of points in camera axes under lens = (fx, fy, cx, cy, k1..k4); the plain polynomial, smooth for the fit
    theta, across = _off_axis(seen), np.hypot(seen[:, 0], seen[:, 1])
    s = theta**2
    radius = theta * (1 + s * (lens[4] + s * (lens[5] + s * (lens[6] + s * lens[7]))))
    return lens[2:4] + lens[:2] * seen[:, :2] * (radius / np.maximum(across, 1e-300))[:, None]


def _fit(
    views: list[View], lens: np.ndarray, poses: np.ndarray, terms: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    # all views and the lens together, with the first `terms` of k1..k4 and 0 for the others; returns the lens, the poses,
    # the Jacobian without robust weights, and each view's errors (n, 2)
    counts = [len(view.pixels) for view in views]
    which = np.repeat(np.arange(len(views)), counts)
    pixels, points = np.concatenate([v.pixels for v in views]), np.concatenate([v.points for v in views])
    reach = float(_off_axis(_seen(poses, which, points)).max())
    weight = np.array([reach ** (2 * n) / PRIOR for n in range(1, terms + 1)])
    own = 4 + terms

    def split(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate([parameters[:own], np.zeros(4 - terms)]), parameters[own:].reshape(-1, 6)

    def errors(parameters: np.ndarray) -> np.ndarray:
        lens, poses = split(parameters)
        off = _project(_seen(poses, which, points), lens) - pixels
        return np.concatenate([off.ravel(), parameters[4:own] * weight])

    def jacobian(parameters: np.ndarray) -> np.ndarray:
        # the lens moves all corners, a pose only its own: own + 6 evaluations give all columns
        base = errors(parameters)
        full = np.zeros((len(base), len(parameters)))
        for n in range(own):
            step = 1e-6 * max(1.0, abs(parameters[n]))
            moved = parameters.copy()
            moved[n] += step
            full[:, n] = (errors(moved) - base) / step
        row = np.arange(2 * len(pixels))
        for n in range(6):
            moved = parameters.copy()
            steps = np.full(len(views), 1e-7) * (1 if n < 3 else np.linalg.norm(split(parameters)[1][:, 3:], axis=1))
            moved[own + n :: 6] += steps
            full[row, own + 6 * np.repeat(which, 2) + n] = (errors(moved) - base)[row] / np.repeat(steps[which], 2)
        return full

    parameters = np.concatenate([lens[:own], poses.ravel()])
    # far off at first: a wide loss finds the valley, the narrow one its bottom
    for loss_px in (10.0, LOSS_PX):
        parameters = descend(errors, jacobian, parameters, loss_px)
    off = errors(parameters)[: 2 * len(pixels)].reshape(-1, 2)
    return *split(parameters), jacobian(parameters), np.split(off, np.cumsum(counts)[:-1])


def descend(errors: Vector, jacobian: Vector, start: np.ndarray, loss: float) -> np.ndarray:
    """Parameters that minimise sum 2 loss^2 (sqrt(1 + (error / loss)^2) - 1): Levenberg's and Marquardt's steps on reweighted errors."""

    def cost(off: np.ndarray) -> float:
        return float(np.sum(np.sqrt(1 + (off / loss) ** 2) - 1))

    here, off, damping = start, errors(start), 1e-3
    for _ in range(100):
        slope = jacobian(here)
        weighted = slope / np.sqrt(1 + (off / loss) ** 2)[:, None]
        normal, gradient = weighted.T @ slope, weighted.T @ off
        before = cost(off)
        while damping < 1e12:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-300), -gradient)
            moved = errors(here + step)
            if cost(moved) < before:
                break
            damping *= 10
        else:
            return here
        here, off, damping = here + step, moved, max(damping / 10, 1e-12)
        if before - cost(off) <= 1e-9 * before:
            break
    return here


def _view_rms(view: View, lens: np.ndarray, rim: float) -> float:
    # a view's RMS with its own best pose under a lens that is given
    away = (view.pixels - lens[2:4]) / lens[:2]
    radius = np.linalg.norm(away, axis=1)
    theta = np.array([min(angle_from_radius(r, lens[4:8].copy(), rim), math.pi) for r in radius])
    rays = np.column_stack([away / np.maximum(radius, 1e-300)[:, None] * np.sin(theta)[:, None], np.cos(theta)])
    pose, _ = _pose(rays, view.points)
    which = np.zeros(len(radius), int)
    found = least_squares(lambda p: (_project(_seen(p[None], which, view.points), lens) - view.pixels).ravel(), pose, x_scale="jac")
    return math.sqrt(2 * np.mean(found.fun**2))


def _rim_deg(lens: Lens, brightest: np.ndarray) -> float:
    # where the image circle ends, in degrees: the first ring of which less than half is brighter than a third of the middle's
    # median; without such an edge, the farthest corner of the image
    height, width = brightest.shape
    x, y = np.meshgrid((np.arange(width) - lens.c[0]) / lens.f[0], (np.arange(height) - lens.c[1]) / lens.f[1])
    radius = np.hypot(x, y) * lens.f[0]
    ring = radius.astype(int)
    lit = brightest > np.median(brightest[radius < min(height, width) / 4]) / 3
    share = np.bincount(ring.ravel(), lit.ravel()) / np.maximum(np.bincount(ring.ravel()), 1)
    # a ring must lie in the image for the better part to be judged: at least as many pixels as a quarter circle has
    judged = np.flatnonzero(np.bincount(ring.ravel()) > 0.5 * math.pi * np.arange(len(share)))
    dark = judged[(share[judged] < 0.5) & (judged > min(height, width) / 4)]
    edge = float(dark[0]) if len(dark) else float(radius.max())
    return math.degrees(min(angle_from_radius(edge / lens.f[0], lens.k, lens.rim), math.pi))


def _with_rim(lens: Lens, rim_deg: float, asked: bool) -> Lens:
    # the lens up to `rim_deg`, or to where its polynomial would turn back unless that rim was asked for
    for degrees in [rim_deg] if asked else np.arange(rim_deg, lens.rim_deg, -0.5):
        wider = msgspec.structs.replace(lens, rim_deg=min(float(degrees), 180.0))
        try:
            check_lens(wider)
            return wider
        except UserError:
            if asked:
                raise
    return lens


def coverage_picture(report: LensReport, brightest: np.ndarray) -> np.ndarray:
    """Image (height, width, 3) uint8, BGR: the corners with their errors drawn 50 times, over circles each 30 degrees and the rim."""
    image = cv2.cvtColor((brightest * 0.5).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    lens = report.lens
    for degrees in (*range(30, int(lens.rim_deg), 30), lens.rim_deg):
        radius = radius_from_angle(math.radians(degrees), lens.k, lens.rim)
        axes = (round(lens.f[0] * radius), round(lens.f[1] * radius))
        middle = (round(lens.c[0]), round(lens.c[1]))
        cv2.ellipse(image, middle, axes, 0, 0, 360, (200, 160, 60), 1, cv2.LINE_AA)
        cv2.putText(image, f"{degrees:.0f}", (middle[0] + 3, middle[1] - axes[1] + 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (200, 160, 60), 1)
    for x, y, dx, dy in report.residuals:
        start, end = (round(x), round(y)), (round(x + 50 * dx), round(y + 50 * dy))
        cv2.line(image, start, end, (60, 200, 255), 1, cv2.LINE_AA)
        cv2.circle(image, start, 2, (80, 255, 80), -1, cv2.LINE_AA)
    text = f"{lens.views} views, {report.rms_px:.2f} px RMS, corners out to {report.reach_deg:.0f} degrees; errors drawn 50 times"
    cv2.putText(image, text, (8, image.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return image
