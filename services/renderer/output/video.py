"""Pictures as a video file: H.264 that browsers and players show, in its frames' own time."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.errors import UserError
from vemlight.files import written_whole

SUFFIXES = (".mp4", ".mov", ".mkv")
TICKS = 90_000  # a second: 24, 25, 30, 50 and 60 frames a second divide it, and 30000/1001 too
QUALITY = 18  # of x264 (constant rate factor): no difference is seen, 0.1 to 0.3 bits a pixel
GROUND = 40  # gray, of 255, where a picture shows nothing
BT709, MPEG_RANGE, SRGB_TRANSFER = 1, 1, 13  # ITU-T H.273: primaries and matrix; limited range (FFmpeg's number); IEC 61966-2-1

Add = Callable[[np.ndarray, float], None]


def check_video_path(path: Path) -> None:
    """Raises UserError unless a video can be written there."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: videos are written as {', '.join(SUFFIXES)}; change the suffix")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: there is no such folder; make it first")


@contextmanager
def video(path: Path, fps: float) -> Iterator[Add]:
    """Yields a function that adds a picture, (height, width, 4) uint8, sRGB, alpha straight, at a time in seconds; all of one size.

    A side of an odd number of pixels gets its last row or column twice: H.264 halves the resolution of colour. A picture that is not later
    than the one before follows it after the shortest time that there is. fps: what the header says, and how long the last picture stays.
    Written whole; nothing is left when the body raises or adds no picture. Raises OSError when the disk or the encoder refuses.
    """
    import av
    from av.error import FFmpegError

    check_video_path(path)
    logging.getLogger("libav").setLevel(logging.CRITICAL)  # the error that is raised says it
    rate = Fraction(fps).limit_denominator(1001)
    with written_whole(path) as part:
        try:
            with av.open(str(part), "w", options={"movflags": "faststart"}) as container:
                stream: Any = container.add_stream("libx264", rate=rate, options={"crf": str(QUALITY)})
                stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, TICKS)
                stream.codec_context.time_base = Fraction(1, TICKS)
                stream.codec_context.color_primaries = stream.codec_context.colorspace = BT709
                stream.codec_context.color_trc, stream.codec_context.color_range = SRGB_TRANSFER, MPEG_RANGE
                begun: list[tuple[float, int]] = []  # the first picture's time and the newest one's tick

                def add(pixels: np.ndarray, time_s: float) -> None:
                    even = np.pad(on_ground(pixels), ((0, pixels.shape[0] % 2), (0, pixels.shape[1] % 2), (0, 0)), mode="edge")
                    if not begun:
                        begun.append((time_s, -1))
                        stream.height, stream.width = even.shape[:2]
                    first_s, last = begun[0]
                    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
                    frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
                    frame.pts, frame.time_base = max(round((time_s - first_s) * TICKS), last + 1), Fraction(1, TICKS)
                    frame.duration = round(TICKS / rate)
                    begun[0] = (first_s, frame.pts)
                    container.mux(stream.encode(frame))

                yield add
                if not begun:
                    raise UserError(f"{path}: a video needs a picture at least; there is none")
                container.mux(stream.encode(None))
        except FFmpegError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


def on_ground(pixels: np.ndarray) -> np.ndarray:
    """A picture (height, width, 4) uint8 with straight alpha over GROUND, (height, width, 3) uint8."""
    alpha = pixels[..., 3:].astype(np.uint16)
    return ((pixels[..., :3] * alpha + GROUND * (255 - alpha) + 127) // 255).astype(np.uint8)
