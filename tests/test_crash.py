"""A run that dies at any of its calls to the system is resumed to the same bytes, and nothing half is left."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import lights_from
from vemlight.journal import JOURNAL_START
from vemlight.light.light_set import LightsFile
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.runtime import stamps
from vemlight.runtime.output_folder import SNAPSHOTS, claimed_output
from vemlight.sampler.snapshot import Snapshot, Snapshots
from vemlight.sampler.state import initial_state
from vemlight.settings import Settings

CALLS = ("pwrite", "fsync", "ftruncate", "replace", "unlink", "open")
FRAMES = 2


class Dead(BaseException):
    """The process is killed: from then on no call of it has an effect, not even those that would tidy up."""


class Killer:
    """Lets the first `calls` calls to the system pass. `torn`: the call at which it dies writes half of its bytes."""

    def __init__(self, calls: int, torn: bool) -> None:
        self.left, self._torn = calls, torn

    def instead_of(self, name: str):
        real = getattr(os, name)

        def call(*arguments, **options):
            self.left -= 1
            if self.left == -1 and self._torn and name == "pwrite":
                real(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2], arguments[2])
            if self.left < 0:
                raise Dead
            return real(*arguments, **options)

        return call


def write_run(settings: Settings) -> None:
    """What the services of a run do, from where it ended to its end."""
    with claimed_output(settings, overwrite=False) as complete:
        if complete:
            return
        out = Path(settings.out)
        snapshots = Snapshots(out / SNAPSHOTS)
        lights, writer = LightsFile(out / "lights.jsonl", True, snapshots.newest_end), ImageSequenceWriter(settings)
        assert writer.count <= lights.count <= FRAMES  # a picture has lights before it
        for k in range(FRAMES):
            if k >= lights.count:
                lights.append(lights_from([0, 0, 1], float(k)), k, k / 25, "hemisphere")
                snapshots.add(Snapshot(lights.end, initial_state()))
            if k >= writer.count:
                picture = np.full((4, 4, 4), k, np.float32)
                writer.add(picture, picture.astype(np.uint8), stamps.stamp(k, k / 25), Adaptation(k))
        writer.complete()
        writer.close()
        lights.close()


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("torn", [False, True], ids=["between", "torn"])
def test_a_run_that_dies_at_any_call_is_resumed_to_the_same_bytes(tmp_path, torn):
    write_run(Settings(mode="lossless", out=str(tmp_path / "whole")))
    expected = content(tmp_path / "whole")
    for calls in itertools.count():
        settings = Settings(mode="lossless", out=str(tmp_path / str(calls)))
        killer = Killer(calls, torn)
        with pytest.MonkeyPatch.context() as patch:
            for name in CALLS:
                patch.setattr(os, name, killer.instead_of(name))
            try:
                write_run(settings)
            except Dead:
                pass
            else:
                break
        write_run(settings)
        assert content(Path(settings.out)) == expected, f"killed at call {calls}"
    assert calls > 20 * FRAMES, "the calls were not counted"


def test_a_snapshot_that_is_ahead_of_the_lights_is_not_trusted(tmp_path):
    """As after a power failure that took the lights' last lines and not the snapshot."""
    settings = Settings(mode="lossless", out=str(tmp_path / "out"))
    write_run(settings)
    lights = tmp_path / "out" / "lights.jsonl"
    snapshots = Snapshots(tmp_path / "out" / SNAPSHOTS)
    reopened = LightsFile(lights, True)
    snapshots.add(Snapshot(reopened.end, initial_state()))
    reopened.close()
    lines = lights.read_bytes().splitlines(keepends=True)
    lights.write_bytes(b"".join(lines[:-1]))
    again = LightsFile(lights, True, snapshots.newest_end)
    assert again.count == FRAMES - 1
    assert again.end != JOURNAL_START
