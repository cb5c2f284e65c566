"""Patches that contradict the others: found by fitting without each of them in turn."""

from collections.abc import Callable

import numpy as np

from vemlight.capture.calibration.patches import Patch
from vemlight.capture.response import Response

CODE_TOLERANCE = 2.0  # codes by which a patch may be off: noise of the patches' means; 1 to 5 do
# A patch is one that is so many times farther off than the worst of the others. Of six with Gaussian noise one in a hundred is, which then
# is missed little; 4 to 8 do
OUTLIER_RATIO = 5.0
MAX_OUTLIERS = 0.25  # of the patches; where more are wrong nobody can say which

Fit = Callable[[list[Patch]], Response]


def signal_errors(response: Response, patches: list[Patch]) -> np.ndarray:
    """By how many codes each patch is brighter than the response has it, (n,)."""
    luminance = np.array([patch.luminance for patch in patches]) / (response.luminance_scale or 1.0)
    with np.errstate(all="ignore"):
        return np.array([patch.code for patch in patches]) - response.signal(luminance)


def luminance_errors(response: Response, patches: list[Patch]) -> np.ndarray:
    """The relative error of the luminance that the response gives each patch's code, (n,)."""
    codes = np.array([patch.code for patch in patches])
    with np.errstate(all="ignore"):
        found = response.radiance(codes) * (response.luminance_scale or 1.0)
    return found / np.array([patch.luminance for patch in patches]) - 1


def without_outliers(patches: list[Patch], fit: Fit, unknowns: int) -> tuple[list[Patch], list[Patch]]:
    """The patches that agree, and those that contradict them. fit: the response of some of them, with so many `unknowns`.

    A patch is an outlier when without it all the others fit, and it is OUTLIER_RATIO times as far off as the worst of those. With fewer
    than two patches more than unknowns none can be told.
    """
    agreeing, outliers = list(patches), list[Patch]()
    while len(agreeing) >= unknowns + 2 and len(outliers) + 1 <= MAX_OUTLIERS * len(patches):
        worst, best = np.inf, -1
        for k in range(len(agreeing)):
            others = agreeing[:k] + agreeing[k + 1 :]
            error = float(np.abs(signal_errors(fit(others), others)).max())
            if error < worst:
                worst, best = error, k
        others = agreeing[:best] + agreeing[best + 1 :]
        off = float(np.abs(signal_errors(fit(others), agreeing[best : best + 1]))[0])
        if best < 0 or not off > OUTLIER_RATIO * max(worst, CODE_TOLERANCE):
            break
        outliers.append(agreeing[best])
        agreeing = others
    return agreeing, outliers


def bends_up(patches: list[Patch]) -> Patch | None:
    """A patch at which straight lines from patch to patch, in order of luminance, grow steeper by more than noise; None without one.

    A companding sensor's do not: each of its knees lowers the gain.
    """
    for darker, middle, brighter in zip(patches, patches[1:], patches[2:], strict=False):
        fraction = (middle.luminance - darker.luminance) / max(brighter.luminance - darker.luminance, 1e-300)
        straight = darker.code + fraction * (brighter.code - darker.code)
        if middle.code < straight - 2 * CODE_TOLERANCE:
            return middle
    return None
