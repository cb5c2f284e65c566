"""`vemlight lights`: the services' own steps, one after the other in this process, on files; and how options become settings."""

import os
import sys
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from typing import BinaryIO

import msgspec
import numpy as np

from vemlight import settings
from vemlight.capture.masking import MaskedSource
from vemlight.capture.source import FrameSource, open_source
from vemlight.commands.lighting import Lit, Tally, lit_frames
from vemlight.commands.options import LightsOptions, SamplingOptions
from vemlight.commands.parameters import STANDARD_OUTPUT
from vemlight.commands.report import Report
from vemlight.commands.source_options import CAPTURE_KEYS, capture_settings, frames_of_live
from vemlight.files import notice, writing_to, written_whole
from vemlight.light.light_set import LightSet, check_lights_path
from vemlight.runtime.progress import counted
from vemlight.sampler.score import score as scored
from vemlight.sampler.score import score_text
from vemlight.settings_file import section_from_options
from vemlight.source_names import is_camera, is_live


def capture_of(options: SamplingOptions) -> settings.Capture:
    """How the source is to be read. Raises UserError for options that do not fit together."""
    given = {key: getattr(options, key) for key in (*CAPTURE_KEYS, "lenses", "controls", "response", "coverage", "fps", "layer", "frames")}
    given["rows"] = 180 if options.coverage == "sphere" else None  # one degree of elevation a row, as the 90 of a hemisphere
    return capture_settings(settings.Capture(), os.fspath(options.source), given)


def open_frames(options: SamplingOptions) -> FrameSource:
    """The frames of the source; a camera or stream is taken as many frames of as are asked for. Raises UserError."""
    capture = capture_of(options)
    if is_live(capture.source):
        from vemlight.capture.live_frames import LiveFrames
        from vemlight.commands.run_checks import check_camera

        if is_camera(capture.source):
            check_camera(capture.source)
        count = frames_of_live(options.frames, capture.source)
        return MaskedSource(LiveFrames(capture, count), capture)
    source = open_source(limited_to(capture, options.frames))
    if options.frames and len(source) < options.frames:
        notice(f"{options.source}: has {len(source)} frame{'' if len(source) == 1 else 's'}, and --frames asks for {options.frames}")
    return MaskedSource(source, capture)


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


def write_lights_file(options: LightsOptions) -> Report:
    """Writes the lights of each frame as it is done, to standard output for `-`. Returns what was written and, if asked, their score.

    Raises UserError before any work for an `out` that cannot hold them.
    """
    frames = open_frames(options)
    sampling = sampler_settings(options, len(frames), clusters=options.clusters, error_percent=options.error_percent,
                                soft=options.soft)  # fmt: skip
    if options.out != STANDARD_OUTPUT:
        check_lights_path(options.out, len(frames))
    lit = iter(counted(lit_frames(frames, sampling), "frames", len(frames)))
    lit = chain(list(islice(lit, 1)), lit)  # where there is no first frame there is no file either
    if options.out == STANDARD_OUTPUT:
        return _write_rows(options, lit, sampling, sys.stdout.buffer)
    with written_whole(options.out) as part, writing_to(options.out), open(part, "wb") as file:
        return _write_rows(options, lit, sampling, file)


def _write_rows(options: LightsOptions, rows: Iterable[tuple[Lit, Tally]], sampling: settings.Sampler, file: BinaryIO) -> Report:
    """Writes a row for each frame; one frame is in memory at a time, and for a score 8 kB of each remain."""
    tally = Tally()

    def written() -> Iterator[tuple[np.ndarray, LightSet]]:
        nonlocal tally
        for lit, after in rows:
            file.write(lit.row_json(tally.frames))
            file.flush()
            tally = after
            yield lit.frame.radiance, lit.lights

    score = scored(written(), capture_of(options).map_coverage) if options.score else None
    deque(written() if score is None else (), maxlen=0)
    text = f"{options.out}: {tally.text(100 * sampling.error_limit)}"
    values = {"out": str(options.out), "frames": tally.frames, "lights": {"fewest": tally.fewest, "most": tally.most}}
    if score is None:
        return Report(text, values)
    return Report(f"{score_text(score)}\n{text}", values | {"score": score._asdict()})
