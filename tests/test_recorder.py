"""Recording and replay."""

import errno
import threading
from pathlib import Path

import numpy as np
import pytest

from vemlight.capture import recorder as module
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.manifest import RecordingEnd, parsed_manifest, read_manifest
from vemlight.capture.recorder import Recorder
from vemlight.capture.recording import record
from vemlight.capture.response import Log, write_response
from vemlight.capture.source import open_source
from vemlight.errors import Interrupted, UserError
from vemlight.light.images import write_exr
from vemlight.settings import Capture

LENS = Lens(size=(64, 48), f=(17.0, 17.0), c=(31.5, 23.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)


def test_recorded_maps_replay_bit_for_bit(tmp_path: Path, sequence: Path) -> None:
    done = record(Capture(source=str(sequence), fps=12.0, rows=30, cols=90, record=str(tmp_path / "out")), frames=12)
    assert (done.written, done.dropped, done.failed) == (12, 0, 0)
    first = open_source(Capture(source=str(sequence), fps=12.0, rows=30, cols=90))
    again = open_source(Capture(source=str(tmp_path / "out"), rows=30, cols=90))
    assert (len(again), again.fps) == (12, 12.0)
    for k in range(12):
        assert again.frame(k).radiance.tobytes() == first.frame(k).radiance.tobytes()
        assert again.frame(k).time_s == first.frame(k).time_s


def test_recorded_maps_replay_with_their_metadata(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", Log(bits=12, a=0.0, b=300.0, c=1.0, luminance_scale=179.123))
    rng = np.random.default_rng(3)
    for k in range(3):
        codes = rng.integers(0, 900, (48, 64)).astype(np.float32)
        codes[20:23, 30 + k] = 4095  # a sun, cut by cells
        write_exr(tmp_path / f"f{k}.exr", codes, {"vemlight:kind": "codes", "vemlight:mosaic": "mono"})
    raw = open_source(Capture(source=str(tmp_path), rows=20, cols=40))
    record(Capture(source=str(tmp_path), rows=20, cols=40, record=str(tmp_path / "out")), frames=0)
    again = open_source(Capture(source=str(tmp_path / "out"), rows=20, cols=40))
    for k in range(3):
        one, two = raw.frame(k), again.frame(k)
        assert len(one.bright_cells.cells) > 1
        assert one.saturated > 0
        for a, b in zip((one.radiance, *one.bright_cells), (two.radiance, *two.bright_cells), strict=True):
            assert (a.dtype, a.tobytes()) == (b.dtype, b.tobytes())
        assert one[1:6] == two[1:6]  # coverage, time, scale, counts


@pytest.mark.parametrize("mosaic", ["mono", "RGGB"])
def test_recorded_codes_replay_to_the_same_maps(tmp_path: Path, mosaic) -> None:
    from vemlight.capture.frames import FrameMaker

    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", Log(bits=16, a=0.0, b=6000.0, c=1.0))
    maker = FrameMaker(Capture(rows=20, cols=40), tmp_path)
    recorder = Recorder(tmp_path / "out", calibration=maker.files)
    rng = np.random.default_rng(0)
    maps = []
    for k in range(3):
        codes = rng.integers(0, 65536, (48, 64)).astype(np.uint16)
        maps.append(maker.frame_from_codes("camera", codes, mosaic, 0.0).radiance)
        recorder.put(codes, {"vemlight:kind": "codes", "vemlight:mosaic": mosaic}, k, k / 25)
    recorder.close()
    again = open_source(Capture(source=str(tmp_path / "out"), rows=20, cols=40))
    assert [again.frame(k).radiance.tobytes() for k in range(3)] == [m.tobytes() for m in maps]


def test_a_slow_disk_drops_and_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()

    def slow(path: Path, pixels: np.ndarray, attributes: dict) -> None:
        gate.wait()
        write_exr(path, pixels, attributes)

    monkeypatch.setattr(module, "write_exr", slow)
    recorder = Recorder(tmp_path / "out")
    taken = [recorder.put(np.ones((4, 4), np.float32), {}, k, 0.0) for k in range(30)]
    gate.set()
    recorder.close()
    assert recorder.dropped == taken.count(False) > 0
    assert recorder.written == taken.count(True)
    assert 8 <= recorder.written <= 9  # those in the queue, and one that the thread may have in hand
    # what is missing is missing by number
    assert [e.sequence for e in read_manifest(tmp_path / "out")] == [k for k, ok in enumerate(taken) if ok]


def test_a_full_disk_is_reported_and_what_was_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, pixels: np.ndarray, attributes: dict) -> None:
        if 3 <= attributes["imageCounter"] < 6:
            raise OSError(errno.ENOSPC, "No space left on device")
        write_exr(path, pixels, attributes)

    monkeypatch.setattr(module, "write_exr", full)
    recorder = Recorder(tmp_path / "out")
    for k in range(8):
        while not recorder.put(np.full((16, 32, 3), k, np.float32), {}, k, k / 10):
            pass
    recorder.close()
    assert (recorder.written, recorder.failed) == (5, 3)
    assert "No space left on device" in recorder.last_error
    source = open_source(Capture(source=str(tmp_path / "out")))
    assert [source.frame(k).time_s for k in range(len(source))] == [0.0, 0.1, 0.2, 0.6, 0.7]


def test_a_frame_that_the_manifest_cannot_list_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "out")
    recorder.put_waiting(np.ones((16, 32, 3), np.float32), {}, 0, 0.0)
    while recorder.written == 0:
        pass

    def full(*_) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("vemlight.journal.os.pwrite", full)
        recorder.put_waiting(np.ones((16, 32, 3), np.float32), {}, 1, 0.1)
        while recorder.failed == 0:
            pass
    assert recorder.refusing
    assert not (tmp_path / "out" / "frame_000001.exr").exists()
    recorder.put_waiting(np.ones((16, 32, 3), np.float32), {}, 2, 0.2)
    recorder.close()
    assert not recorder.refusing
    assert [entry.sequence for entry in read_manifest(tmp_path / "out")] == [0, 2]


def test_recordings_are_not_mixed(tmp_path: Path, sequence: Path) -> None:
    settings = Capture(source=str(sequence), record=str(tmp_path / "out"))
    record(settings, frames=1)
    with pytest.raises(UserError, match="holds a recording already"):
        record(settings, frames=1)


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be recorded to"):
        Recorder(tmp_path / "file")


def test_start_end_and_speed(sequence: Path) -> None:
    whole = open_source(Capture(source=str(sequence), fps=10.0))
    part = open_source(Capture(source=str(sequence), fps=10.0, start=3, end=7, speed=2.0))
    assert (len(part), part.fps) == (4, 20.0)
    assert part.frame(1).radiance.tobytes() == whole.frame(4).radiance.tobytes()
    assert part.frame(1).time_s == pytest.approx(0.05)
    with pytest.raises(UserError, match="leave none"):
        open_source(Capture(source=str(sequence), start=16))


def test_speed_divides_the_times_of_a_recording(tmp_path: Path, sequence: Path) -> None:
    record(Capture(source=str(sequence), fps=10.0, rows=4, cols=8, record=str(tmp_path / "out")), frames=4)
    faster = open_source(Capture(source=str(tmp_path / "out"), rows=4, cols=8, speed=4.0))
    assert faster.fps == 40.0
    assert [faster.frame(k).time_s for k in range(4)] == pytest.approx([0.0, 0.025, 0.05, 0.075])


def test_frames_out_of_order_are_right(sequence: Path) -> None:
    source = open_source(Capture(source=str(sequence)))
    truth = [source.frame(k).radiance.tobytes() for k in range(len(source))]
    order = np.random.default_rng(0).integers(0, len(source), 20)
    assert [source.frame(int(k)).radiance.tobytes() for k in order] == [truth[k] for k in order]


def test_more_frames_than_there_are_to_record_is_said(tmp_path: Path, sequence: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = record(Capture(source=str(sequence), rows=4, cols=8, record=str(tmp_path / "out")), frames=20)
    assert done.written == 16
    assert "has 16 frames, not 20" in capsys.readouterr().err


def test_an_interrupted_recording_is_closed_and_says_how_many_frames_there_are(tmp_path: Path, sequence: Path, monkeypatch) -> None:
    put = Recorder.put_waiting

    def interrupted(recorder: Recorder, pixels: np.ndarray, attributes: dict, sequence: int, time_s: float) -> None:
        if sequence == 3:
            raise KeyboardInterrupt
        put(recorder, pixels, attributes, sequence, time_s)

    monkeypatch.setattr(Recorder, "put_waiting", interrupted)
    with pytest.raises(Interrupted, match="3 frames are in"):
        record(Capture(source=str(sequence), rows=4, cols=8, record=str(tmp_path / "out")), frames=0)
    assert parsed_manifest(tmp_path / "out").end == RecordingEnd(frames=3)
