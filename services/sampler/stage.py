"""The sampler as a stage of the pipeline: maps in, lights out, and the lights' file."""

from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from vemlight import settings
from vemlight.light.bright_cells import BrightCells
from vemlight.light.light_set import LightSet, LightsFile
from vemlight.runtime import wire
from vemlight.runtime.channels import Service
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.step import State, initial_state, step

WARM_FRAMES = 64  # the search for flicker begins with the second second of light


class SamplerState(NamedTuple):
    """The sampler's memory and the settings in force, which the viewer's wishes change."""

    settings: settings.Sampler
    memory: State
    light_budget: int  # lights that the renderer says it can draw in its time; 0: no limit


class SamplerStage:
    """See `vemlight.runtime.loop.Stage`."""

    service: Service = "sampler"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises UserError when the output folder cannot be written."""
        self._settings = settings.sampler
        self._file = LightsFile(Path(settings.out) / "lights.jsonl") if settings.out else None
        warm(settings.sampler)

    def first_missing_frame(self) -> int:
        return self._file.count if self._file else 0

    def start_at(self, target: int) -> tuple[SamplerState, int]:
        """From the first frame: the filters remember, and a replay of maps alone is quick."""
        return SamplerState(self._settings, initial_state(self._settings), 0), 0

    def side_inputs(self, state: SamplerState) -> tuple[Service, ...]:
        return ()

    def step(self, state: SamplerState, message: wire.Message) -> tuple[SamplerState, wire.Message]:
        header, arrays = message
        assert isinstance(header, wire.MapMessage)
        radiance, *bright = arrays
        frame = SamplerInput(radiance, header.coverage, header.stamp.time_s, BrightCells(*bright), state.light_budget)
        memory, lights, report = step(state.settings, state.memory, frame)
        gloss = report.gloss or LightSet.none()
        made = wire.LightsMessage(
            stamp=header.stamp,
            count=len(lights.ids),
            gloss_count=len(gloss.ids),
            coverage=header.coverage,
            report=wire.LightsReport(
                delay_ms=report.delay_s * 1e3,
                delay_frames=report.delay_frames,
                required_lights=report.need,
                light_budget=report.can,
                flicker_hz=report.flicker_hz,
                lamp_hz=report.lamp_hz,
                flicker_depth=report.flicker_depth,
            ),
        )
        return state._replace(memory=memory), (made, (*lights, gloss.directions, gloss.irradiance))

    def on_message(self, state: SamplerState, message: wire.Message) -> SamplerState:
        wish, _ = message
        if isinstance(wish, wire.StatusMessage):
            return state._replace(light_budget=wish.report.light_budget) if isinstance(wish.report, wire.ImageReport) else state
        assert isinstance(wish, wire.ControlMessage)
        own = self._settings
        unfiltered = wish.filtered is False
        asked = msgspec.structs.replace(own, count=wish.count or own.count, filter="none" if unfiltered else own.filter)
        return state._replace(settings=asked)

    def write(self, state: SamplerState, message: wire.Message) -> None:
        header, arrays = message
        if self._file and isinstance(header, wire.LightsMessage):
            self._file.append(LightSet(*arrays[:3]), header.stamp.sequence, header.stamp.time_s, header.coverage)

    def finish(self) -> None:
        pass


def warm(settings: settings.Sampler) -> None:
    """Has everything compiled that a frame may need, on a small map whose light flickers, so that no frame of a run waits for it."""
    state = initial_state(settings)
    for k in range(WARM_FRAMES):
        radiance = np.full((6, 24, 3), 1.5 + np.sin(2 * np.pi * k / 4), np.float32)
        radiance[2, k % 24] = 100
        radiance.flags.writeable = False  # as maps come off the wire: numba compiles the same loop for each of the two
        bright = BrightCells(np.array([2 * 24 + k % 24]), np.array([[0, 0, 1]], np.float32), np.ones(1, np.float32))
        state, _, _ = step(settings, state, SamplerInput(radiance, "hemisphere", k / 25, bright))
