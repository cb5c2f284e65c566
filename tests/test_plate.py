"""The second camera: pictures of a video or a folder, in any order, paired with the lights of the same time."""

import os

import cv2
import msgspec
import numpy as np
import pytest

from tests.support.processes import wait_until
from vemlight.errors import UserError
from vemlight.plate.stage import PlateSource
from vemlight.plate.video_source import checked_size, open_video_source
from vemlight.runtime import stamps, wire
from vemlight.runtime.demand import Supply
from vemlight.runtime.instances import Input
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.sync import Lockstep, NearestInTime
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Plate
from vemlight.settings_file import read_settings

SIZE = 64, 48
FRAMES = 12
PLATE = Input("plate", "plate")


def gray_of(k: int) -> int:
    return 20 + 15 * k  # far enough apart for a codec that loses detail


@pytest.fixture(scope="module")
def video_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("plate") / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 24.0, SIZE)
    for k in range(FRAMES):
        writer.write(np.full((SIZE[1], SIZE[0], 3), gray_of(k), np.uint8))
    writer.release()
    return path


def test_a_videos_pictures_come_in_any_order(video_file):
    video = open_video_source(video_file, fps=1.0)
    assert (len(video), video.fps) == (FRAMES, 24.0)
    for k in (0, 1, 2, 7, 3, 11, 0):
        assert abs(video.picture(k).mean() - gray_of(k)) < 3, k


def test_a_folders_pictures_have_rgb_and_the_settings_rate(tmp_path):
    red = np.zeros((3, 4, 3), np.uint8)
    red[..., 2] = 250  # OpenCV writes BGR
    cv2.imwrite(str(tmp_path / "b.png"), red)
    cv2.imwrite(str(tmp_path / "a.png"), 0 * red)
    video = open_video_source(tmp_path, fps=5.0)
    assert (len(video), video.fps) == (2, 5.0)
    assert video.picture(1)[0, 0].tolist() == [250, 0, 0]


def test_what_is_no_video_is_one_clear_line(tmp_path, video_file):
    (tmp_path / "empty").mkdir()
    (tmp_path / "noise.mp4").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / "cut.avi").write_bytes(video_file.read_bytes()[:60])
    (tmp_path / "short.avi").write_bytes(video_file.read_bytes()[: video_file.stat().st_size * 2 // 3])
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(40))
    for name in ("missing", "empty", "noise.mp4", "cut.avi", "short.avi"):
        with pytest.raises(UserError, match=name.partition(".")[0]):
            open_video_source(tmp_path / name, 25.0)
    with pytest.raises(UserError, match=r"a\.png"):
        open_video_source(tmp_path / "pictures", 25.0).picture(0)


@pytest.mark.parametrize(("height", "width", "fits"), [(1, 8192, True), (1, 8193, False), (8192, 2730, True), (8192, 2731, False)])
def test_a_picture_larger_than_a_message_is_refused(height, width, fits):
    pixels = np.broadcast_to(np.uint8(7), (height, width, 3))  # a side is 8192 pixels at most, all bytes 2^26
    if fits:
        assert checked_size(pixels, "here").shape == (height, width, 3)
    else:
        with pytest.raises(UserError, match=f"^here: has {width} x {height} pixels"):
            checked_size(pixels, "here")


def test_after_its_end_a_video_starts_again(video_file):
    source = PlateSource(Plate(source=str(video_file)))
    assert source.limit is None
    header, (pixels,) = source.message(FRAMES + 2, 2, 0.0)
    assert isinstance(header, wire.PlateMessage)
    assert (header.stamp.sequence, header.width, header.height) == (FRAMES + 2, *SIZE)
    assert abs(pixels.mean() - gray_of(2)) < 3


@pytest.fixture
def transport(make_settings):
    opened = Transport(make_settings()[0].wire)
    yield opened
    opened.close()


def plate(sequence: int, monotonic_ns: int) -> wire.Message:
    stamp = msgspec.structs.replace(stamps.stamp(sequence, 0.0), monotonic_ns=monotonic_ns)
    return wire.PlateMessage(stamp=stamp, width=1, height=1), (np.full((1, 1, 3), sequence, np.uint8),)


def test_live_the_picture_nearest_in_time_is_taken(transport):
    publisher = transport.bind("plate", "publish")
    nearest, stats = NearestInTime(transport), ServiceStats("renderer", 0)
    lights = msgspec.structs.replace(stamps.stamp(90, 0.0), monotonic_ns=1_000_000)
    assert nearest.frames_at(lights, [PLATE], stats) == []
    wait_until(lambda: publisher.poll(0) or None, "the subscription")
    accept_subscriptions(publisher)
    for sequence, at_ns in ((1, 700_000), (2, 1_100_000), (3, 1_300_000)):
        publisher.send_multipart(wire.pack(*plate(sequence, at_ns)))
    wait_until(lambda: nearest.frames_at(lights, [PLATE], stats) and len(nearest._subscriptions[PLATE][1]) == 3, "three pictures")
    assert [array[0, 0, 0] for _, (array,) in nearest.frames_at(lights, [PLATE], stats)] == [2]
    assert nearest.frames_at(lights, [], stats) == []
    wait_until(lambda: publisher.poll(0) or None, "the end of the subscription")


def test_lossless_the_frames_of_one_number_come_together(transport):
    supplies = {name: Supply(transport.bind(name, "serve"), ServiceStats(name, 0)) for name in ("sampler", "plate")}
    inputs = Lockstep(transport, [Input("sampler", "plate"), PLATE], ServiceStats("renderer", 0))
    seen = []

    def served() -> bool:
        for name, supply in supplies.items():
            supply.earliest_requested()
            ready = 5 if name == "plate" else 3  # the lights of frame 3 are not made yet
            supply.send(lambda k, ready=ready: plate(k, 0) if k < ready else None, end=None)
        if frames := inputs.frames(len(seen)):
            seen.append([header.stamp.sequence for header, _ in frames if isinstance(header, wire.FrameHeader)])
        return len(seen) == 3

    wait_until(served, "three pairs")
    assert seen == [[0, 0], [1, 1], [2, 2]]
    assert len(inputs.awaited()) == 2
    inputs.frames(3)
    wait_until(lambda: served() and len(inputs.awaited()) == 1, "the picture without its lights")
    inputs.restart()
    assert len(inputs.awaited()) == 2


def test_the_service_sends_what_is_asked_for(make_settings, services, video_file):
    _, path = make_settings(mode="lossless", plate={"source": str(video_file)})
    settings = read_settings(path)
    assert settings.services[-1] == "plate"
    services.start("vemlight.plate", str(path))
    transport = Transport(settings.wire)
    try:
        inputs, seen = Lockstep(transport, [PLATE], ServiceStats("renderer", 0)), []

        def came() -> bool:
            if frames := inputs.frames(FRAMES - 2 + len(seen)):
                seen.extend(array.mean() for _, (array,) in frames)
            return len(seen) == 4

        wait_until(came, "four pictures")
    finally:
        transport.close()
    np.testing.assert_allclose(seen, [gray_of(k) for k in (FRAMES - 2, FRAMES - 1, 0, 1)], atol=3)


def test_without_a_second_camera_none_runs(make_settings):
    assert make_settings()[0].services == ("capture", "sampler", "renderer", "viewer")


def test_a_camera_cannot_be_replayed(make_settings):
    with pytest.raises(UserError, match="/dev/video1 is a camera"):
        make_settings(mode="lossless", plate={"source": "/dev/video1"})


@pytest.mark.parametrize("name", ["list.mp4", "list.m3u8"])
def test_a_list_of_other_files_is_no_video(tmp_path, video_file, name):
    (tmp_path / name).write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{video_file}\n#EXT-X-ENDLIST\n")
    with pytest.raises(UserError, match="is no video that can be played"):
        open_video_source(tmp_path / name, 25.0)


def test_a_pipe_is_no_video(tmp_path):
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(UserError, match="is not a regular file"):
        open_video_source(tmp_path / "pipe.mp4", 25.0)
