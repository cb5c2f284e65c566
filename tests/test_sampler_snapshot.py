"""The sampler's state on disk: a sampler that goes on from it makes the same lights, and what is damaged counts as absent."""

from pathlib import Path

import numpy as np
import pytest

from vemlight.journal import JournalPoint
from vemlight.light.bright_cells import BrightCells
from vemlight.runtime import stamps, wire
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.snapshot import SNAPSHOT_FRAMES, Snapshot, Snapshots, decoded, encoded
from vemlight.sampler.stage import SamplerStage
from vemlight.sampler.state import SamplerState, initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler, Settings

SETTINGS = (
    Sampler(count=12, gloss_lights=20, deflicker=True),
    Sampler(count=12, soft=True),
    Sampler(count=12, method="havran-azimuth", error_percent=20.0, clusters=6),
    Sampler(count=12, method="standard", filter="iir"),
)
KIND = tuple[Snapshot, ...]
NO_BRIGHT = BrightCells(np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))


def frame(k: int) -> SamplerInput:
    radiance = np.full((6, 24, 3), 1.0 + 0.3 * np.sin(k), np.float32)
    radiance[2, k % 24] = 100
    return SamplerInput(radiance, "hemisphere", k / 25, NO_BRIGHT)


def state_after(settings: Sampler, frames: int) -> SamplerState:
    state = initial_state()
    for k in range(frames):
        state, _, _ = step(settings, state, frame(k))
    return state


@pytest.mark.parametrize("settings", SETTINGS, ids=("tracked", "soft", "havran-azimuth", "standard"))
def test_lights_after_a_snapshot_are_the_same_to_the_bit(settings):
    going_on = state_after(settings, 12)
    (snapshot,) = decoded(encoded((Snapshot(JournalPoint(12, 1, ""), going_on),)), KIND)
    restarted = snapshot.state
    for k in range(12, 20):
        going_on, lights, _ = step(settings, going_on, frame(k))
        restarted, again, _ = step(settings, restarted, frame(k))
        assert [np.asarray(a).tobytes() for a in lights] == [np.asarray(b).tobytes() for b in again]


def test_the_newest_snapshot_before_a_frame_is_found_after_a_restart(tmp_path):
    snapshots, state = Snapshots(tmp_path / "s"), initial_state()
    for frames in (16, 32, 48):
        snapshots.add(Snapshot(JournalPoint(frames, 100 * frames, "c"), state))
    again = Snapshots(tmp_path / "s")
    assert [found and found.frames for found in map(again.before, (31, 32, 47, 48, 1000))] == [None, 32, 32, 48, 48]
    assert again.newest_end == JournalPoint(48, 4800, "c")


def test_a_snapshot_of_a_frame_that_is_made_again_replaces_later_ones(tmp_path):
    snapshots = Snapshots(tmp_path / "s")
    for frames in (32, 48, 16):
        snapshots.add(Snapshot(JournalPoint(frames, 0, ""), initial_state()))
    assert [found and found.frames for found in map(Snapshots(tmp_path / "s").before, (15, 48))] == [None, 16]


def test_a_damaged_snapshot_is_as_good_as_none(tmp_path):
    data, rng = encoded((Snapshot(JournalPoint(16, 0, ""), state_after(SETTINGS[0], 3)),)), np.random.default_rng(2)
    for _ in range(50):
        changed = bytearray(data)
        changed[rng.integers(len(data))] ^= 1 << rng.integers(8)
        with pytest.raises(ValueError, match="damaged"):
            decoded(bytes(changed), KIND)
    (tmp_path / "s").write_bytes(data[:-1])
    assert Snapshots(tmp_path / "s").before(100) is None


@pytest.mark.parametrize("array", [["<f8", [3], b"12345678"], ["<c16", [1], b"1234567812345678"], ["<f8", [-1, 10**12], b""], 5])
def test_arrays_that_cannot_be_are_refused(array):
    import hashlib

    import msgspec

    content = msgspec.msgpack.decode(encoded((Snapshot(JournalPoint(16, 0, ""), initial_state()),))[32:])
    content[0][1][7] = array  # the weights of lights that fade in
    data = msgspec.msgpack.encode(content)
    with pytest.raises(ValueError, match=r"."):  # each kind has its own text
        decoded(hashlib.sha256(data).digest() + data, KIND)


def map_message(k: int) -> wire.Message:
    header = wire.MapMessage(stamp=stamps.stamp(k, k / 25), rows=6, cols=24, coverage="hemisphere", bright_samples=0)
    return header, (frame(k).radiance, *NO_BRIGHT)


def test_a_restarted_sampler_begins_near_the_frame_that_is_missing(tmp_path):
    wanted = Settings(mode="lossless", out=str(tmp_path), sampler=Sampler(count=8))
    stage = SamplerStage(wanted)
    state, first = stage.start_at(0)
    assert first == 0
    written: dict[int, tuple[np.ndarray, ...]] = {}
    for k in range(3 * SNAPSHOT_FRAMES + 5):
        state, made = stage.step(state, map_message(k))
        stage.write(state, made)
        written[k] = made[1]
    stage._file.close()  # type: ignore[union-attr]
    again = SamplerStage(wanted)
    assert again.first_missing_frame() == 3 * SNAPSHOT_FRAMES + 5
    for target, begins in ((53, 48), (47, 32), (31, 0)):
        state, first = again.start_at(target)
        assert first == begins
        for k in range(first, target):
            state, made = again.step(state, map_message(k))
            assert [a.tobytes() for a in made[1]] == [b.tobytes() for b in written[k]]


def test_live_there_are_no_snapshots(tmp_path: Path):
    stage = SamplerStage(Settings(out=str(tmp_path), sampler=Sampler(count=8)))
    state, _ = stage.start_at(0)
    for k in range(SNAPSHOT_FRAMES):
        state, made = stage.step(state, map_message(k))
        stage.write(state, made)
    assert [path.name for path in tmp_path.iterdir()] == ["lights.jsonl"]
