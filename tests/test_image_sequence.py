"""The folder of a run's pictures: its manifest after a crash, its contact sheet, and the rate of its video."""

import errno
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.runtime import stamps
from vemlight.settings import Mode, Settings


def opened(folder: Path, mode: Mode = "lossless") -> ImageSequenceWriter:
    return ImageSequenceWriter(Settings(mode=mode, out=str(folder)))


def add(writer: ImageSequenceWriter, sequence: int, level: int = 90, width: int = 64, height: int = 48) -> None:
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., :3] = level
    writer.add(np.zeros((height, width, 4), np.float32), pixels, stamps.stamp(sequence, sequence / 25), Adaptation(sequence))


def kept(folder: Path) -> int:
    """How many pictures a renderer that was restarted finds there."""
    writer = opened(folder)
    writer.close()
    return writer.count


@pytest.fixture
def four_pictures(tmp_path) -> Path:
    writer = opened(tmp_path)
    for k in range(4):
        add(writer, k)
    writer.close()
    return tmp_path


def test_a_half_written_line_is_removed_and_the_next_picture_takes_its_place(four_pictures):
    manifest = four_pictures / "manifest.jsonl"
    whole = manifest.read_bytes()
    manifest.write_bytes(whole[:-20])
    writer = opened(four_pictures)
    assert writer.count == 3
    assert writer.last is not None
    assert writer.last.adaptation == Adaptation(2)
    add(writer, 3)
    assert manifest.read_bytes() == whole


def test_a_picture_counts_as_long_as_its_files_are_what_was_written(four_pictures):
    (four_pictures / "frame_0003.png").unlink()
    assert kept(four_pictures) == 3
    exr = bytearray((four_pictures / "frame_0001.exr").read_bytes())
    exr[-1] ^= 1
    (four_pictures / "frame_0001.exr").write_bytes(exr)
    assert kept(four_pictures) == 1


@pytest.mark.parametrize("file", ["contact.png", "lights.jsonl"])
def test_a_complete_run_is_completed_again_when_a_file_beside_the_pictures_has_changed(four_pictures, file):
    (four_pictures / "lights.jsonl").write_text("")
    writer = opened(four_pictures)
    writer.complete()
    writer.close()
    complete = (four_pictures / "manifest.jsonl").read_bytes()
    assert opened(four_pictures)._manifest.end
    (four_pictures / file).write_text("else")
    assert opened(four_pictures)._manifest.end is None
    writer = opened(four_pictures)
    (four_pictures / "lights.jsonl").write_text("")
    writer.complete()
    assert (four_pictures / "manifest.jsonl").read_bytes() == complete


def test_a_full_disk_leaves_nothing_of_a_picture_and_the_next_one_is_written(four_pictures, monkeypatch):
    writer = opened(four_pictures)
    before = sorted(four_pictures.iterdir()), (four_pictures / "manifest.jsonl").read_bytes()

    def full(*_) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for place in ("vemlight.renderer.output.image_sequence.write_png", "vemlight.journal.os.fsync"):
        with monkeypatch.context() as patch:
            patch.setattr(place, full)
            with pytest.raises(OSError, match="No space"):
                add(writer, 4)
        assert (sorted(four_pictures.iterdir()), (four_pictures / "manifest.jsonl").read_bytes()) == before
    add(writer, 4)
    writer.close()
    assert kept(four_pictures) == 5


def test_a_source_that_counts_from_0_again_overwrites_no_picture(tmp_path):
    writer = opened(tmp_path, mode="live")
    for sequence in (0, 1, 5, 0, 1):
        add(writer, sequence)
    assert sorted(path.stem for path in tmp_path.glob("*.exr")) == [f"frame_{k:04d}" for k in (0, 1, 5, 6, 7)]


def test_another_programs_manifest_is_left_alone(tmp_path):
    manifest = tmp_path / "manifest.jsonl"
    manifest.write_text('{"name": "a.exr"}\n')
    with pytest.raises(UserError, match=r"manifest\.jsonl: was not written by a run"):
        opened(tmp_path)
    assert manifest.read_text() == '{"name": "a.exr"}\n'


def test_two_renderers_cannot_write_to_one_folder(four_pictures):
    writer = opened(four_pictures)
    with pytest.raises(UserError, match="another run writes there"):
        opened(four_pictures)
    writer.close()


@pytest.mark.parametrize(
    ("count", "columns", "rows", "shown"),
    [(1, 1, 1, [0]), (4, 4, 1, [0, 1, 2, 3]), (7, 6, 2, list(range(7))), (24, 6, 4, list(range(24))), (70, 6, 4, range(0, 70, 3))],
)
def test_a_contact_sheet_has_up_to_24_pictures_six_to_a_row(tmp_path: Path, count, columns, rows, shown):
    writer = opened(tmp_path)
    for sequence in range(count):
        add(writer, sequence, level=60 + 2 * sequence)
    writer.write_contact_sheet()
    sheet = cv2.imread(str(tmp_path / "contact.png"))
    assert sheet is not None
    assert sheet.shape == (rows * 240, columns * 320, 3)  # 64 x 48 becomes 320 x 240, so a full row has 1920 pixels
    levels = sheet[120::240, 160::320, 0].reshape(-1)
    assert levels[: len(shown)].tolist() == [60 + 2 * sequence for sequence in shown]
    assert set(levels[len(shown) :].tolist()) <= {40}


def test_a_video_of_one_picture_has_25_frames_a_second(tmp_path):
    writer = opened(tmp_path)
    add(writer, 0)
    writer.write_video(tmp_path / "video.mp4")
    with av.open(str(tmp_path / "video.mp4")) as container:
        assert container.streams.video[0].average_rate == 25


def test_a_picture_that_was_removed_is_named(tmp_path):
    writer = opened(tmp_path)
    add(writer, 0)
    (tmp_path / "frame_0000.png").unlink()
    with pytest.raises(UserError, match=r"frame_0000\.png: cannot be read back"):
        writer.write_contact_sheet()
