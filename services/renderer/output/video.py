"""Pictures as a video file: H.264 that browsers and players show, each frame at its own time."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.errors import UserError, of_setting
from vemlight.files import written_whole
from vemlight.settings import Settings

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv")
TICKS_PER_S = 90_000  # divisible by 24, 25, 30, 50 and 60 frames a second, and 3003 ticks are a frame of 30000/1001
RATE_FACTOR = 18  # x264's constant rate factor: no visible loss at 0.1 to 0.3 bits a pixel; any value in 14 .. 22 does
BACKGROUND = 40  # gray level, of 255, under pixels without alpha; any value in 20 .. 80 does
BT709, LIMITED_RANGE, SRGB_TRANSFER = 1, 1, 13  # ITU-T H.273: primaries and matrix; range (FFmpeg's number); IEC 61966-2-1

AddPicture = Callable[[np.ndarray, float], None]


def check_video_path(path: Path) -> None:
    """Raises UserError unless a video can be written there."""
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise UserError(f"{path}: videos are written as {', '.join(VIDEO_SUFFIXES)}; change the suffix")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: there is no such folder; make it first")


def check_video_settings(settings: Settings) -> None:
    """Raises UserError for a video that no run with these settings can write."""
    if settings.renderer.video:
        with of_setting("[renderer] video"):
            check_video_path(Path(settings.renderer.video))
        if not settings.out:
            raise UserError("[renderer] video: is made of the pictures in the folder out, which is not set; set it, or use --out")


@contextmanager
def video_writer(path: Path, fps: float) -> Iterator[AddPicture]:
    """Yields a function that adds a picture, (height, width, 4) uint8, sRGB, straight alpha, at a time in seconds; all of one size.

    An odd number of rows or columns is made even by repeating the last: H.264 halves the resolution of colour. A picture that is not later
    than the one before is shown one tick after it. fps: the rate in the header, and 1 / fps how long the last picture is shown.
    The file appears when it is whole, and not at all when the body raises or adds no picture. Raises OSError when the disk or the
    encoder refuses.
    """
    import av
    from av.error import FFmpegError

    check_video_path(path)
    logging.getLogger("libav").setLevel(logging.CRITICAL)  # the error that is raised says it
    with written_whole(path) as part:
        try:
            with av.open(str(part), "w", options={"movflags": "faststart"}) as container:
                encoder = _Encoder(container, Fraction(fps).limit_denominator(1001))
                yield encoder.add
                if encoder.last_tick is None:
                    raise UserError(f"{path}: a video needs at least one picture; there is none")
                encoder.finish()
        except FFmpegError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


class _Encoder:
    """An H.264 stream in a container of PyAV. last_tick: of the newest picture, counted from the first one's time."""

    def __init__(self, container: Any, rate: Fraction) -> None:
        self._container, self._rate = container, rate
        self._stream: Any = container.add_stream("libx264", rate=rate, options={"crf": str(RATE_FACTOR)})
        self._stream.pix_fmt, self._stream.time_base = "yuv420p", Fraction(1, TICKS_PER_S)
        codec = self._stream.codec_context
        codec.time_base = Fraction(1, TICKS_PER_S)
        codec.color_primaries = codec.colorspace = BT709
        codec.color_trc, codec.color_range = SRGB_TRANSFER, LIMITED_RANGE
        self._first_s = 0.0
        self.last_tick: int | None = None

    def add(self, pixels: np.ndarray, time_s: float) -> None:
        import av

        height, width = pixels.shape[:2]
        even = np.pad(over_background(pixels), ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if self.last_tick is None:
            self._first_s = time_s
            self._stream.height, self._stream.width = even.shape[:2]
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        earliest = 0 if self.last_tick is None else self.last_tick + 1
        self.last_tick = max(round((time_s - self._first_s) * TICKS_PER_S), earliest)
        frame.pts, frame.time_base = self.last_tick, Fraction(1, TICKS_PER_S)
        frame.duration = round(TICKS_PER_S / self._rate)
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        """Writes what the encoder has delayed."""
        self._container.mux(self._stream.encode(None))


def over_background(pixels: np.ndarray) -> np.ndarray:
    """A picture (height, width, 4) uint8 with straight alpha over BACKGROUND, (height, width, 3) uint8."""
    alpha = pixels[..., 3:].astype(np.uint16)
    return ((pixels[..., :3] * alpha + BACKGROUND * (255 - alpha) + 127) // 255).astype(np.uint8)
