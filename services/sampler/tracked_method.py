"""The method "tracked": lights that follow the scene's light, which need neither a filter with a delay nor clusters."""

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.sampler.light_count import LightCount, count_after
from vemlight.sampler.light_map import light_map
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import SamplerReport, SamplerState
from vemlight.sampler.temporal.flicker import block_powers, flicker_after, without_flicker
from vemlight.sampler.tracking.tracked import COUNT_TRIALS, TrackedReport, TrackedState, required_tracked_lights, tracked_step
from vemlight.settings import Sampler

COUNT_SLACK = 1.1  # the requirement is an estimate that noise moves by so much; ERROR_AIM leaves four times as much room below the limit


def tracked_method(settings: Sampler, state: SamplerState, frame: SamplerInput) -> tuple[SamplerState, LightSet, SamplerReport]:
    """The step of the method "tracked"."""
    flicker = state.flicker
    if settings.deflicker:
        seen = light_map(frame.radiance, frame.coverage)
        flicker = flicker_after(flicker, frame.time_s, block_powers(seen, True))
        if flicker.depth > 0:
            frame = frame._replace(radiance=without_flicker(seen, flicker))
    smoothing = settings.filter != "none"
    max_count = min(settings.count, settings.clusters or settings.count, state.light_budget or settings.count)
    if settings.error_percent:
        tracked, lights, report, count, light_count = _within_error(settings, state, frame, max_count)
    else:
        tracked, lights, report = tracked_step(max_count, state.tracked, frame, smoothing, settings.soft)
        count, light_count = max_count, state.light_count
    tracked_gloss, gloss = state.tracked_gloss, None
    if settings.gloss_lights:
        tracked_gloss, gloss, _ = tracked_step(settings.gloss_lights, tracked_gloss, frame, smoothing)
    if not settings.deflicker:
        flicker = flicker_after(flicker, frame.time_s, np.array([float(luminance_from_rgb(report.irradiance))]))
    state = state._replace(
        time_s=frame.time_s, flicker=flicker, light_count=light_count, tracked=tracked, tracked_gloss=tracked_gloss
    )
    published = SamplerReport(
        delay_frames=0.0,
        delay_s=0.0,
        invalid_cells=report.invalid_cells,
        irradiance=report.irradiance,
        count=count,
        required_lights=light_count.count if light_count and settings.error_percent else 0,
        light_budget=state.light_budget,
        flicker_hz=flicker.beat_hz,
        lamp_hz=flicker.lamp_hz,
        flicker_depth=flicker.depth,
        gloss=gloss,
    )
    return state, lights, published


def _within_error(
    settings: Sampler, state: SamplerState, frame: SamplerInput, max_count: int
) -> tuple[TrackedState, LightSet, TrackedReport, int, LightCount]:
    """The tracked lights, with as few of them as keep within the error limit: how many there are, and the number for the next frame."""
    error, smoothing, light = settings.error_percent / 100, settings.filter != "none", light_map(frame.radiance, frame.coverage)
    if state.light_count is None:
        tracked, lights, report = tracked_step(max_count, state.tracked, frame, smoothing)
        count = max_count
        for _ in range(COUNT_TRIALS):
            count = required_tracked_lights(light, lights, error, max_count)
            tracked, lights, report = tracked_step(count, state.tracked, frame, smoothing)
        return tracked, lights, report, count, count_after(None, count, frame.time_s)
    count = min(max_count, state.light_count.count)
    tracked, lights, report = tracked_step(count, state.tracked, frame, smoothing)
    required = required_tracked_lights(light, lights, error, max_count)
    return tracked, lights, report, count, count_after(state.light_count, required, frame.time_s, COUNT_SLACK)
