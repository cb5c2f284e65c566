"""`vemlight calibrate rig`: the camera's frames and the fixtures' packets in one process."""

import time
from pathlib import Path

import click
import numpy as np

from vemlight.capture.frames import Frame
from vemlight.capture.live_frames import SILENT_S, WAIT_S, LiveSource, open_live
from vemlight.errors import UserError
from vemlight.fixtures.check import check_rig_file
from vemlight.fixtures.measuring import Measured, Seen, measure
from vemlight.fixtures.rig_writing import write_measured
from vemlight.fixtures.sender import Sender
from vemlight.runtime.interrupt import interruption
from vemlight.settings_file import read_settings
from vemlight.source_names import is_live

FRAMES = 4  # of which the mean is measured: their noise is half of one frame's. 2 to 16 would do


def calibrate_rig_file(path: Path, settings: Path, *, settle_s: float, level: float) -> None:
    """Measures and writes. Raises UserError for a rig, camera or result that cannot be used; nothing is written then."""
    rig, capture = check_rig_file(path), read_settings(settings).capture
    if path.suffix.lower() == ".mvr" or rig.mvr:
        raise UserError(f"{path}: its fixtures come from an MVR file; write them into the rig file to measure them")
    if not is_live(capture.source):
        raise UserError(f"{settings}: [capture] source is no camera or stream; name the camera that stands at the target")
    source = open_live(capture)
    sender = Sender(rig, str(path), armed=True, blackout_at_end=True)
    try:
        for found in measure(rig, lambda slots: _look(sender, source, slots, settle_s), level):
            if isinstance(found, Measured):
                _write(path, found)
            else:
                click.echo(found)
    finally:
        sender.close()
        source.close()


def _look(sender: Sender, source: LiveSource, slots: dict[int, bytes], settle_s: float) -> Seen:
    """The mean of the first FRAMES frames that were taken when the slots had shown for settle_s."""
    sender.show(slots)
    settled_s, frames = time.monotonic() + settle_s, []
    until_s = settled_s + SILENT_S
    while len(frames) < FRAMES:
        interruption.check()
        frame = source.next(WAIT_S)
        taken_s = frame.monotonic_ns / 1e9 if frame and frame.monotonic_ns else time.monotonic()
        if frame and taken_s >= settled_s:
            frames.append(frame)
        elif time.monotonic() > until_s:
            raise UserError(f"the camera fell silent ({source.state}); check it")
    return seen_of(frames)


def seen_of(frames: list[Frame]) -> Seen:
    """The mean of frames."""
    radiance = np.stack([frame.radiance for frame in frames]).astype(np.float64).mean(axis=0)
    return Seen(radiance, frames[-1].coverage, max(frame.saturated for frame in frames), frames[-1].luminance_scale)


def _write(path: Path, found: Measured) -> None:
    old = write_measured(path, found.fixtures)
    click.echo(f"{path}: {len(found.fixtures) - len(found.unseen)} fixtures are as measured; the old file is {old}")
    click.echo(f"gain = {found.lx_per_unit:.4g} gives the light that this camera sees, as strong as it is")
    if found.unseen:
        click.echo(f"not seen, and as they were: {', '.join(found.unseen)}")
