"""What `vemlight render` shows, frame by frame: the light of maps, or lights from a file that has them already."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from vemlight.capture.frames import Frame
from vemlight.commands.lighting import lit_frames
from vemlight.commands.offline import open_frames, sampler_settings
from vemlight.commands.options import RenderOptions
from vemlight.errors import UserError
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.lights_reader import is_lights_file, lights_frames
from vemlight.light.near_lights import NearLightSet


class ShownFrame(NamedTuple):
    """The light of a frame. environment: the map that lobes reflect; None: they reflect the lights. luminance_scale: cd/m^2 of a unit of
    radiance, where it is known."""

    time_s: float
    lights: LightSet
    near: NearLightSet
    environment: EnvironmentMap | None
    luminance_scale: float | None


class ShownFrames(NamedTuple):
    """Frames in their order."""

    count: int
    fps: float
    frames: Iterator[ShownFrame]


def shown_frames(options: RenderOptions) -> ShownFrames:
    """The frames of a render's source. Raises UserError for a source, or options, that cannot be used."""
    if not is_lights_file(options.source):
        source = open_frames(options)
        sampling = sampler_settings(options, len(source))
        return ShownFrames(len(source), source.fps, (_of_map(*lit[:2]) for lit, _ in lit_frames(source, sampling)))
    path = Path(options.source)
    if options.given:
        raise UserError(f"{options.given[0]}: {path} has its lights already; leave it out, or give the source of the lights")
    if options.background == "map":
        raise UserError(f"--background map: {path} holds lights and no map; leave it out, or give the source of the lights")
    count, first_s, last_s = 0, 0.0, 0.0
    for frame in islice(lights_frames(path), options.frames):  # all are read before the first is drawn
        count, first_s, last_s = count + 1, frame.time_s if count == 0 else first_s, frame.time_s
    fps = (count - 1) / (last_s - first_s) if count > 1 else 25.0
    return ShownFrames(count, fps, _of_file(path, options.frames))


def _of_map(frame: Frame, lights: LightSet) -> ShownFrame:
    environment = EnvironmentMap(frame.radiance, frame.coverage, frame.bright_cells)
    return ShownFrame(frame.time_s, lights, NearLightSet.empty(), environment, frame.luminance_scale)


def _of_file(path: Path, most: int | None) -> Iterator[ShownFrame]:
    for frame in islice(lights_frames(path), most):
        near = frame.near.points if frame.near else NearLightSet.empty()
        yield ShownFrame(frame.time_s, frame.lights, near, None, None)
