"""The sampler as a stage of the pipeline: maps in, lights out, and the lights' file."""

from pathlib import Path
from typing import NamedTuple

import msgspec

from services import settings, wire
from services.channels import Service
from services.lights import Lights, LightsFile
from services.sampler.step import State, initial_state, step


class SamplerState(NamedTuple):
    """The sampler's memory and the settings in force, which the viewer's wishes change."""

    settings: settings.Sampler
    memory: State


class SamplerStage:
    """See `services.loop.Stage`."""

    service: Service = "sampler"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises BadInput when the output folder cannot be written."""
        self._settings = settings.sampler
        self._file = LightsFile(Path(settings.out) / "lights.jsonl") if settings.out else None

    def kept(self) -> int:
        return self._file.count if self._file else 0

    def begin(self, target: int) -> tuple[SamplerState, int]:
        """From the first frame: the filters remember, and a replay of maps alone is quick."""
        return SamplerState(self._settings, initial_state(self._settings)), 0

    def step(self, state: SamplerState, message: wire.Message) -> tuple[SamplerState, wire.Message]:
        header, arrays = message
        assert isinstance(header, wire.Map)
        memory, lights, report = step(state.settings, state.memory, arrays[0], header.coverage, header.stamp.time_s)
        made = wire.Lights(stamp=header.stamp, count=len(lights.ids), coverage=header.coverage, delay_ms=report.delay_s * 1e3)
        return SamplerState(state.settings, memory), (made, tuple(lights))

    def control(self, state: SamplerState, wish: wire.Control) -> SamplerState:
        own = self._settings
        unfiltered = wish.filtered is False
        asked = msgspec.structs.replace(own, count=wish.count or own.count, filter="none" if unfiltered else own.filter)
        return state._replace(settings=asked)

    def keep(self, state: SamplerState, message: wire.Message) -> None:
        header, arrays = message
        if self._file and isinstance(header, wire.Lights):
            self._file.append(Lights(*arrays), header.stamp.sequence, header.stamp.time_s, header.coverage)

    def done(self) -> None:
        pass
