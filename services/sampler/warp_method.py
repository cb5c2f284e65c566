"""The methods of Havran et al. 2005 and the standard inversion: a warp of the unit square onto the sky, filtered over time, clustered."""

import numpy as np

from vemlight.kernels import kernel
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.cluster import NO_CLUSTERS, clustered
from vemlight.sampler.error_limit import TILE_LIGHTS, estimate_of, ladder, smallest_within
from vemlight.sampler.hard_probes import hard_probes, prefix_errors
from vemlight.sampler.light_count import count_after, fade_weights_after
from vemlight.sampler.light_map import LightMap, light_map
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import SamplerReport, SamplerState
from vemlight.sampler.temporal.filter import FilterFrame, filtered
from vemlight.sampler.temporal.flicker import block_powers, flicker_after, without_flicker
from vemlight.sampler.tracking.tiles import Tiles, tiles_from_map
from vemlight.sampler.warps.points import points
from vemlight.sampler.warps.warp import WARPS, Anchor, steadied, warp_from_map
from vemlight.settings import Sampler

OFFSET_TIME_S = 0.12  # the warp's offset follows the light with this time constant: three frames at 25 fps, against pixel noise
LOWEST_Z: dict[Coverage, float] = {"hemisphere": 0.0, "sphere": -1.0}  # of the directions that a filter may give


def warp_method(settings: Sampler, state: SamplerState, frame: SamplerInput) -> tuple[SamplerState, LightSet, SamplerReport]:
    """The step of all methods in WARPS."""
    coverage, time_s = frame.coverage, frame.time_s
    seen = light = light_map(frame.radiance, coverage)
    flicker = flicker_after(state.flicker, time_s, block_powers(seen, settings.deflicker))
    if settings.deflicker and flicker.depth > 0:
        light = light_map(without_flicker(seen, flicker), coverage)

    # Lights of this frame, then over time.
    drawn, anchor = _drawn(settings, state, light, time_s)
    result = filtered(settings, state.filter, FilterFrame(time_s, light.irradiance, drawn), LOWEST_Z[coverage])
    tiles = tiles_from_map(light.radiance, coverage, TILE_LIGHTS, frame.bright_cells) if settings.error_limit else None
    state, count = _counted(settings, state, light, tiles, drawn, time_s)
    lights = _weighted(state.fade_weights, result.frame)
    clusters = NO_CLUSTERS
    if settings.clusters:
        max_clusters = min(settings.clusters, state.light_budget or settings.clusters)
        clusters, lights = clustered(lights, max_clusters, coverage, state.clusters)
    state = state._replace(time_s=time_s, anchor=anchor, filter=result.memory, flicker=flicker, clusters=clusters)
    report = SamplerReport(
        delay_frames=result.delay_s / result.period_s if result.period_s else 0.0,
        delay_s=result.delay_s,
        invalid_cells=seen.invalid_cells,
        irradiance=seen.irradiance,
        count=count,
        required_lights=state.light_count.count if state.light_count else 0,
        light_budget=state.light_budget,
        error=estimate_of(tiles, lights, coverage).error if tiles else 0.0,
        flicker_hz=flicker.beat_hz,
        lamp_hz=flicker.lamp_hz,
        flicker_depth=flicker.depth,
        gloss=_weighted(np.ones(settings.gloss_lights), result.frame) if settings.gloss_lights else None,
    )
    return state, lights, report


def _drawn(settings: Sampler, state: SamplerState, light: LightMap, time_s: float) -> tuple[np.ndarray, Anchor | None]:
    """This frame's lights before filtering, (n, 6) direction and tint, and the anchor of the warp's offset."""
    assert settings.method != "tracked"
    passed_s = np.inf if state.time_s is None else max(time_s - state.time_s, 0.0)
    warp, anchor = steadied(warp_from_map(light, settings.method), state.anchor, 1 - float(np.exp(-passed_s / OFFSET_TIME_S)))
    if light.power <= 0:
        anchor = state.anchor  # a black frame says nothing about where the light is
    # All lights that may be asked for, present or not, so that each has its history in the filter when it comes.
    kind = WARPS[settings.method].points if settings.points == "auto" else settings.points
    samples = warp.sample(points(max(settings.max_count, settings.gloss_lights, len(state.fade_weights)), kind))
    # Tint: what a light carries relative to the average light, in each channel: (radiance / density) / integral.
    drawn = np.empty((len(samples.density), 6))
    _fill_drawn(*samples, np.where(light.irradiance > 0, light.irradiance, 1.0), drawn)
    return drawn, anchor


@kernel
def _fill_drawn(directions, radiance, density, irradiance, drawn):
    for n in range(density.size):
        for c in range(3):
            drawn[n, c] = directions[n, c]
            drawn[n, 3 + c] = radiance[n, c] / (density[n] * irradiance[c])


def _counted(
    settings: Sampler, state: SamplerState, light: LightMap, tiles: Tiles | None, drawn: np.ndarray, time_s: float
) -> tuple[SamplerState, int]:
    """The state with the number of lights updated, and the number wanted. tiles: of the map, where there is an error limit."""
    count, light_count = settings.max_count, None
    if tiles:
        light_count = count_after(state.light_count, _required(settings, light, tiles, drawn), time_s)
        count = min(count, light_count.count)
    if state.light_budget and not settings.clusters:
        count = min(count, state.light_budget)
    passed_s = None if state.time_s is None else time_s - state.time_s
    return state._replace(fade_weights=fade_weights_after(state.fade_weights, count, passed_s), light_count=light_count), count


def _required(settings: Sampler, light: LightMap, tiles: Tiles, drawn: np.ndarray) -> int:
    """How many of this frame's lights before filtering keep within the error limit, at most `count`; 1 in the dark."""
    if light.power <= 0:
        return 1
    power, sizes = (drawn[: settings.max_count, 3:] * light.irradiance) @ LUMINANCE_WEIGHTS, ladder(settings.max_count)
    errors = prefix_errors(hard_probes(light.coverage), tiles, drawn[: settings.max_count, :3], power, sizes)
    error_of = dict(zip(sizes.tolist(), errors.tolist(), strict=True))
    return smallest_within(settings.error_limit, settings.max_count, error_of.__getitem__)


def _weighted(weights: np.ndarray, frame: FilterFrame) -> LightSet:
    """The first lights of a frame with the given weights (n,)."""
    n = len(weights)
    return LightSet.of(np.arange(n), frame.lights[:n, :3], irradiance_from_tint(weights, frame.lights[:n, 3:], frame.power))


def irradiance_from_tint(weights: np.ndarray, tint: np.ndarray, power: np.ndarray) -> np.ndarray:
    """The lights' irradiance (n, 3): `power` (3,) divided in proportion to weights (n,) times tint (n, 3), exact in every channel's total.

    A channel in which no light has a tint but which has power is divided by the weights alone.
    """
    total = weights @ tint
    if not total.all():
        tint = np.where(total > 0, tint, 1.0)
        total = weights @ tint
    return weights[:, None] * tint * (power / total)
