"""Frames into lights one after the other, with what carries over from frame to frame and what is said of them all in the end."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import InvalidCells
from vemlight.capture.source import FrameSource
from vemlight.files import notice
from vemlight.light.light_set import ErrorOfLights, LightSet, lights_json, lights_row
from vemlight.runtime.interrupt import interruption
from vemlight.sampler.error_limit import capped_text, is_capped
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import SamplerState, initial_state
from vemlight.sampler.step import step


class Lit(NamedTuple):
    """One frame, its lights, and the lights' error, None without a limit."""

    frame: Frame
    lights: LightSet
    error: ErrorOfLights | None

    def row_json(self, number: int) -> bytes:
        """Its line in a file of lights, as frame `number`, with the line's end."""
        frame, lights, error = self
        row = lights_row(lights, number, frame.time_s, frame.coverage, error, frame.clipped, estimated_lux=frame.estimated_lux)
        return lights_json(row) + b"\n"


class Tally(NamedTuple):
    """Of the frames so far. fewest, most: lights of a frame. worst: the largest error in %, 0 without a limit.

    capped, capped_error: lights and error of the worst frame whose lights the maximum kept too few. invalid: as InvalidCells counts.
    """

    frames: int = 0
    fewest: int = 0
    most: int = 0
    worst: float = 0.0
    capped: int = 0
    capped_error: float = 0.0
    invalid: tuple[int, int, int, int] = (0, 0, 0, 0)

    def with_frame(self, lit: Lit) -> "Tally":
        """And of one more."""
        count, error = len(lit.lights.ids), lit.error.estimate if lit.error else 0.0
        is_worse = lit.error is not None and is_capped(error, lit.error.limit) and error > self.capped_error
        cells = InvalidCells(self.invalid)
        cells.add(lit.frame.radiance)
        return Tally(
            self.frames + 1, min(count, self.fewest) if self.frames else count, max(count, self.most), max(error, self.worst),
            *((count, error) if is_worse else (self.capped, self.capped_error)), cells.counts,
        )  # fmt: skip

    def say(self, limit: float) -> None:
        """Notices about all frames, where there is something to be said. limit: of the error, %."""
        if self.capped_error:
            notice(capped_text(self.capped, self.capped_error, limit))
        InvalidCells(self.invalid).say()

    def text(self, limit: float) -> str:
        """How many lights there are and what their error is, for a report."""
        text = f"{self.fewest} lights" if self.frames == 1 else f"the lights of {self.frames} frames"
        if limit:
            text += f", {self.worst:.2g} % estimated error{' in the worst' if self.frames > 1 else ''}, limit {limit:g} %"
        return text


class LightingState(NamedTuple):
    """What carries over from frame to frame."""

    sampler: SamplerState
    tally: Tally


def first_state() -> LightingState:
    """Before the first frame."""
    return LightingState(initial_state(), Tally())


def lit_frame(sampling: settings.Sampler, state: LightingState, frame: Frame) -> tuple[LightingState, Lit]:
    """The lights of one frame. A pure function, whose bytes depend on the values alone and not on how the arrays lie in memory."""
    radiance = np.ascontiguousarray(frame.radiance, np.float32)
    given = SamplerInput(radiance, frame.coverage, frame.time_s, frame.bright_cells)
    sampler, lights, report = step(sampling, state.sampler, given)
    error = ErrorOfLights(100 * report.error, 100 * sampling.error_limit) if sampling.error_limit else None
    lit = Lit(frame, lights, error)
    return LightingState(sampler, state.tally.with_frame(lit)), lit


def lit_frames(frames: FrameSource, sampling: settings.Sampler) -> Iterator[tuple[Lit, Tally]]:
    """The lights of every frame, in order, and what there is to say of the frames up to it; after the last, notices say it.

    Raises UserError for a frame that cannot be read.
    """
    state = first_state()
    for k in range(len(frames)):
        interruption.check()
        state, lit = lit_frame(sampling, state, frames.frame(k))
        yield lit, state.tally
    state.tally.say(100 * sampling.error_limit)
