"""All methods that make lights of maps, behind one interface: a start, and a step from frame to frame."""

import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from bench.evaluation import Source
from bench.rivals.kollig_keller import kollig_keller
from bench.rivals.median_cut import median_cut, variance_minimisation
from bench.rivals.penrose import penrose
from bench.rivals.q2tree import q2tree
from bench.rivals.structured import structured
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler

SETTLED = 8  # frames of a still map before it is evaluated and timed

Step = Callable[[Any, SamplerInput], tuple[Any, LightSet]]
Alone = Callable[[np.ndarray, Coverage, int], LightSet]


class Method(NamedTuple):
    """name: in charts. start: the state for a number of lights. step: from state and frame to the next state and the lights.

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
        return made, initial_state()

    def steps(state: Any, frame: SamplerInput) -> tuple[Any, LightSet]:
        after, lights, _ = step(state[0], state[1], frame)
        return (state[0], after), lights

    return Method(name, start, steps, steady=True)


def anew(name: str, method: Alone, most: int = 1024, steady: bool = False) -> Method:
    """A method that sees each frame by itself. It uses no sub-cell samples: none of the published ones does."""

    def steps(count: int, frame: SamplerInput) -> tuple[int, LightSet]:
        return count, method(frame.radiance, frame.coverage, count)

    return Method(name, lambda count: count, steps, most, steady)


def settled(method: Method, count: int, source: Source) -> tuple[LightSet, float]:
    """The lights of a map that stands still, once they have settled, and the median time of a frame in ms."""
    state, taken, lights = method.start(count), [], LightSet.none()
    for k in range(SETTLED if method.steady else 2):
        begin = time.thread_time()
        state, lights = method.step(state, SamplerInput(source.polar, "hemisphere", k / 25, source.bright_cells))
        taken.append(1e3 * (time.thread_time() - begin))
    return lights, float(np.median(taken[1:]))


def _mitsuba() -> list[Method]:
    if not find_spec("mitsuba"):
        return []
    from bench.rivals.mitsuba_envmap import mitsuba_envmap

    return [anew("Mitsuba 3 envmap", mitsuba_envmap)]


POINTS, SOFT = "tracked, points", "tracked, soft lights (default)"
STILL = [
    ours(SOFT, method="tracked", filter="none"),
    ours(POINTS, method="tracked", filter="none", soft=False),
    ours("Havran, azimuth first", method="havran-azimuth", filter="none"),
    ours("Havran, radius first", method="havran-radius", filter="none"),
    ours("Havran, azimuth first, relaxed", method="havran-azimuth", points="relaxed", filter="none"),
    ours("Havran, radius first, relaxed", method="havran-radius", points="relaxed", filter="none"),
    ours("Havran, azimuth first, raw Halton", method="havran-azimuth", points="halton", filter="none"),
    ours("Havran, radius first, raw Halton", method="havran-radius", points="halton", filter="none"),
    ours("standard inversion, raw Halton", method="standard", points="halton", filter="none"),
    anew("median cut", median_cut),
    anew("variance minimisation", variance_minimisation),
    anew("Kollig and Keller", kollig_keller, most=256),
    anew("structured", structured),
    anew("Q2-tree", q2tree, steady=True),
    anew("Penrose tiling", penrose, steady=True),
    *_mitsuba(),
]
MOVING = [
    ours(SOFT, method="tracked"),
    ours(POINTS, method="tracked", soft=False),
    ours("tracked, points, nothing smoothed", method="tracked", filter="none", soft=False),
    ours("Havran 2005: azimuth first, FIR", method="havran-azimuth", points="relaxed", deflicker=False),
    ours("Havran, azimuth first", method="havran-azimuth", filter="none", deflicker=False),
    ours("Havran, radius first, FIR", method="havran-radius", deflicker=False),
    ours("Havran, radius first", method="havran-radius", filter="none", deflicker=False),
    ours("standard inversion, FIR", method="standard", deflicker=False),
    anew("median cut", median_cut),
    anew("variance minimisation", variance_minimisation),
    anew("Kollig and Keller", kollig_keller),
    anew("structured", structured),
    anew("Q2-tree", q2tree, steady=True),
    anew("Penrose tiling", penrose, steady=True),
    *_mitsuba(),
]
