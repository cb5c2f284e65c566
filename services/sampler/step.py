"""The sampler's step: one polar map in, the lights of that moment out. A pure function; an old state stays valid."""

from collections.abc import Callable

from vemlight.light.light_set import LightSet
from vemlight.light.virtual_lamp import with_lamps
from vemlight.sampler.light_count import budget_after
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import SamplerReport, SamplerState, state_after_jump
from vemlight.sampler.tracked_method import tracked_method
from vemlight.sampler.warp_method import warp_method
from vemlight.sampler.warps.warp import WARPS
from vemlight.settings import Sampler

Method = Callable[[Sampler, SamplerState, SamplerInput], tuple[SamplerState, LightSet, SamplerReport]]
METHODS: dict[str, Method] = {"tracked": tracked_method, **dict.fromkeys(WARPS, warp_method)}


def step(settings: Sampler, state: SamplerState, frame: SamplerInput) -> tuple[SamplerState, LightSet, SamplerReport]:
    """The lights of a frame.

    The irradiance of the lights sums to the map's integral in every channel; with a filter (or with flicker taken out) to the filtered
    integral. The settings' virtual lamps are added to them. Settings may change from call to call.
    """
    if frame.coverage != state.coverage:
        state = state_after_jump(state, frame.coverage)
    own = max(frame.light_budget - len(settings.lamp), 1) if frame.light_budget else 0
    state = state._replace(light_budget=budget_after(state.light_budget, own))
    state, lights, report = METHODS[settings.method](settings, state, frame)
    return state, with_lamps(lights, settings.lamp), report
