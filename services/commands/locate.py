"""`vemlight locate`: the recordings of several cameras become near lights at their places, and directional lights for the rest."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight import settings
from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import InvalidCells
from vemlight.capture.source import FrameSource
from vemlight.commands.options import LocateOptions
from vemlight.commands.report import Report
from vemlight.commands.rig_recordings import recording_of
from vemlight.errors import Interrupted, UserError, of_setting
from vemlight.files import notice, written_whole
from vemlight.fuse.fusing import FuseReport, FuseState, fuse_step, fuse_still
from vemlight.fuse.rig_file import CameraRig, RigCamera, check_one_rate, read_camera_rig
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import ErrorOfLights, LightSet, NearLights, check_lights_path, lights_json, lights_row
from vemlight.light.near_lights import NearLightSet
from vemlight.runtime.interrupt import interruption
from vemlight.runtime.progress import counted
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings_file import section_from_options


class LocatedFrame(NamedTuple):
    """One moment: its lights, the near ones, and what was found out about them. clipped: light of a camera is above what it can show."""

    time_s: float
    coverage: Any
    lights: LightSet
    points: NearLightSet
    error: ErrorOfLights | None
    clipped: bool
    estimated_lux: float
    report: FuseReport


def write_located(options: LocateOptions) -> Report:
    """Writes the lights of each moment of a rig's recordings. Returns what was written.

    Raises UserError for a rig file, a recording or an `out` that cannot be used; nothing is left behind then.
    """
    rig = read_camera_rig(options.rig)
    sources = [recording_of(options.rig, camera, options.coverage, options.fps, options.frames or 0) for camera in rig.camera]
    count = _frame_count(options, rig, sources)
    if count > 1:
        check_one_rate(options.rig, rig, [source.fps for source in sources])
    check_lights_path(options.out, count)
    given = {"count": options.count, "error_percent": options.error_percent, "soft": options.soft, "filter": None if count > 1 else "none"}
    sampling = section_from_options(settings.Sampler, given)
    x, y, z = map(float, rig.centre)
    located, unexplained, misfits, done = set[int](), 0, 0, 0
    moments = _located_frames(options, rig, sources, count, sampling)
    first = next(moments)  # what cannot be read is found before anything is written
    with interruption.deferred(), written_whole(options.out) as part, open(part, "wb") as file:
        for k, frame in enumerate(counted(chain([first], moments), "frames", count)):
            near = NearLights(frame.points, (x, y, z))
            row = lights_row(frame.lights, k, frame.time_s, frame.coverage, frame.error, frame.clipped, near, frame.estimated_lux)
            file.write(lights_json(row) + b"\n")
            located |= set(frame.points.ids.tolist())
            unexplained, misfits, done = max(unexplained, frame.report.unexplained), misfits + (not frame.report.believed), k + 1
            if interruption.came and done < count:
                raise Interrupted(f"there is no {options.out}")
    text = f"{options.out}: {len(located)} near lights in {done} frame{'s' if done > 1 else ''} of {len(rig.camera)} cameras"
    if unexplained:
        text += f"; up to {unexplained} compact sources a frame fit no place: hidden from other cameras, or a pose is wrong"
    if misfits:
        text += f"; in {misfits} frames no near light is published: lamps do not fit one place each within pose_deg and pose_m of the "
        text += "rig: a pose is wrong by more, or the lamps are too few to tell"
    values = {"out": str(options.out), "frames": done, "near_lights": len(located), "unexplained": unexplained, "misfits": misfits}
    return Report(text, values)


def _frame_count(options: LocateOptions, rig: CameraRig, sources: list[FrameSource]) -> int:
    """How many moments all cameras have; a notice tells of frames that one has more."""
    counts = [len(source) for source in sources]
    for camera, count in zip(rig.camera, counts, strict=True):
        if count > min(counts):
            notice(f"{options.rig}: camera {camera.name}: has {count} frames and another {min(counts)}; the first {min(counts)} are used")
    return min(counts)


def _located_frames(
    options: LocateOptions, rig: CameraRig, sources: list[FrameSource], count: int, sampling: settings.Sampler
) -> Iterator[LocatedFrame]:
    """The lights of every moment, in order; a notice counts invalid cells. Raises UserError for frames that do not go together."""
    state, sampled, invalid_cells = FuseState.start(rig, options.subject), initial_state(), [InvalidCells() for _ in sources]
    for k in range(count):
        interruption.check()
        frames = [_frame(options.rig, camera, source, k) for camera, source in zip(rig.camera, sources, strict=True)]
        _check_times(options.rig, rig, frames, k, sources[0].fps)
        for frame, cells in zip(frames, invalid_cells, strict=True):
            cells.add(frame.radiance)
        maps = [EnvironmentMap(frame.radiance, frame.coverage, frame.bright_cells) for frame in frames]
        clipped = [frame.clipped or frame.saturated > 0 for frame in frames]
        if count == 1:
            fused, points, report = fuse_still(state, maps, clipped)
        else:
            state, fused, points, report = fuse_step(state, maps, clipped)
        for text in report.limits:
            notice(f"{options.rig}: {text}")
        seen = SamplerInput(fused.radiance, fused.coverage, frames[0].time_s, fused.bright_cells)
        sampled, lights, estimate = step(sampling, sampled, seen)
        limit = 100 * sampling.error_limit
        error = ErrorOfLights(100 * estimate.error, limit) if limit else None
        yield LocatedFrame(frames[0].time_s, fused.coverage, lights, points, error, *_clipped(frames), report)
    for cells in invalid_cells:
        cells.say()


def _clipped(frames: Sequence[Frame]) -> tuple[bool, float]:
    """Whether light of any camera is clipped, and the most that was estimated of it, lux."""
    return any(frame.clipped for frame in frames), max(frame.estimated_lux for frame in frames)


def _frame(path: Path, camera: RigCamera, source: FrameSource, k: int) -> Frame:
    with of_setting(f"{path}: camera {camera.name}"):
        return source.frame(k)


def _check_times(path: Path, rig: CameraRig, frames: list[Frame], k: int, fps: float) -> None:
    """Raises UserError where frame k of two cameras was taken at two moments."""
    times = np.array([frame.time_s for frame in frames])
    late = int(np.argmax(np.abs(times - times[0])))
    if abs(times[late] - times[0]) > 0.5 / fps + 1e-6:
        text = f"camera {rig.camera[late].name}: its frame {k} is of {times[late]:g} s and that of {rig.camera[0].name} of {times[0]:g} s"
        raise UserError(f"{path}: {text}; record all cameras together, without frames lost")
