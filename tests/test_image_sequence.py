"""The folder of a run's pictures: its manifest after a crash, its contact sheet, and the rate of its video."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.runtime import wire


def add(writer: ImageSequenceWriter, sequence: int, level: int = 90, width: int = 64, height: int = 48) -> None:
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., :3] = level
    writer.add(np.zeros((height, width, 4), np.float32), pixels, wire.stamp(sequence, sequence / 25), Adaptation(sequence))


def test_a_half_written_line_is_removed_and_the_next_picture_takes_its_place(tmp_path):
    writer = ImageSequenceWriter(tmp_path)
    add(writer, 0)
    add(writer, 1)
    manifest = tmp_path / "manifest.jsonl"
    whole = manifest.read_bytes()
    manifest.write_bytes(whole[:-20])
    writer = ImageSequenceWriter(tmp_path)
    assert writer.count == 1
    assert writer.last is not None
    assert writer.last.adaptation == Adaptation(0)
    add(writer, 1)
    again = manifest.read_bytes()
    assert again.count(b"\n") == 2
    assert again.split(b"\n")[0] == whole.split(b"\n")[0]
    assert ImageSequenceWriter(tmp_path).count == 2


def test_another_programs_manifest_is_left_alone(tmp_path):
    (tmp_path / "manifest.jsonl").write_text('{"name": "a.exr"}\n')
    with pytest.raises(UserError, match=r"manifest\.jsonl: is no manifest of pictures"):
        ImageSequenceWriter(tmp_path)


@pytest.mark.parametrize(
    ("count", "columns", "rows", "shown"),
    [(1, 1, 1, [0]), (4, 4, 1, [0, 1, 2, 3]), (7, 6, 2, list(range(7))), (24, 6, 4, list(range(24))), (70, 6, 4, range(0, 70, 3))],
)
def test_a_contact_sheet_has_up_to_24_pictures_six_to_a_row(tmp_path: Path, count, columns, rows, shown):
    writer = ImageSequenceWriter(tmp_path)
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
    writer = ImageSequenceWriter(tmp_path)
    add(writer, 0)
    writer.write_video(tmp_path / "video.mp4")
    with av.open(str(tmp_path / "video.mp4")) as container:
        assert container.streams.video[0].average_rate == 25


def test_a_picture_that_was_removed_is_named(tmp_path):
    writer = ImageSequenceWriter(tmp_path)
    add(writer, 0)
    (tmp_path / "frame_0000.png").unlink()
    with pytest.raises(UserError, match=r"frame_0000\.png: cannot be read back"):
        writer.write_contact_sheet()
