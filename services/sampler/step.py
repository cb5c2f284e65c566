"""The sampler's step: one polar map in, the lights of that moment out. A pure function; an old state stays valid."""

from typing import NamedTuple

import numpy as np

from services.lights import Lights
from services.sampler import filter
from services.sampler.density import LightMap, light_map
from services.sampler.points import points
from services.sampler.warp import warp_from_map
from services.settings import Sampler
from services.sphere import Coverage

SEAM_TIME_S = 0.12  # the cut of the square follows the light with this time constant: three frames at 25 fps, against pixel noise


class State(NamedTuple):
    """What the sampler remembers between frames."""

    coverage: Coverage
    raw: filter.Frame | None  # the last frame's lights before filtering
    seam: float | None  # azimuth of the square's cut, rad
    memory: filter.Memory


class Report(NamedTuple):
    """What is published beside the lights.

    delay_frames, delay_s: how far the filter lags behind the capture. spoilt: pixels in which a nan, infinite or negative value was
    set to 0. irradiance: (3,) float64, the map's integral over solid angle.
    """

    delay_frames: float
    delay_s: float
    spoilt: int
    irradiance: np.ndarray


def initial_state(settings: Sampler) -> State:
    """The state before the first frame."""
    return State("hemisphere", None, None, filter.EMPTY)


def step(settings: Sampler, state: State, radiance: np.ndarray, coverage: Coverage, time_s: float) -> tuple[State, Lights, Report]:
    """The lights of a polar map captured at `time_s`.

    radiance: (rows, cols, 3) float32, may hold nan, infinite and negative values. The irradiance of the lights sums to the map's
    integral in every channel; with a filter the same holds for the filtered integral. Settings may change from call to call.
    """
    if state.raw is None or coverage != state.coverage:
        state = initial_state(settings)._replace(coverage=coverage)
    light = light_map(radiance, coverage)
    raw, seam = _raw(settings, state, light, time_s)
    memory, frame, delay_s = filter.filtered(filter.taps(settings.filter), state.memory, raw)
    weights = np.full(len(raw.lights), 1 / len(raw.lights))
    lights = Lights.of(np.arange(len(weights)), frame.lights[:, :3], irradiance(weights, frame.lights[:, 3:], frame.power))
    delay_frames = float(len(filter.taps(settings.filter)) // 2)
    return State(coverage, raw, seam, memory), lights, Report(delay_frames, delay_s, light.spoilt, light.irradiance)


def _raw(settings: Sampler, state: State, light: LightMap, time_s: float) -> tuple[filter.Frame, float | None]:
    """This frame's lights before filtering, and where the square's cut lies now. A black frame leaves the lights where they were."""
    n = settings.count
    if light.power == 0 and state.raw is not None and len(state.raw.lights) == n:
        return filter.Frame(time_s, light.irradiance, state.raw.lights), state.seam
    warp = warp_from_map(light, settings.method)
    seam = warp.seam
    if seam is not None and state.seam is not None and state.raw is not None:
        gain = 1 - np.exp(-max(time_s - state.raw.time_s, 0.0) / SEAM_TIME_S)
        seam = (state.seam + gain * ((seam - state.seam + np.pi) % (2 * np.pi) - np.pi)) % (2 * np.pi)
        warp = warp.with_seam(seam)
    samples = warp.sample(points(n))
    # Tint: what a light carries beside the average light, in each channel: (radiance / density) / integral.
    tint = samples.radiance / samples.density[:, None]
    tint /= np.where(light.irradiance > 0, light.irradiance, 1.0)
    return filter.Frame(time_s, light.irradiance, np.concatenate([samples.directions, tint], axis=1)), seam


def irradiance(weights: np.ndarray, tint: np.ndarray, power: np.ndarray) -> np.ndarray:
    """The lights' irradiance (n, 3): shares of `power` (3,) as weights (n,) times tint (n, 3), the total exact in every channel.

    A channel in which no light has a tint but which has power is shared by the weights alone.
    """
    parts = weights[:, None] * tint
    parts = np.where(parts.sum(axis=0) > 0, parts, weights[:, None])
    return parts * (power / parts.sum(axis=0))
