"""Videos decode back: every picture, in its time, in its colours; a video that was not finished is not there."""

from pathlib import Path

import av
import numpy as np
import pytest
from av.codec import codecs_available

from tests.support.gltf_files import AnimatedTriangle
from vemlight.commands.options import RenderOptions
from vemlight.commands.rendering import write_pictures
from vemlight.errors import UserError
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.renderer.output.video import BACKGROUND, ENCODERS, VideoEncoder, chosen_encoder, over_background, video_writer
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import stamps
from vemlight.settings import Renderer, Settings


def decoded(path: Path, codec: str = "h264") -> tuple[list[np.ndarray], list[float], float]:
    """Pictures (h, w, 3) uint8, their times, and the rate in the header."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == codec
        assert stream.codec_context.pix_fmt == "yuv420p"
        frames = list(container.decode(video=0))
        assert stream.average_rate is not None
        pictures = [frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray() for frame in frames]
        return pictures, [float(frame.time or 0) for frame in frames], float(stream.average_rate)


def flat(width: int, height: int, colour: tuple[int, int, int], alpha: int = 255) -> np.ndarray:
    return np.broadcast_to(np.array([*colour, alpha], np.uint8), (height, width, 4))


COLOURS = [(200, 60, 30), (20, 180, 90), (128, 128, 128), (0, 0, 0), (255, 255, 255), (40, 60, 220)]


@pytest.mark.parametrize(("width", "height"), [(64, 48), (63, 47), (1, 1), (64, 47)])
@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_all_pictures_come_back_in_their_colours(tmp_path, width, height, suffix):
    with video_writer(tmp_path / f"video.{suffix}", 25.0) as video:
        for k, colour in enumerate(COLOURS):
            video.add(flat(width, height, colour), k / 25)
    pictures, times, rate = decoded(tmp_path / f"video.{suffix}")
    assert [picture.shape for picture in pictures] == len(COLOURS) * [(height + height % 2, width + width % 2, 3)]
    assert times == pytest.approx([k / 25 for k in range(len(COLOURS))], abs=1e-3)  # Matroska counts milliseconds
    assert rate == pytest.approx(25, abs=0.3)
    for picture, colour in zip(pictures, COLOURS, strict=True):
        assert np.abs(picture.astype(int) - colour).max() <= 6  # 8 bits of luma and colour difference, and the encoder


def test_frames_keep_their_own_times(tmp_path):
    shown_s = [7.0, 7.04, 7.2, 7.2, 7.1, 9.0]  # a gap, one twice, one back
    with video_writer(tmp_path / "video.mp4", 25.0) as video:
        for time_s in shown_s:
            video.add(flat(32, 32, (50, 100, 150)), time_s)
    _, times, _ = decoded(tmp_path / "video.mp4")
    assert times == pytest.approx([0, 0.04, 0.2, 0.2, 0.2, 2.0], abs=1e-4)
    assert np.all(np.diff(times) > 0)


def test_odd_rates_last_to_the_frame(tmp_path):
    fps = 30000 / 1001
    with video_writer(tmp_path / "video.mp4", fps) as video:
        for k in range(90):
            video.add(flat(16, 16, (k, 100, 150)), k / fps)
    pictures, times, rate = decoded(tmp_path / "video.mp4")
    assert len(pictures) == 90
    assert rate == pytest.approx(fps, rel=1e-3)
    assert times == pytest.approx(np.arange(90) / fps, abs=1e-9)  # to the tick: a frame is 3003 of them


def test_what_shows_nothing_is_the_backgrounds_gray(tmp_path):
    with video_writer(tmp_path / "video.mp4", 25.0) as video:
        video.add(flat(32, 32, (255, 0, 0), alpha=0), 0.0)
    assert np.abs(decoded(tmp_path / "video.mp4")[0][0].astype(int) - BACKGROUND).max() <= 3


def test_half_transparent_colours_are_rounded_over_the_background():
    # (255 * 128 + 40 * 127) / 255 = 147.9 and (40 * 127) / 255 = 19.9
    assert over_background(np.array([[[255, 0, 0, 128]]], np.uint8)).tolist() == [[[148, 20, 20]]]


def test_a_video_that_was_not_finished_is_not_there(tmp_path):
    def interrupted():
        with video_writer(tmp_path / "video.mp4", 25.0) as video:
            video.add(flat(32, 32, (9, 9, 9)), 0.0)
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_no_picture_no_video(tmp_path):
    with pytest.raises(UserError, match="needs at least one picture"), video_writer(tmp_path / "video.mp4", 25.0):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("encoder", "codec", "suffix"),
    [("libvpx-vp9", "vp9", "mp4"), ("libvpx-vp9", "vp9", "mkv"), *(("mpeg4", "mpeg4", suffix) for suffix in ("mp4", "mov", "mkv"))],
)
def test_without_x264_a_freely_licensed_encoder_keeps_colours_and_times(tmp_path, monkeypatch, encoder, codec, suffix):
    """What an FFmpeg under the LGPL has; VP9 is no part of .mov."""
    missing = {one.name for one in ENCODERS[: [one.name for one in ENCODERS].index(encoder)]}
    monkeypatch.setattr("av.codec.codecs_available", codecs_available - missing)
    fps = 30000 / 1001
    with video_writer(tmp_path / f"video.{suffix}", fps) as video:
        for k, colour in enumerate(COLOURS):
            video.add(flat(63, 47, colour), k / fps)
    assert video.encoder is not None
    assert video.encoder.name == encoder
    pictures, times, _ = decoded(tmp_path / f"video.{suffix}", codec)
    assert times == pytest.approx([k / fps for k in range(len(COLOURS))], abs=1e-3)  # Matroska counts milliseconds
    for picture, colour in zip(pictures, COLOURS, strict=True):
        assert picture.shape == (48, 64, 3)
        assert np.abs(picture.astype(int) - colour).max() <= 6


@pytest.mark.parametrize("encoder", [one.name for one in ENCODERS if one.name in codecs_available])
def test_every_encoder_shows_no_loss(tmp_path, monkeypatch, encoder):
    """Fine detail, 32 levels of contrast over a smooth sky, comes back at 40 dB or better."""
    monkeypatch.setattr("vemlight.renderer.output.video.ENCODERS", [one for one in ENCODERS if one.name == encoder])
    y, x = np.mgrid[:96, :128]
    gray = 120 + 60 * np.sin(x / 40) + 16 * np.sign(np.sin(x / 3) * np.sin(y / 3))
    picture = np.concatenate([np.repeat(gray[..., None], 3, axis=-1), np.full((96, 128, 1), 255)], axis=-1).round().astype(np.uint8)
    with video_writer(tmp_path / "video.mp4", 25.0) as video:
        for k in range(5):
            video.add(np.roll(picture, k, axis=1), k / 25)
    with av.open(str(tmp_path / "video.mp4")) as container:
        shown = [frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray() for frame in container.decode(video=0)]
    errors = [np.mean((one.astype(float) - np.roll(picture[..., :3], k, axis=1)) ** 2) for k, one in enumerate(shown)]
    assert 10 * np.log10(255**2 / max(errors)) > 40


def test_h264_comes_first_and_of_two_that_write_it_the_freer(monkeypatch):
    there: set[str] = set()
    monkeypatch.setattr("vemlight.renderer.output.video._opens", lambda encoder, *_: encoder.name in there)
    with pytest.raises(UserError, match=r"no \.mov: it has none of libopenh264, libx264, mpeg4; install"):
        chosen_encoder(".mov", 64, 48)
    for better in ("mpeg4", "libvpx-vp9", "libx264", "libopenh264"):
        there.add(better)
        assert chosen_encoder(".mp4", 64, 48).name == better


def test_an_encoder_that_does_not_open_is_passed_over(monkeypatch):
    """None takes a picture without pixels, and FFmpeg only reads VC-1."""
    assert chosen_encoder(".mp4", 64, 48).name in ("libopenh264", "libx264")
    with pytest.raises(UserError, match="none of"):
        chosen_encoder(".mp4", 0, 0)
    assert "vc1" in codecs_available
    monkeypatch.setattr("vemlight.renderer.output.video.ENCODERS", (VideoEncoder("vc1", "VC-1", {}), ENCODERS[-1]))
    assert chosen_encoder(".mp4", 64, 48) == ENCODERS[-1]


@pytest.mark.parametrize("name", ["video.avi", "video", "nowhere/video.mp4"])
def test_where_no_video_can_be_is_one_line(tmp_path, name):
    with pytest.raises(UserError) as caught, video_writer(tmp_path / name, 25.0):
        pass
    assert "\n" not in str(caught.value)


def test_an_image_sequence_becomes_a_video_though_its_writer_was_started_again(tmp_path):
    def add(writer: ImageSequenceWriter, sequence: int) -> None:
        picture = np.full((36, 47, 4), sequence / 10, np.float32)
        writer.add(picture, flat(47, 36, (20 * sequence, 90, 200)), stamps.stamp(sequence, sequence / 24), Adaptation())

    wanted = Settings(mode="lossless", out=str(tmp_path / "out"))
    writer = ImageSequenceWriter(wanted)
    for sequence in range(5):
        add(writer, sequence)
    writer.close()
    writer = ImageSequenceWriter(wanted)
    for sequence in range(writer.count, 9):
        add(writer, sequence)
    writer.write_video(tmp_path / "video.mp4")
    pictures, times, rate = decoded(tmp_path / "video.mp4")
    assert len(pictures) == 9
    assert rate == pytest.approx(24, rel=1e-3)
    assert times == pytest.approx(np.arange(9) / 24, abs=1e-4)
    assert [abs(int(picture[5, 5, 0]) - 20 * k) <= 6 for k, picture in enumerate(pictures)] == 9 * [True]


def test_a_video_without_pictures_to_make_it_of_is_refused(tmp_path):
    with pytest.raises(UserError, match="set it, or use --out"):
        RendererStage(Settings(renderer=Renderer(video=str(tmp_path / "video.mp4"))))


def test_the_command_renders_a_sequence_to_a_video_in_which_animations_play(tmp_path, sequence):
    AnimatedTriangle(scale=[2.0, 2.0, 2.0]).move(1, "translation", [0, 0.5], [[0, 1, 0], [1, 1, 0]]).write(tmp_path / "animated.gltf")
    camera = "[camera]\nfrom = [0.0, -7.0, 4.0]\nat = [0.0, 0.0, 1.0]\n"
    (tmp_path / "scene.toml").write_text(camera + '[[mesh]]\nfile = "animated.gltf"\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n')
    scene, video = tmp_path / "scene.toml", tmp_path / "video.mp4"
    write_pictures(RenderOptions(source=sequence, scene=scene, size=(32, 24), count=4, fps=10.0, video=video))
    pictures, times, rate = decoded(tmp_path / "video.mp4")
    assert len(pictures) == 16
    assert times == pytest.approx(np.arange(16) / 10, abs=1e-4)
    assert rate == pytest.approx(10)
    # it goes to and comes back after 5 frames: its place, not its light
    shapes = [np.abs(picture.astype(int) - BACKGROUND).max(axis=-1) > 30 for picture in pictures]
    # its edge pixels, 4 of 768, are lit a little differently; moved by three frames 41 change
    assert np.mean(shapes[1] != shapes[6]) < 0.01 < 0.03 < np.mean(shapes[1] != shapes[4])
