"""Colour spaces of OpenColorIO by name, probed once into a curve and a matrix; the package is optional (`vemlight[ocio]`)."""

import difflib
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.files import one_line

CONFIG = "ocio://studio-config-latest"  # built into the library: ACES, with the curves and gamuts of camera makers
REC709_NAME = "Linear Rec.709 (sRGB)"
KNOTS = 4096  # of the curve over signals 0 to 1; between them it is straight, to 2e-4 on the steepest log
MAX_MISFIT = 2e-3  # of light, relative, by which curve and matrix may miss the library's own result: float32 leaves 2e-4


class ProbedSpace(NamedTuple):
    """light: (KNOTS,) float64, scene-linear of signals even from 0 to 1. rec709_from_light: (3, 3)."""

    light: np.ndarray
    rec709_from_light: np.ndarray


def probed_space(name: str) -> ProbedSpace:
    """The colour space `name` of the library's studio configuration.

    Raises UserError without the library, for a name that it does not know, and for a space that is more than a curve and a matrix.
    """
    try:
        import PyOpenColorIO
    except ImportError as error:
        raise UserError(f"ocio:{name}: OpenColorIO is not installed; pip install 'vemlight[ocio]'") from error
    ocio: Any = PyOpenColorIO
    config = ocio.Config.CreateFromFile(CONFIG)
    space = config.getColorSpace(name)
    if space is None:
        names = list(config.getColorSpaceNames())
        near = difflib.get_close_matches(name, names, 3, 0.4) or names[:3]
        raise UserError(f"ocio:{name[:60]}: OpenColorIO knows no such colour space; did you mean {', '.join(near)}?")
    if space.isData():
        raise UserError(f"ocio:{name}: holds data, not colours; choose a camera's or a display's colour space")
    try:
        processor = config.getProcessor(space.getName(), REC709_NAME).getDefaultCPUProcessor()
    except ocio.Exception as error:
        raise UserError(f"ocio:{name}: cannot be brought to Rec. 709 ({one_line(error)}); choose another space") from error
    return _curve_and_matrix(name, processor)


def _curve_and_matrix(name: str, processor: Any) -> ProbedSpace:
    """Grays give the curve, as the matrix leaves white white; colours then give the matrix, and others prove both."""

    def rec709(signals: np.ndarray) -> np.ndarray:
        pixels = np.ascontiguousarray(signals, np.float32)
        processor.applyRGB(pixels)
        return pixels.astype(np.float64)

    knots = np.linspace(0, 1, KNOTS)
    light = rec709(np.repeat(knots[:, None], 3, axis=1)) @ (0.2126, 0.7152, 0.0722)
    picked = np.random.default_rng(0).integers(KNOTS // 4, KNOTS, (64, 3))
    mixed, seen = light[picked], rec709(knots[picked])
    matrix = np.linalg.lstsq(mixed[:32], seen[:32], rcond=None)[0].T
    misfit = np.abs(mixed[32:] @ matrix.T - seen[32:]) / np.abs(seen[32:]).max(axis=1, keepdims=True)
    if not (np.isfinite(light).all() and np.all(misfit < MAX_MISFIT)):
        raise UserError(f"ocio:{name}: is more than a curve and a matrix; choose a camera's or a display's colour space")
    return ProbedSpace(light, matrix)
