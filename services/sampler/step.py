"""The sampler's step: one polar map in, the lights of that moment out. A pure function; an old state stays valid."""

from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler import cluster, control
from vemlight.sampler.density import LightMap, light_map
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.temporal import filter, flicker
from vemlight.sampler.tracking.tracked import TRIALS, initial_tracked, needed, tracked_step
from vemlight.sampler.tracking.tracked import State as Tracked
from vemlight.sampler.warps.points import Kind, points
from vemlight.sampler.warps.warp import Anchor, steadied, warp_from_map
from vemlight.settings import Sampler

OFFSET_TIME_S = 0.12  # the warp's offset follows the light with this time constant: three frames at 25 fps, against pixel noise
SLACK = 1.1  # tracked lights' need is an estimate that noise moves by so much; AIM leaves four times as much room below the promise
LOWEST: dict[Coverage, float] = {"hemisphere": 0.0, "sphere": -1.0}  # z of the directions that a filter may give


class State(NamedTuple):
    """What the sampler remembers between frames.

    time_s: of the last frame, None before the first. anchor: what steadies the warp's offset. presence: (n,), how far each light has come.
    need: lights that the scene needs. can: lights that the renderer can draw, 0 where that is no limit.
    tracked, tracked_gloss: of the method "tracked".
    """

    coverage: Coverage
    time_s: float | None
    anchor: Anchor | None
    filter: filter.Memory
    flicker: flicker.Flicker
    presence: np.ndarray
    need: control.Need | None
    can: int
    clusters: cluster.Clusters
    tracked: Tracked
    tracked_gloss: Tracked


class Report(NamedTuple):
    """What is published beside the lights.

    delay_frames, delay_s: how far the filter lags behind the capture. spoilt: pixels in which a nan, infinite or negative value was
    set to 0. irradiance: (3,) float64, the map's integral over solid angle. count: lights wanted before clustering; need, can: what the
    scene needs and the renderer can draw, 0 where not asked. flicker_hz: beat of lamps with the frame rate, lamp_hz: their own frequency,
    flicker_depth: amplitude over mean; all 0 when there is none. gloss: the gloss set, many lights for glossy surfaces, whose
    beginning, with more power, is the first set before clustering; None when not asked for.
    """

    delay_frames: float
    delay_s: float
    spoilt: int
    irradiance: np.ndarray
    count: int
    need: int
    can: int
    flicker_hz: float
    lamp_hz: float
    flicker_depth: float
    gloss: LightSet | None


def initial_state(settings: Sampler) -> State:
    """The state before the first frame."""
    tracked = initial_tracked()
    return State("hemisphere", None, None, filter.EMPTY, flicker.NONE, np.zeros(0), None, 0, cluster.NONE, tracked, tracked)


def step(settings: Sampler, state: State, frame: SamplerInput) -> tuple[State, LightSet, Report]:
    """The lights of a frame.

    The irradiance of the lights sums to the map's integral in every channel; with a filter (or with flicker taken out) to the filtered
    integral. Settings may change from call to call.
    """
    radiance, coverage, time_s = frame.radiance, frame.coverage, frame.time_s
    if coverage != state.coverage:
        state = initial_state(settings)._replace(coverage=coverage)
    state = state._replace(can=control.affordable(state.can, frame.light_budget))
    if settings.method == "tracked":
        return _tracked(settings, state, frame)
    seen = light = light_map(radiance, coverage)
    beat = flicker.with_frame(state.flicker, time_s, flicker.block_powers(seen, settings.deflicker))
    if settings.deflicker and beat.depth > 0:
        light = light_map(flicker.without_flicker(seen, beat), coverage)
    drawn, anchor = _drawn(settings, state, light, time_s)
    smooth = filter.filtered(settings, state.filter, filter.Frame(time_s, light.irradiance, drawn), LOWEST[coverage])
    state, wanted = _counted(settings, state, light, drawn, time_s)
    lights = _lights(state.presence, smooth.frame)
    clusters = cluster.NONE
    if settings.clusters:
        most = min(settings.clusters, state.can or settings.clusters)
        clusters, lights = cluster.clustered(lights, most, coverage, state.clusters)
    report = Report(
        delay_frames=smooth.delay_s / smooth.period_s if smooth.period_s else 0.0,
        delay_s=smooth.delay_s,
        spoilt=seen.spoilt,
        irradiance=seen.irradiance,
        count=wanted,
        need=state.need.count if state.need else 0,
        can=state.can,
        flicker_hz=beat.beat_hz,
        lamp_hz=beat.lamp_hz,
        flicker_depth=beat.depth,
        gloss=_lights(np.ones(settings.gloss_lights), smooth.frame) if settings.gloss_lights else None,
    )
    return state._replace(time_s=time_s, anchor=anchor, filter=smooth.memory, flicker=beat, clusters=clusters), lights, report


def _tracked(settings: Sampler, state: State, frame: SamplerInput) -> tuple[State, LightSet, Report]:
    """The step of the method "tracked", whose lights need neither a filter with a delay nor clusters."""
    coverage, time_s, beat = frame.coverage, frame.time_s, state.flicker
    if settings.deflicker:
        seen = light_map(frame.radiance, coverage)
        beat = flicker.with_frame(beat, time_s, flicker.block_powers(seen, True))
        if beat.depth > 0:
            frame = frame._replace(radiance=flicker.without_flicker(seen, beat))
    smoothing = settings.filter != "none"
    wanted = min(settings.count, settings.clusters or settings.count, state.can or settings.count)
    most, need = wanted, state.need
    if settings.error_percent and need:
        wanted = min(wanted, need.count)
    now, lights, report = tracked_step(wanted, state.tracked, frame, smoothing)
    if settings.error_percent:
        light, first = light_map(frame.radiance, coverage), need is None
        for _ in range(TRIALS if first else 1):
            need = control.held(need, needed(light, lights, settings.error_percent / 100, most), time_s, SLACK)
            if first:
                wanted = need.count
                now, lights, report = tracked_step(wanted, state.tracked, frame, smoothing)
                need = None
        need = need or control.held(None, wanted, time_s)
    gloss_state, gloss = state.tracked_gloss, None
    if settings.gloss_lights:
        gloss_state, gloss, _ = tracked_step(settings.gloss_lights, gloss_state, frame, smoothing)
    if not settings.deflicker:
        beat = flicker.with_frame(beat, time_s, np.array([float(luminance_from_rgb(report.irradiance))]))
    made = Report(
        delay_frames=0.0,
        delay_s=0.0,
        spoilt=report.spoilt,
        irradiance=report.irradiance,
        count=wanted,
        need=need.count if need and settings.error_percent else 0,
        can=state.can,
        flicker_hz=beat.beat_hz,
        lamp_hz=beat.lamp_hz,
        flicker_depth=beat.depth,
        gloss=gloss,
    )
    return state._replace(time_s=time_s, flicker=beat, need=need, tracked=now, tracked_gloss=gloss_state), lights, made


def _drawn(settings: Sampler, state: State, light: LightMap, time_s: float) -> tuple[np.ndarray, Anchor | None]:
    """This frame's lights before filtering, (n, 6) direction and tint, and the anchor of the warp's offset."""
    assert settings.method != "tracked"
    passed_s = np.inf if state.time_s is None else max(time_s - state.time_s, 0.0)
    warp, anchor = steadied(warp_from_map(light, settings.method), state.anchor, 1 - float(np.exp(-passed_s / OFFSET_TIME_S)))
    if light.power <= 0:
        anchor = state.anchor  # a black frame says nothing about where the light is
    # All lights that may be asked for, present or not, so that each has its history in the filter when it comes.
    samples = warp.sample(points(max(settings.count, settings.gloss_lights, len(state.presence)), _kind(settings)))
    # Tint: what a light carries beside the average light, in each channel: (radiance / density) / integral.
    drawn = np.empty((len(samples.density), 6))
    _fill_drawn(*samples, np.where(light.irradiance > 0, light.irradiance, 1.0), drawn)
    return drawn, anchor


def _kind(settings: Sampler) -> Kind:
    if settings.points == "auto":
        return "relaxed" if settings.method == "standard" else "disc"
    return settings.points


@njit(cache=True)
def _fill_drawn(directions, radiance, density, irradiance, drawn):
    for n in range(density.size):
        for c in range(3):
            drawn[n, c] = directions[n, c]
            drawn[n, 3 + c] = radiance[n, c] / (density[n] * irradiance[c])


def _counted(settings: Sampler, state: State, light: LightMap, drawn: np.ndarray, time_s: float) -> tuple[State, int]:
    """The state with the number of lights brought up to date, and the number wanted."""
    wanted, need = settings.count, None
    if settings.error_percent:
        before = state.need.count if state.need else 0
        count = control.need(light, drawn[: settings.count, :3], drawn[: settings.count, 3:], settings.error_percent / 100, before)
        need = control.held(state.need, count, time_s)
        wanted = min(wanted, need.count)
    if state.can and not settings.clusters:
        wanted = min(wanted, state.can)
    passed_s = None if state.time_s is None else time_s - state.time_s
    return state._replace(presence=control.faded(state.presence, wanted, passed_s), need=need), wanted


def _lights(weights: np.ndarray, frame: filter.Frame) -> LightSet:
    """The first lights of a frame with the given weights (n,)."""
    n = len(weights)
    return LightSet.of(np.arange(n), frame.lights[:n, :3], irradiance(weights, frame.lights[:n, 3:], frame.power))


def irradiance(weights: np.ndarray, tint: np.ndarray, power: np.ndarray) -> np.ndarray:
    """The lights' irradiance (n, 3): shares of `power` (3,) as weights (n,) times tint (n, 3), the total exact in every channel.

    A channel in which no light has a tint but which has power is shared by the weights alone.
    """
    total = weights @ tint
    if not total.all():
        tint = np.where(total > 0, tint, 1.0)
        total = weights @ tint
    return weights[:, None] * tint * (power / total)
