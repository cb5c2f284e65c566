"""The sampler as a stage of the pipeline: maps in, lights out, and the lights' file."""

from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from vemlight import settings
from vemlight.files import notice
from vemlight.journal import JOURNAL_START
from vemlight.light.bright_cells import BrightCells
from vemlight.light.light_set import ErrorOfLights, LightSet, LightsFile, NearLights
from vemlight.light.near_lights import NearLightSet
from vemlight.runtime import wire
from vemlight.runtime.channels import Service
from vemlight.runtime.output_folder import LIGHTS, SNAPSHOTS
from vemlight.runtime.reports import ImageReport, LightsReport
from vemlight.sampler.error_limit import capped_text, is_capped
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.snapshot import SNAPSHOT_FRAMES, Snapshot, Snapshots
from vemlight.sampler.state import SamplerState, initial_state, state_after_jump
from vemlight.sampler.step import step

WARM_FRAMES = 32  # more than the 24 after which the search for flicker begins; any larger value does, and takes longer
FORGOTTEN = 8  # statuses, which come twice a second: a renderer that starts its programs anew is silent for 2 s. 4 to 20 would do
WARM_FPS = 21.0  # at which lamps of 100 Hz are seen to flicker


class Budget(NamedTuple):
    """Lights that a renderer can draw in its time, 0 without a limit, and how many statuses of others came since it said so."""

    renderer: str
    lights: int
    others: int = 0


class StageState(NamedTuple):
    """The sampler's state, the settings in force, which the viewer's controls change, and the near lights beside the newest map."""

    settings: settings.Sampler
    sampler: SamplerState
    budgets: tuple[Budget, ...] = ()
    near: NearLights | None = None
    segment: int = 0  # of the last map

    @property
    def light_budget(self) -> int:
        """Lights that the fastest renderer can draw, 0 without a limit: a slower one draws the strongest of them."""
        lights = [budget.lights for budget in self.budgets]
        return 0 if 0 in lights else max(lights, default=0)


def budgets_after(budgets: tuple[Budget, ...], status: wire.StatusMessage) -> tuple[Budget, ...]:
    """With what a renderer's status says; without those that have been silent for FORGOTTEN statuses of each other one."""
    if not isinstance(status.report, ImageReport):
        return budgets
    others = [budget._replace(others=budget.others + 1) for budget in budgets if budget.renderer != status.service]
    heard = [budget for budget in others if budget.others <= FORGOTTEN * len(others)]
    return (*heard, Budget(status.service, status.report.light_budget))


class SamplerStage:
    """See `vemlight.runtime.loop.Stage`."""

    service: Service = "sampler"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises UserError when the output folder cannot be written."""
        self._settings = settings.sampler
        self._is_lossless = settings.mode == "lossless"
        self._snapshots = Snapshots(Path(settings.out) / SNAPSHOTS) if settings.out and self._is_lossless else None
        until = self._snapshots.newest_end if self._snapshots else JOURNAL_START
        self._file = LightsFile(Path(settings.out) / LIGHTS, self._is_lossless, until) if settings.out else None
        self._points = ("points",) if settings.rig.file and settings.out else ()
        self._warned = False
        warm(settings.sampler)

    def first_missing_frame(self) -> int:
        return self._file.count if self._file else 0

    def start_at(self, target: int) -> tuple[StageState, int]:
        """From the newest snapshot before the target, or from the first frame: the filters remember."""
        found = self._snapshots.before(target) if self._snapshots else None
        return StageState(self._settings, found.state if found else initial_state()), found.frames if found else 0

    def side_inputs(self, state: StageState) -> tuple[str, ...]:
        """Near lights where they are written beside the lights."""
        return self._points

    def step(self, state: StageState, message: wire.Message) -> tuple[StageState, wire.Message]:
        header, (radiance, *bright) = message
        assert isinstance(header, wire.MapMessage)
        frame = SamplerInput(radiance, header.coverage, header.stamp.time_s, BrightCells(*bright), state.light_budget)
        before = state.sampler if header.segment == state.segment else state_after_jump(state.sampler, header.coverage)
        sampler, lights, report = step(state.settings, before, frame)
        gloss = report.gloss or LightSet.none()
        lights_header = wire.LightsMessage(
            stamp=header.stamp,
            count=len(lights.ids),
            gloss_count=len(gloss.ids),
            coverage=header.coverage,
            soft=lights.covariances is not None,
            clipped=header.clipped,
            estimated_lux=header.report.estimated_lux,
            report=LightsReport(
                delay_ms=report.delay_s * 1e3,
                delay_frames=report.delay_frames,
                required_lights=report.required_lights,
                light_budget=report.light_budget,
                error_ratio=report.error,
                error_limit_ratio=state.settings.error_limit,
                flicker_hz=report.flicker_hz,
                lamp_hz=report.lamp_hz,
                flicker_depth=report.flicker_depth,
            ),
        )
        arrays = (*(array for array in lights if array is not None), gloss.directions, gloss.irradiance)
        return state._replace(sampler=sampler, segment=header.segment), (lights_header, arrays)

    def on_message(self, state: StageState, message: wire.Message) -> StageState:
        header, arrays = message
        if isinstance(header, wire.PointsMessage):
            return state._replace(near=NearLights(NearLightSet(*arrays), header.at))
        if isinstance(header, wire.StatusMessage):
            return state._replace(budgets=budgets_after(state.budgets, header))
        assert isinstance(header, wire.ControlMessage)
        configured = self._settings
        name = "none" if header.filtered is False else configured.filter
        lamps = configured.lamp if header.lamps is None else header.lamps
        chosen = msgspec.structs.replace(configured, count=header.count or configured.count, filter=name, lamp=lamps)
        return state._replace(settings=chosen)

    def write(self, state: StageState, message: wire.Message) -> None:
        header, arrays = message
        assert isinstance(header, wire.LightsMessage)
        error, limit = 100 * header.report.error_ratio, 100 * header.report.error_limit_ratio
        if not self._warned and is_capped(error, limit):
            notice(capped_text(header.count, error, limit))
            self._warned = True
        if self._file:
            self._file.append(
                LightSet(*arrays[:-2]), header.stamp.sequence, header.stamp.time_s, header.coverage,
                ErrorOfLights(error, limit) if limit else None, state.near, header.clipped, header.estimated_lux,
            )  # fmt: skip
            if self._snapshots and self._file.count % SNAPSHOT_FRAMES == 0:
                self._snapshots.add(Snapshot(self._file.end, state.sampler))

    def finish(self) -> None:
        pass


def warm(settings: settings.Sampler) -> None:
    """Compiles everything that a frame may need, on a small map whose light flickers, so that no frame of a run waits for the compiler."""
    state = initial_state()
    for k in range(WARM_FRAMES):
        radiance = np.full((6, 24, 3), 1.5 + 0.5 * np.sin(200 * np.pi * k / WARM_FPS), np.float32)
        radiance[2, k % 24] = 100
        radiance.flags.writeable = False  # as arrays off the wire are: numba compiles a version for each
        bright = BrightCells(np.array([2 * 24 + k % 24]), np.array([[0, 0, 1]], np.float32), np.ones(1, np.float32))
        state, _, _ = step(settings, state, SamplerInput(radiance, "hemisphere", k / WARM_FPS, bright))
