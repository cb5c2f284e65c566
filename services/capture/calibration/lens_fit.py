"""The lens fitted to the corners of a board in several views.

Everything is fitted on rays, so that boards beyond 90 degrees off the axis count like all others. Candidate focal lengths give the first
estimate: each turns corners into rays of an equidistant lens, for which a board's pose is a linear problem. Then all poses and the lens
are fitted together to the corners' pixels, with a robust loss. Views that do not fit are left out, as are single outliers.
"""

import datetime
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from vemlight.capture.calibration.board_pose import angle_off_axis, points_from_pose, points_from_poses, pose_from_rays
from vemlight.capture.calibration.boards import BoardView
from vemlight.capture.lens import Lens, check_lens, direction_from_pixel
from vemlight.errors import UserError

MIN_VIEWS = 3  # two planes leave the focal length and the centre to each other
# Corners farther off than this count linearly: a wide loss to find the valley (1 to 40 do), then a narrow one (0.5 to 2 do).
FIRST_LOSS_PX, LOSS_PX = 10.0, 1.0
MAX_START_MISS_PX = 30.0  # of a corner in the first estimate's score, so that a view that fails altogether counts no more; 10 to 100 do
BAD_VIEW_MEDIANS = 2.5  # a view is left out when its RMS exceeds so many times the median of all views, ..
BAD_VIEW_PX = 0.5  # .. and this: in a very good set a view of twice the median is still a good one
# Expected size of each term k_n theta^(2n) at the outermost corner. Counts as one corner that is off by a pixel, and so matters only
# where corners determine nothing; any value from 0.1 to 1 does.
PRIOR_TERM = 0.3
OUTLIER_MEDIANS = 6.0  # corners farther off than so many medians are left out: of 10^5 Gaussian errors one is
# Fewer terms are preferred when they raise the RMS by no more than this factor, as needless terms diverge beyond the outermost corner.
# Errors of photographs repeat from view to view and let a needless term gain 1 %; one that an equisolid lens needs gains 1.5 to 2 %.
SIMPLER_FACTOR = 1.012
HALF_VIEWS_DEG = np.arange(30.0, 130.0, 5.0)  # of the candidate lenses; twice the step finds the same valley
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "p3")
# The same of decentring, by the share of the outermost corner's radius that it moves: p1 and p2, then p3. Lenses have 0.001 to 0.02.
PRIOR_DECENTRING = (0.05, 0.05, 1.0)


class LensReport(NamedTuple):
    """What a calibration found."""

    lens: Lens
    rms_px: float  # over the corners of the views used
    views: dict[str, float]  # RMS in px of each view used
    rejected: dict[str, float]  # RMS in px under the final lens of each view left out
    without_board: list[str]  # images in which no board was found
    outliers: int  # corners left out of the views used
    sigma: dict[str, float]  # standard deviation of each parameter that was fitted
    reach_deg: float  # angle off the axis of the outermost corner
    residuals: np.ndarray  # (n, 4): pixel x, y and the error's x, y


class JointFit(NamedTuple):
    """Lens and poses that fit the corners of all views together."""

    lens: np.ndarray  # (11,) float64, as PARAMETERS names them
    fitted: np.ndarray  # (11,) bool, which of them were fitted; the others are 0
    poses: np.ndarray  # (views, 6) float64
    jacobian: np.ndarray  # of the residuals by the fitted parameters, without the robust loss's weights
    errors: list[np.ndarray]  # of each view's corners in px, (n, 2)


def fit_lens(views: list[BoardView], size: tuple[int, int], without_board: list[str] | None = None) -> LensReport:
    """The lens from corners alone; its rim is where the outermost corner lies. Raises UserError for too few views."""
    inliers, fit = _without_bad_views(views, size, without_board or [])
    corners = sum(len(view.pixels) for view in inliers)
    inliers = _without_outliers(inliers, fit.errors)
    outliers = corners - sum(len(view.pixels) for view in inliers)
    fit = _simplest(inliers, _fit(inliers, fit.lens, fit.poses, Terms(4, 3)))
    reach = max(float(angle_off_axis(points_from_pose(fit.poses[n], view.points)).max()) for n, view in enumerate(inliers))
    fx, fy, cx, cy, k1, k2, k3, k4, p1, p2, p3 = map(float, fit.lens)
    lens = Lens(
        size=size,
        f=(fx, fy),
        c=(cx, cy),
        k1=k1,
        k2=k2,
        k3=k3,
        k4=k4,
        p1=p1,
        p2=p2,
        p3=p3,
        rim_deg=math.degrees(reach),
        views=len(inliers),
        rms_px=_rms(fit.errors),
        date=datetime.date.today().isoformat(),
    )
    check_lens(lens)
    used = {view.name: _rms([errors]) for view, errors in zip(inliers, fit.errors, strict=True)}
    rejected = {view.name: _view_rms(view, lens) for view in views if view.name not in used}
    residuals = np.hstack([np.concatenate([view.pixels for view in inliers]), np.concatenate(fit.errors)])
    return LensReport(lens, lens.rms_px, used, rejected, without_board or [], outliers, _deviations(fit), lens.rim_deg, residuals)


def _without_bad_views(views: list[BoardView], size: tuple[int, int], without_board: list[str]) -> tuple[list[BoardView], JointFit]:
    # leaves out the worst view until the others agree
    _check_enough(views, without_board)
    inliers = list(views)
    lens, poses = _first_estimate(inliers, size)
    while True:
        fit = _fit(inliers, lens, poses, Terms(4, 2))
        rms = np.array([_rms([errors]) for errors in fit.errors])
        worst = int(rms.argmax())
        if rms[worst] <= max(BAD_VIEW_MEDIANS * np.median(rms), BAD_VIEW_PX):
            return inliers, fit
        inliers.pop(worst)
        lens, poses = fit.lens, np.delete(fit.poses, worst, axis=0)
        _check_enough(inliers, without_board)


def _without_outliers(views: list[BoardView], errors: list[np.ndarray]) -> list[BoardView]:
    limit = OUTLIER_MEDIANS * np.median(np.linalg.norm(np.concatenate(errors), axis=1))
    near = [np.linalg.norm(e, axis=1) <= limit for e in errors]
    return [BoardView(v.name, v.pixels[good], v.points[good]) for v, good in zip(views, near, strict=True)]


def _simplest(views: list[BoardView], full: JointFit) -> JointFit:
    # the fit with the least decentring, then with the fewest of k1..k4, that is about as good as the one with more
    best = full
    for decentring in (0, 2):
        fit = _fit(views, full.lens, full.poses, Terms(4, decentring))
        if _rms(fit.errors) <= SIMPLER_FACTOR * _rms(full.errors):
            best = fit
            break
    decentring = int(best.fitted[8:].sum())
    for radial in (1, 2, 3):
        fit = _fit(views, best.lens, best.poses, Terms(radial, decentring))
        if _rms(fit.errors) <= SIMPLER_FACTOR * _rms(best.errors):
            return fit
    return best


def _deviations(fit: JointFit) -> dict[str, float]:
    # standard deviations of the lens's fitted parameters; each corner has two errors, so that one has half the variance of the distance
    scale = np.linalg.norm(fit.jacobian, axis=0)
    covariance = np.linalg.pinv((fit.jacobian / scale).T @ (fit.jacobian / scale)) * _rms(fit.errors) ** 2 / 2
    deviation = np.sqrt(np.diag(covariance)) / scale
    return {PARAMETERS[number]: float(deviation[n]) for n, number in enumerate(np.flatnonzero(fit.fitted))}


def _rms(errors: list[np.ndarray]) -> float:
    return math.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1)))


def _check_enough(views: list[BoardView], without_board: list[str]) -> None:
    if len(views) < MIN_VIEWS:
        names = f"{', '.join(without_board[:3])}{' ..' if len(without_board) > 3 else ''}"
        hint = f"; none was found in {names}: check --board" if without_board else ""
        raise UserError(
            f"only {len(views)} usable views of the board and {MIN_VIEWS} are needed{hint}; take more, sharp, from all sides"
        )


def _first_estimate(views: list[BoardView], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    # the focal length, of an equidistant lens in the image's middle, for whose rays the boards are flattest
    centre = (np.array(size) - 1) / 2
    best = (math.inf, np.empty(0), np.empty(0))
    for half_view in np.radians(HALF_VIEWS_DEG):
        f = max(size) / 2 / half_view
        poses, missed = zip(*(pose_from_rays(_equidistant_rays(view.pixels, f, centre), view.points) for view in views), strict=True)
        score = float(np.mean(np.minimum(np.concatenate(missed) * f, MAX_START_MISS_PX)))
        if score < best[0]:
            best = score, np.array([f, f, *centre, *np.zeros(7)]), np.array(poses)
    return best[1], best[2]


def _equidistant_rays(pixels: np.ndarray, f: float, centre: np.ndarray) -> np.ndarray:
    away = (pixels - centre) / f
    theta = np.minimum(np.linalg.norm(away, axis=1), math.pi)
    return np.column_stack([away * np.sinc(theta / math.pi)[:, None], np.cos(theta)])


def _project(seen: np.ndarray, lens: np.ndarray) -> np.ndarray:
    # pixels (n, 2) of points (n, 3) in camera axes; the plain polynomials without the rim, smooth for the fit
    theta, across = angle_off_axis(seen), np.hypot(seen[:, 0], seen[:, 1])
    s = theta**2
    radius = theta * (1 + s * (lens[4] + s * (lens[5] + s * (lens[6] + s * lens[7]))))
    points = seen[:, :2] * (radius / np.maximum(across, 1e-300))[:, None]
    p1, p2, p3 = lens[8:]
    if p1 or p2:
        u, v = points.T
        added = np.stack([2 * p1 * u * v + p2 * (3 * u * u + v * v), p1 * (u * u + 3 * v * v) + 2 * p2 * u * v], axis=-1)
        points = points + added * (1 + p3 * (u * u + v * v))[:, None]
    return lens[2:4] + lens[:2] * points


class Terms(NamedTuple):
    """How many of k1..k4 and of p1..p3 are fitted; the others are 0."""

    radial: int
    decentring: int

    @property
    def fitted(self) -> np.ndarray:
        """Which of PARAMETERS, (11,) bool."""
        number = np.arange(len(PARAMETERS))
        return (number < 4 + self.radial) | ((number >= 8) & (number < 8 + self.decentring))


class _JointProblem:
    """Residuals of all corners, and of the prior on k1..k4 and p1..p3, by the lens's parameters and all poses."""

    def __init__(self, views: list[BoardView], poses: np.ndarray, terms: Terms):
        self.views, self.fitted, self.lens_size = len(views), terms.fitted, int(terms.fitted.sum())
        self.which = np.repeat(np.arange(len(views)), [len(view.pixels) for view in views])
        self.pixels, self.points = np.concatenate([v.pixels for v in views]), np.concatenate([v.points for v in views])
        reach = float(angle_off_axis(points_from_poses(poses, self.which, self.points)).max())
        radial = [reach ** (2 * n) / PRIOR_TERM for n in range(1, 5)]
        decentring = [reach**power / prior for power, prior in zip((1, 1, 2), PRIOR_DECENTRING, strict=True)]
        self.prior_weight = np.array([*radial, *decentring])[self.fitted[4:]]

    def split(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lens (11,) and poses (views, 6)."""
        lens = np.zeros(len(PARAMETERS))
        lens[self.fitted] = parameters[: self.lens_size]
        return lens, parameters[self.lens_size :].reshape(-1, 6)

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """(2 corners + terms,): errors in px, then the prior's."""
        lens, poses = self.split(parameters)
        off = _project(points_from_poses(poses, self.which, self.points), lens) - self.pixels
        return np.concatenate([off.ravel(), parameters[4 : self.lens_size] * self.prior_weight])

    def jacobian(self, parameters: np.ndarray) -> np.ndarray:
        """By forward differences: the lens moves all corners, a pose only its own, so 6 evaluations give the columns of all poses."""
        base = self.residuals(parameters)
        full = np.zeros((len(base), len(parameters)))
        for n in range(self.lens_size):
            step = 1e-6 * max(1.0, abs(parameters[n]))
            moved = parameters.copy()
            moved[n] += step
            full[:, n] = (self.residuals(moved) - base) / step
        row, distances = np.arange(2 * len(self.pixels)), np.linalg.norm(self.split(parameters)[1][:, 3:], axis=1)
        for n in range(6):
            steps = np.full(self.views, 1e-7) * (1 if n < 3 else distances)
            moved = parameters.copy()
            moved[self.lens_size + n :: 6] += steps
            column = self.lens_size + 6 * np.repeat(self.which, 2) + n
            full[row, column] = (self.residuals(moved) - base)[row] / np.repeat(steps[self.which], 2)
        return full


def _fit(views: list[BoardView], lens: np.ndarray, poses: np.ndarray, terms: Terms) -> JointFit:
    # all views and the lens together
    problem = _JointProblem(views, poses, terms)
    parameters = np.concatenate([lens[problem.fitted], poses.ravel()])
    for loss_px in (FIRST_LOSS_PX, LOSS_PX):
        jacobian: Any = problem.jacobian  # scipy's types name only its own methods
        parameters = least_squares(problem.residuals, parameters, jac=jacobian, loss="soft_l1", f_scale=loss_px, x_scale="jac").x
    errors = problem.residuals(parameters)[: 2 * len(problem.pixels)].reshape(-1, 2)
    by_view = np.split(errors, np.cumsum([len(view.pixels) for view in views])[:-1])
    lens, poses = problem.split(parameters)
    return JointFit(lens, problem.fitted, poses, problem.jacobian(parameters), by_view)


def _view_rms(view: BoardView, lens: Lens) -> float:
    # RMS of a view with its own best pose under a given lens
    pose, _ = pose_from_rays(direction_from_pixel(view.pixels, lens), view.points)
    parameters = np.array([*lens.f, *lens.c, *lens.k, *lens.p])

    def residuals(pose: np.ndarray) -> np.ndarray:
        return (_project(points_from_pose(pose, view.points), parameters) - view.pixels).ravel()

    return math.sqrt(2 * np.mean(least_squares(residuals, pose, x_scale="jac").fun ** 2))
