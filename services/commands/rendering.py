"""`vemlight render`: pictures and videos of a scene under the light of maps, or under lights from a file."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from vemlight import settings
from vemlight.commands.options import RenderOptions
from vemlight.commands.shown_frames import shown_frames
from vemlight.errors import Interrupted, UserError
from vemlight.light.images import write_exr, write_png
from vemlight.runtime.interrupt import interruption
from vemlight.runtime.progress import counted
from vemlight.setting_keys import MAX_PICTURE_SIDE
from vemlight.settings_file import section_from_options


def renderer_settings(options: RenderOptions) -> settings.Renderer:
    """How to render. Raises UserError for a size that no picture may have."""
    width, height = options.size
    if not all(1 <= side <= MAX_PICTURE_SIDE for side in options.size):
        raise UserError(f"--size {width}x{height}: a side has 1 to {MAX_PICTURE_SIDE} pixels; choose another size")
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


def write_pictures(options: RenderOptions) -> str:
    """Renders each frame to pictures (several are numbered NAME_0000), to a video, or both. Returns a line about what was written.

    Raises UserError for options that cannot be used.
    """
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
    frames = shown_frames(options)
    with interruption.deferred(), ExitStack() as open_:
        video = open_.enter_context(video_writer(to_video, frames.fps)) if to_video else None
        sequence = FrameSequence(Renderer(scene, wanted, file_samples(scene)))
        open_.callback(sequence.release)
        adaptation, before_s = None, 0.0
        for k, frame in enumerate(counted(frames.frames, "frames", frames.count)):
            background = frame.environment if wanted.background == "map" else None
            lights, pose = sequence.renderer.drawable(frame.lights), scene_pose(scene, frame.time_s)
            picture = sequence.render(lights, frame.environment, pose, background, frame.near)
            adaptation = adapt(adaptation, subsampled(picture), max(0.0, frame.time_s - before_s))
            before_s = frame.time_s
            pixels = tone_mapped(picture, adaptation, wanted.exposure, wanted.tone)
            if out:
                attributes = time_attributes(k, frame.time_s, frames.fps if frames.count > 1 else None)
                if frame.luminance_scale is not None:
                    attributes["whiteLuminance"] = frame.luminance_scale
                _write(_numbered(out, k, frames.count), exr_pixels(picture, wanted.exr), pixels, attributes)
            if video:
                video.add(pixels, frame.time_s)
            if interruption.came and k + 1 < frames.count:
                raise Interrupted(_partial(out, to_video, k + 1, frames.count))
    written = [f"{to_video} as {video.encoder.shown}"] if video and video.encoder else []
    if out:
        last = "" if frames.count == 1 else f" to {_numbered(out, frames.count - 1, frames.count).name}"
        written.insert(0, f"{_numbered(out, 0, frames.count)}{last}")
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
