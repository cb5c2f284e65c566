"""`vemlight lights` and `vemlight render`: the services' own steps, one after the other in this process, on files."""

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import InvalidCells
from vemlight.capture.masking import MaskedSource
from vemlight.capture.source import FrameSource, open_source
from vemlight.commands.options import LightsOptions, RenderOptions, SamplingOptions
from vemlight.commands.parameters import STANDARD_OUTPUT
from vemlight.commands.report import Report
from vemlight.commands.source_options import CAPTURE_KEYS, capture_settings, frames_of_live
from vemlight.errors import Interrupted, UserError
from vemlight.files import notice
from vemlight.light.images import write_exr, write_png
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


def renderer_settings(options: RenderOptions) -> settings.Renderer:
    """How to render. Raises UserError for a size that no picture may have."""
    width, height = options.size
    if not all(1 <= side <= settings.MAX_PICTURE_SIDE for side in options.size):
        raise UserError(f"--size {width}x{height}: a side has 1 to {settings.MAX_PICTURE_SIDE} pixels; choose another size")
    given = {
        "width": width,
        "height": height,
        "light_regions": 0 if options.coverage == "hemisphere" and not options.ground else None,
        "tone": options.tone,
        "background": options.background,
        "shadow_map": options.shadow_map,
        "shadows": options.shadows,
        "bounces": options.bounces,
        "exr": options.exr,
        "exposure": options.exposure,
    }
    return section_from_options(settings.Renderer, given)


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


def write_pictures(options: RenderOptions) -> str:
    """Renders each frame to pictures (several are numbered NAME_0000), to a video, or both. Returns a line about what was written.

    Raises UserError for options that cannot be used.
    """
    from vemlight.light.environment_map import EnvironmentMap
    from vemlight.renderer.frame_sequence import FrameSequence
    from vemlight.renderer.output.exr_attributes import exr_pixels, time_attributes
    from vemlight.renderer.output.tonemap import adapt, subsampled, tone_mapped
    from vemlight.renderer.output.video import video_writer
    from vemlight.renderer.renderer import Renderer
    from vemlight.renderer.scene.scene import load_scene
    from vemlight.renderer.scene.scene_pose import scene_pose
    from vemlight.renderer.stage import file_samples

    out, to_video = options.out, options.video
    _check_outputs(out, to_video)
    wanted = renderer_settings(options)
    scene = load_scene(options.scene)
    frames = open_frames(options)
    sampling = sampler_settings(options, len(frames))
    with interruption.deferred(), ExitStack() as open_:
        video = open_.enter_context(video_writer(to_video, frames.fps)) if to_video else None
        sequence = FrameSequence(Renderer(scene, wanted, file_samples(scene)))
        open_.callback(sequence.release)
        adaptation, before_s = None, 0.0
        for k, (frame, lights, _) in enumerate(counted(lit_frames(frames, sampling), "frames", len(frames))):
            environment = EnvironmentMap(frame.radiance, frame.coverage, frame.bright_cells)
            background = environment if wanted.background == "map" else None
            picture = sequence.render(sequence.renderer.drawable(lights), environment, scene_pose(scene, frame.time_s), background)
            adaptation = adapt(adaptation, subsampled(picture), max(0.0, frame.time_s - before_s))
            before_s = frame.time_s
            pixels = tone_mapped(picture, adaptation, wanted.exposure, wanted.tone)
            if out:
                attributes = time_attributes(k, frame.time_s, frames.fps if len(frames) > 1 else None)
                if frame.luminance_scale is not None:
                    attributes["whiteLuminance"] = frame.luminance_scale
                _write(_numbered(out, k, len(frames)), exr_pixels(picture, wanted.exr), pixels, attributes)
            if video:
                video.add(pixels, frame.time_s)
            if interruption.came and k + 1 < len(frames):
                raise Interrupted(_partial(out, to_video, k + 1, len(frames)))
    written = [f"{to_video} as {video.encoder.shown}"] if video and video.encoder else []
    if out:
        last = "" if len(frames) == 1 else f" to {_numbered(out, len(frames) - 1, len(frames)).name}"
        written.insert(0, f"{_numbered(out, 0, len(frames))}{last}")
    return ", ".join(written)


def _partial(out: Path | None, to_video: Path | None, done: int, count: int) -> str:
    """What there is of a rendering that was interrupted."""
    pictures = [f"{out} is partial, {done} of {count} pictures"] if out else []
    return "; ".join([*pictures, *([f"there is no {to_video}"] if to_video else [])])


def _check_outputs(out: Path | None, to_video: Path | None) -> None:
    if not (out or to_video):
        raise UserError("--out, --video: neither is given; name a picture or a video to write")
    if out and out.suffix not in (".exr", ".png"):
        raise UserError(f"{out}: pictures are written as .exr or .png; change the suffix")
    for path in filter(None, (out, to_video)):
        if not path.resolve().parent.is_dir():
            raise UserError(f"{path}: there is no such folder; make it first")


def _numbered(out: Path, number: int, count: int) -> Path:
    """The file of one of `count` pictures."""
    return out if count == 1 else out.with_stem(f"{out.stem}_{number:04d}")


def _write(path: Path, picture: np.ndarray, pixels: np.ndarray, attributes: dict[str, Any]) -> None:
    if path.suffix == ".exr":
        write_exr(path, picture, attributes)
    else:
        write_png(path, pixels)
