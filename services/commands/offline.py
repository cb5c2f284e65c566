"""`vemlight lights` and `vemlight render`: the services' own steps, one after the other in this process, on files."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import InvalidCells
from vemlight.capture.masking import MaskedSource
from vemlight.capture.source import FrameSource, open_source
from vemlight.commands.options import LightsOptions, SamplingOptions
from vemlight.commands.parameters import STANDARD_OUTPUT
from vemlight.commands.report import Report
from vemlight.commands.source_options import CAPTURE_KEYS, capture_settings, frames_of_live
from vemlight.files import notice
from vemlight.light.light_set import ErrorOfLights, LightSet, check_lights_path, lights_json, lights_row, write_lights
from vemlight.runtime.interrupt import interruption
from vemlight.runtime.progress import counted
from vemlight.sampler.error_limit import capped_text, is_capped
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import score as scored
from vemlight.sampler.score import score_text
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import section_from_options


class Lit(NamedTuple):
    """One frame, its lights, and the lights' error, None without a limit."""

    frame: Frame
    lights: LightSet
    error: ErrorOfLights | None


def open_frames(options: SamplingOptions) -> FrameSource:
    """The frames of the source; a camera or stream is taken as many frames of as are asked for. Raises UserError."""
    given = {key: getattr(options, key) for key in (*CAPTURE_KEYS, "lenses", "controls", "response", "coverage", "fps", "layer", "frames")}
    given["rows"] = 180 if options.coverage == "sphere" else None  # one degree of elevation a row, as the 90 of a hemisphere
    capture = capture_settings(settings.Capture(), os.fspath(options.source), given)
    if settings.is_live(capture.source):
        from vemlight.capture.live_frames import LiveFrames
        from vemlight.commands.run_checks import check_camera

        count = frames_of_live(options.frames, capture.source)
        if settings.is_camera(capture.source):
            check_camera(Path(capture.source))
        return MaskedSource(LiveFrames(capture, count), capture)
    return MaskedSource(open_source(limited_to(capture, options.frames)), capture)


def limited_to(capture: settings.Capture, frames: int | None) -> settings.Capture:
    """The settings, with `end` after so many frames."""
    return msgspec.structs.replace(capture, frames=0, end=capture.start + frames) if frames else capture


def sampler_settings(options: SamplingOptions, frames: int, **given: float | None) -> settings.Sampler:
    """How to sample a source of so many frames; `given` are settings that only one of the commands has. Raises UserError."""
    given_by_both = {
        "count": options.count,
        "method": options.method,
        "filter": options.filter or (None if frames > 1 else "none"),
        "deflicker": options.deflicker,
    }
    return section_from_options(settings.Sampler, given_by_both | given)


def lit_frames(frames: FrameSource, sampling: settings.Sampler) -> Iterator[Lit]:
    """The lights of every frame, in order; a notice counts invalid cells. Raises UserError for a frame that cannot be read."""
    state, invalid_cells, worst = initial_state(), InvalidCells(), (0, 0.0)
    for k in range(len(frames)):
        interruption.check()
        frame = frames.frame(k)
        invalid_cells.add(frame.radiance)
        state, lights, report = step(sampling, state, SamplerInput(frame.radiance, frame.coverage, frame.time_s, frame.bright_cells))
        error, limit = 100 * report.error, 100 * sampling.error_limit
        if is_capped(error, limit) and error > worst[1]:
            worst = len(lights.ids), error
        yield Lit(frame, lights, ErrorOfLights(error, limit) if limit else None)
    if worst[1]:
        notice(capped_text(*worst, 100 * sampling.error_limit))
    invalid_cells.say()


def write_lights_file(options: LightsOptions) -> Report:
    """Writes the lights of each frame, to standard output for `-`. Returns what was written and, if asked, the lights' score.

    Raises UserError before any work for an `out` that cannot hold them.
    """
    frames = open_frames(options)
    sampling = sampler_settings(options, len(frames), clusters=options.clusters, error_percent=options.error_percent,
                                soft=options.soft)  # fmt: skip
    out = options.out
    if out != STANDARD_OUTPUT:
        check_lights_path(out, len(frames))
    lit = list(counted(lit_frames(frames, sampling), "frames", len(frames)))
    rows = [lights_row(lights, k, frame.time_s, frame.coverage, error, frame.clipped) for k, (frame, lights, error) in enumerate(lit)]
    if out == STANDARD_OUTPUT:
        sys.stdout.buffer.write(b"".join(lights_json(row) + b"\n" for row in rows))
    else:
        write_lights(out, rows)
    counts = [len(lights.ids) for _, lights, _ in lit]
    text = f"{out}: {counts[0]} lights" if len(lit) == 1 else f"{out}: the lights of {len(lit)} frames"
    errors = [error for *_, error in lit if error]
    if errors:
        worst = max(error.estimate for error in errors)
        text += f", {worst:.2g} % estimated error{' in the worst' if len(lit) > 1 else ''}, limit {errors[0].limit:g} %"
    values = {"out": str(out), "frames": len(lit), "lights": {"fewest": min(counts), "most": max(counts)}}
    if not options.score:
        return Report(text, values)
    score = scored(((frame.radiance, lights) for frame, lights, _ in lit), lit[0].frame.coverage)
    return Report(f"{score_text(score)}\n{text}", values | {"score": score._asdict()})
