"""Pictures as a video file that browsers and players show, each frame at its own time: H.264 where the FFmpeg at hand can write it."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError, of_setting
from vemlight.files import written_whole
from vemlight.settings import Settings

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv")
TICKS_PER_S = 90_000  # divisible by 24, 25, 30, 50 and 60 frames a second, and 3003 ticks are a frame of 30000/1001
MPEG4_TICKS_PER_S = 60_000  # of MPEG-4 part 2, which counts up to 65,535: the same rates divide it, and 2002 ticks are that frame
BACKGROUND = 40  # gray level, of 255, under pixels without alpha; any value in 20 .. 80 does
BT709, LIMITED_RANGE, SRGB_TRANSFER = 1, 1, 13  # ITU-T H.273: primaries and matrix; range (FFmpeg's number); IEC 61966-2-1


class VideoEncoder(NamedTuple):
    """name: FFmpeg's. shown: what it writes, and whose it is under which licence. options: for no visible loss."""

    name: str
    shown: str
    options: dict[str, str]
    suffixes: tuple[str, ...] = VIDEO_SUFFIXES
    ticks_per_s: int = TICKS_PER_S


# The first that this FFmpeg has and that takes the size: what more players show before what fewer do, and of two that write the same the
# one that no GPL binds. An FFmpeg without x264 is under the LGPL, and has one of the others. Quantisers of 14 .. 22 show no loss in H.264,
# and of 2 in MPEG-4.
ENCODERS = (
    VideoEncoder("libopenh264", "H.264 by OpenH264 (BSD)", {"qmin": "16", "qmax": "20", "profile": "high"}),
    VideoEncoder("libx264", "H.264 by x264 (GPL)", {"crf": "18"}),  # 0.1 to 0.3 bits a pixel
    VideoEncoder("libvpx-vp9", "VP9 by libvpx (BSD)", {"crf": "20", "b": "0", "cpu-used": "4"}, (".mp4", ".mkv")),
    VideoEncoder("mpeg4", "MPEG-4 by FFmpeg (LGPL)", {"qmin": "2", "qmax": "2"}, ticks_per_s=MPEG4_TICKS_PER_S),
)  # fmt: skip


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


def chosen_encoder(suffix: str, width: int, height: int) -> VideoEncoder:
    """The encoder for pictures of that size in a file with that suffix. Raises UserError when this FFmpeg has none."""
    suitable = [encoder for encoder in ENCODERS if suffix.lower() in encoder.suffixes]
    for encoder in suitable:
        if _opens(encoder, width, height):
            return encoder
    names = ", ".join(encoder.name for encoder in suitable)
    raise UserError(f"this FFmpeg writes no {suffix}: it has none of {names}; install PyAV (av) from its wheel")


def _opens(encoder: VideoEncoder, width: int, height: int) -> bool:
    from av.codec import CodecContext, codecs_available
    from av.error import FFmpegError

    if encoder.name not in codecs_available:
        return False
    try:
        codec: Any = CodecContext.create(encoder.name, "w")
        codec.width, codec.height, codec.pix_fmt, codec.time_base = width, height, "yuv420p", Fraction(1, encoder.ticks_per_s)
        codec.options = encoder.options
        codec.open()
    except (FFmpegError, ValueError):  # ValueError: it decodes only
        return False
    return True


@contextmanager
def video_writer(path: Path, fps: float) -> Iterator["VideoWriter"]:
    """Yields the writer of a video whose pictures are of one size; its `encoder` then says how it was written.

    fps: the rate in the header, and 1 / fps how long the last picture is shown. The file appears when it is whole, and not at all when
    the body raises or adds no picture. Raises OSError when the disk or the encoder refuses.
    """
    import av
    from av.error import FFmpegError

    check_video_path(path)
    logging.getLogger("libav").setLevel(logging.CRITICAL)  # the error that is raised says it
    with written_whole(path) as part:
        try:
            with av.open(str(part), "w", options={"movflags": "faststart"}) as container:
                writer = VideoWriter(container, path.suffix, Fraction(fps).limit_denominator(1001))
                yield writer
                if writer.encoder is None:
                    raise UserError(f"{path}: a video needs at least one picture; there is none")
                writer.finish()
        except FFmpegError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


class VideoWriter:
    """A video stream in a container of PyAV. encoder: None before the first picture."""

    def __init__(self, container: Any, suffix: str, rate: Fraction) -> None:
        self._container, self._suffix, self._rate = container, suffix, rate
        self._first_s, self._last_tick = 0.0, 0
        self._stream: Any = None
        self.encoder: VideoEncoder | None = None

    def add(self, pixels: np.ndarray, time_s: float) -> None:
        """Adds a picture, (height, width, 4) uint8, sRGB, straight alpha, at a time in seconds.

        An odd number of rows or columns is made even by repeating the last: the resolution of colour is halved. A picture that is not
        later than the one before is shown one tick after it.
        """
        import av

        height, width = pixels.shape[:2]
        even = np.pad(over_background(pixels), ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        tick = self._last_tick + 1
        if self.encoder is None:
            self.encoder = chosen_encoder(self._suffix, even.shape[1], even.shape[0])
            self._begin(self.encoder, even.shape[1], even.shape[0])
            self._first_s, tick = time_s, 0
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        ticks_per_s = self.encoder.ticks_per_s
        self._last_tick = max(round((time_s - self._first_s) * ticks_per_s), tick)
        frame.pts, frame.time_base = self._last_tick, Fraction(1, ticks_per_s)
        frame.duration = round(ticks_per_s / self._rate)
        self._container.mux(self._stream.encode(frame))

    def _begin(self, encoder: VideoEncoder, width: int, height: int) -> None:
        self._stream = self._container.add_stream(encoder.name, rate=self._rate, options=encoder.options)
        self._stream.pix_fmt, self._stream.time_base = "yuv420p", Fraction(1, encoder.ticks_per_s)
        self._stream.width, self._stream.height = width, height
        codec = self._stream.codec_context
        codec.time_base = Fraction(1, encoder.ticks_per_s)
        codec.color_primaries = codec.colorspace = BT709
        codec.color_trc, codec.color_range = SRGB_TRANSFER, LIMITED_RANGE

    def finish(self) -> None:
        """Writes what the encoder has delayed."""
        self._container.mux(self._stream.encode(None))


def over_background(pixels: np.ndarray) -> np.ndarray:
    """A picture (height, width, 4) uint8 with straight alpha over BACKGROUND, (height, width, 3) uint8."""
    alpha = pixels[..., 3:].astype(np.uint16)
    return ((pixels[..., :3] * alpha + BACKGROUND * (255 - alpha) + 127) // 255).astype(np.uint8)
