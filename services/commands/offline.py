"""`vemlight lights` and `vemlight render`: the services' own steps, one after the other in this process, on files."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.source import Source, open_source
from vemlight.errors import UserError
from vemlight.light.images import write_exr, write_png
from vemlight.light.light_set import LightSet, check_lights_path, lights_row, write_lights
from vemlight.runtime.progress import counted
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import score as scored
from vemlight.sampler.score import text
from vemlight.sampler.step import initial_state, step
from vemlight.settings import record

GLOSS_LIGHTS = 512  # of a glossy scene; twice as many gain little (docs/looks.md)


class Lit(NamedTuple):
    """One frame, its lights and its gloss set, None when none is asked for."""

    frame: Frame
    lights: LightSet
    gloss: LightSet | None


def opened(source: Path, options: dict[str, Any]) -> tuple[Source, settings.Sampler]:
    """The frames of `source` and how to sample them; `options` as on the command line.

    Raises UserError for options or files that cannot be used.
    """
    capturing: dict[str, Any] = {key: options[key] for key in ("coverage", "fps", "lens", "response")}
    capturing |= {"source": str(source.resolve()), "rows": 180 if options["coverage"] == "sphere" else None}
    frames = open_source(record(settings.Capture, capturing, "--"))
    filtering = options["filter_"] or (None if len(frames) > 1 else "none")
    sampling = {"count": options["count"], "method": options["method"], "filter": filtering}
    sampling |= {"clusters": options.get("clusters"), "error_percent": options.get("error"), "deflicker": options.get("deflicker")}
    sampling |= {"gloss_lights": options.get("gloss_lights")}
    return frames, record(settings.Sampler, sampling, "--")


def lit_frames(frames: Source, sampling: settings.Sampler) -> Iterator[Lit]:
    """The lights of every frame, in order. Raises UserError for a frame that cannot be read."""
    state = initial_state(sampling)
    for k in range(len(frames)):
        frame = frames.frame(k)
        state, lights, report = step(sampling, state, SamplerInput(frame.radiance, frame.coverage, frame.time_s, frame.bright_cells))
        yield Lit(frame, lights, report.gloss)


def write_lights_of(source: Path, out: Path, *, score: bool = False, **options: Any) -> str:
    """Writes the lights of each frame of `source` to `out`; `score` prints how true and how steady they are. Says what it has written.

    Raises UserError before any work for an `out` that cannot hold them.
    """
    frames, sampling = opened(source, options)
    check_lights_path(out, len(frames))
    lit = list(counted(lit_frames(frames, sampling), "frames", len(frames)))
    write_lights(out, [lights_row(lights, k, frame.time_s, frame.coverage) for k, (frame, lights, _) in enumerate(lit)])
    if score:
        print(text(scored(((frame.radiance, lights) for frame, lights, _ in lit), lit[0].frame.coverage)))
    return f"{out}: {len(lit[0].lights.ids)} lights" if len(lit) == 1 else f"{out}: the lights of {len(lit)} frames"


def write_pictures_of(source: Path, scene: Path | None, size: str, exposure: float, out: Path | None, **options: Any) -> str:
    """Renders each frame of `source`, to pictures (several are numbered NAME_0000), to a video, or both. Says what it has written.

    Raises UserError for options that cannot be used.
    """
    from vemlight.renderer.output.tonemap import adapt, subsampled, tone_mapped
    from vemlight.renderer.output.video import video
    from vemlight.renderer.renderer import Renderer
    from vemlight.renderer.scene.scene import load_scene
    from vemlight.renderer.stage import file_samples

    if not (out or options.get("video")):
        raise UserError("--out, --video: neither is given; name a picture or a video to write")
    if out and out.suffix not in (".exr", ".png"):
        raise UserError(f"{out}: pictures are written as .exr or .png; change the suffix")
    for path in filter(None, (out, options.get("video"))):
        if not path.resolve().parent.is_dir():
            raise UserError(f"{path}: there is no such folder; make it first")
    width, height = _sides(size)
    drawing = {key: options.get(key) for key in ("tone", "background", "shadow_map")}
    drawing["light_regions"] = 0 if options["coverage"] == "hemisphere" else None
    drawing |= {"width": width, "height": height, "exposure": exposure}
    wanted = record(settings.Renderer, drawing, "--")
    drawn = load_scene(scene)
    if options.get("gloss_lights") is None and drawn.glossy:
        options["gloss_lights"] = GLOSS_LIGHTS
    frames, sampling = opened(source, options)
    with ExitStack() as open_:
        add = open_.enter_context(video(options["video"], frames.fps)) if options.get("video") else None
        renderer = Renderer(drawn, wanted, file_samples(drawn))
        open_.callback(renderer.release)
        adaptation, before_s = None, 0.0
        for k, (frame, lights, gloss) in enumerate(counted(lit_frames(frames, sampling), "frames", len(frames))):
            if wanted.background == "map":
                renderer.show_background(frame.radiance, frame.coverage)
            renderer.place(frame.time_s)
            picture = renderer.render(lights, gloss)
            adaptation = adapt(adaptation, subsampled(picture), max(0.0, frame.time_s - before_s))
            before_s = frame.time_s
            pixels = tone_mapped(picture, adaptation, exposure, wanted.tone)
            if out:
                _write(_numbered(out, k, len(frames)), picture, pixels)
            if add:
                add(pixels, frame.time_s)
    written = [str(options["video"])] if options.get("video") else []
    if out:
        last = "" if len(frames) == 1 else f" to {_numbered(out, len(frames) - 1, len(frames)).name}"
        written.insert(0, f"{_numbered(out, 0, len(frames))}{last}")
    return ", ".join(written)


def _sides(size: str) -> tuple[int, int]:
    """Width and height in pixels of WIDTHxHEIGHT. Raises UserError for anything else and for sides that no picture may have."""
    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise UserError(f"--size {size}: is not WIDTHxHEIGHT; write it as 640x480")
    if not all(len(side) < 6 and 1 <= int(side) <= settings.MOST_PIXELS for side in (width, height)):
        raise UserError(f"--size {size}: a side has 1 to {settings.MOST_PIXELS} pixels; choose another size")
    return int(width), int(height)


def _numbered(out: Path, number: int, count: int) -> Path:
    """The file of one of `count` pictures."""
    return out if count == 1 else out.with_stem(f"{out.stem}_{number:04d}")


def _write(path: Path, picture: np.ndarray, pixels: np.ndarray) -> None:
    if path.suffix == ".exr":
        write_exr(path, picture)
    else:
        write_png(path, pixels)
