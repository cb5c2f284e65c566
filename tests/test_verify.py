"""`vemlight verify`: every changed bit, cut line and missing file of a recording and of a run's output is found."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import lights_from
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.manifest import ManifestWriter
from vemlight.capture.recorder import Recorder
from vemlight.capture.response import Log, write_response
from vemlight.commands.verify import verify
from vemlight.errors import UserError
from vemlight.light.light_set import LightsFile
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.runtime import stamps
from vemlight.settings import Settings

FRAMES = 4
LENS = Lens(size=(64, 48), f=(17.0, 17.0), c=(31.5, 23.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    write_lens(folder / "lens.toml", LENS)
    write_response(folder / "response.toml", Log(bits=12, a=0.0, b=300.0, c=1.0))
    recorder = Recorder(folder / "out", calibration=(folder / "lens.toml", folder / "response.toml"))
    for k in range(FRAMES):
        recorder.put_waiting(np.full((8, 12), k, np.float32), {}, k, k / 25)
    recorder.close()
    return folder / "out"


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    lights, writer = LightsFile(folder / "lights.jsonl", True), ImageSequenceWriter(Settings(mode="lossless", out=str(folder)))
    for k in range(FRAMES):
        lights.append(lights_from([[0, 0, 1]]), k, k / 25, "hemisphere")
        writer.add(np.full((6, 8, 4), k, np.float32), np.full((6, 8, 4), k, np.uint8), stamps.stamp(k, k / 25), Adaptation(k))
    writer.complete()
    writer.close()
    lights.close()
    return folder


@pytest.fixture(params=["recording", "output"])
def folder(request, tmp_path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(request.getfixturevalue(request.param), tmp_path / "copy"))


def found(folder: Path) -> bool:
    try:
        return bool(verify(folder).findings)
    except UserError:
        return True


def test_what_was_written_is_whole(folder):
    findings, summary = verify(folder)
    assert findings == []
    assert summary in ("4 frames, lens.toml, response.toml", "4 pictures, their lights and what belongs to them")


def test_every_flipped_bit_is_found(folder):
    files, rng = sorted(folder.iterdir()), np.random.default_rng(1)
    for file in files:
        data = file.read_bytes()
        for bit in rng.integers(0, 8 * len(data), 25):
            changed = bytearray(data)
            changed[bit // 8] ^= 1 << bit % 8
            file.write_bytes(changed)
            assert found(folder), f"{file.name}: bit {bit}"
        file.write_bytes(data)
    assert not found(folder)


def test_every_missing_file_is_found(folder):
    for file in sorted(folder.iterdir()):
        file.rename(folder / "away")
        assert found(folder), file.name
        (folder / "away").rename(file)


def test_a_manifest_that_was_cut_is_found_wherever(folder):
    manifest = folder / "manifest.jsonl"
    data = manifest.read_bytes()
    for length in range(0, len(data), 7):
        manifest.write_bytes(data[:length])
        assert found(folder), length
    lines = data.splitlines(keepends=True)
    for k in range(len(lines)):
        manifest.write_bytes(b"".join(lines[:k] + lines[k + 1 :]))
        assert found(folder), k


def test_a_folder_that_was_cut_off_is_called_incomplete(folder):
    manifest = folder / "manifest.jsonl"
    manifest.write_bytes(b"".join(manifest.read_bytes().splitlines(keepends=True)[:-1]))
    (finding,) = verify(folder).findings
    assert "is incomplete" in finding
    assert "4 " in finding


def test_what_was_written_beside_the_frames_is_checked_too(tmp_path):
    frame, truth = tmp_path / "f.exr", tmp_path / "truth.jsonl"
    frame.write_text("pixels")
    truth.write_text("truth")
    writer = ManifestWriter(tmp_path, [])
    writer.add(frame, 0, 0.0)
    writer.close((truth,))
    assert not found(tmp_path)
    truth.write_text("truce")
    assert found(tmp_path)


def test_a_pipe_in_place_of_a_frame_is_found_at_once(folder):
    frame = next(folder.glob("*.exr"))
    frame.unlink()
    os.mkfifo(frame)
    assert found(folder)


def test_a_manifest_without_chain_says_what_it_cannot_show(recording, tmp_path):
    shutil.copytree(recording, tmp_path / "old")
    lines = (tmp_path / "old" / "manifest.jsonl").read_bytes().splitlines()
    plain = [line[: line.index(b',"chain"')] + b"}\n" for line in lines[1:-1]]
    (tmp_path / "old" / "manifest.jsonl").write_bytes(b"".join(plain))
    findings, summary = verify(tmp_path / "old")
    assert findings == []
    assert "no chain" in summary


def test_a_folder_without_manifest_is_one_line(tmp_path):
    with pytest.raises(UserError, match="name the folder of a recording"):
        verify(tmp_path)
