"""Every way to make lights of maps, behind one interface: a start, and a step from frame to frame."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from bench.rivals.kollig_keller import kollig_keller
from bench.rivals.median_cut import median_cut, variance_minimisation
from bench.rivals.penrose import penrose
from bench.rivals.structured import structured
from services.lights import Lights
from services.sampler.step import initial_state, step
from services.settings import Sampler
from services.sphere import Coverage

Step = Callable[[Any, np.ndarray, float, np.ndarray], tuple[Any, Lights]]
Alone = Callable[[np.ndarray, Coverage, int], Lights]


class Method(NamedTuple):
    """name: in charts. start: the state for a number of lights. step: (state, map, time_s, centroids) to the next state and its lights.

    most: lights beyond which a frame takes seconds. steady: carries its lights from frame to frame under ids that mean something.
    """

    name: str
    start: Callable[[int], Any]
    step: Step
    most: int = 1024
    steady: bool = False


def ours(name: str, **settings: Any) -> Method:
    """A method of the product, by its settings."""

    def start(count: int) -> Any:
        made = Sampler(count=count, **settings)
        return made, initial_state(made)

    def steps(state: Any, radiance: np.ndarray, time_s: float, centroids: np.ndarray) -> tuple[Any, Lights]:
        after, lights, _ = step(state[0], state[1], radiance, "hemisphere", time_s, None, centroids)
        return (state[0], after), lights

    return Method(name, start, steps, steady=True)


def anew(name: str, method: Alone, most: int = 1024) -> Method:
    """A method that sees each frame by itself. It knows no centroids inside cells: none of the published ones does."""
    return Method(name, lambda count: count, lambda count, radiance, _time, _inside: (count, method(radiance, "hemisphere", count)), most)


def _mitsuba() -> list[Method]:
    if not find_spec("mitsuba"):
        return []
    from bench.rivals.mitsuba_envmap import mitsuba_envmap

    return [anew("Mitsuba 3 envmap", mitsuba_envmap)]


TRACKED = "tracked (default)"
STILL = [
    ours(TRACKED, method="tracked", filter="none"),
    ours("Havran, azimuth first", method="havran-azimuth", filter="none"),
    ours("Havran, radius first", method="havran-radius", filter="none"),
    ours("Havran, azimuth first, raw Halton", method="havran-azimuth", points="halton", filter="none"),
    ours("standard inversion, raw Halton", method="standard", points="halton", filter="none"),
    anew("median cut", median_cut),
    anew("variance minimisation", variance_minimisation),
    anew("Kollig and Keller", kollig_keller, most=256),
    anew("structured", structured),
    anew("Penrose tiling", penrose),
    *_mitsuba(),
]
MOVING = [
    ours(TRACKED, method="tracked", deflicker=True),
    ours("tracked, nothing smoothed", method="tracked", filter="none"),
    ours("Havran 2005: azimuth first, FIR", method="havran-azimuth"),
    ours("Havran, azimuth first", method="havran-azimuth", filter="none"),
    ours("Havran, radius first, FIR", method="havran-radius"),
    ours("standard inversion, FIR", method="standard"),
    anew("median cut", median_cut),
    anew("variance minimisation", variance_minimisation),
    anew("structured", structured),
    anew("Penrose tiling", penrose),
    *_mitsuba(),
]
