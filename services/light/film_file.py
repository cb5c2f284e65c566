"""Films: the pictures of a video file by number, as they were coded, with what the file says of their colours.

PyAV (FFmpeg's libraries) decodes. Only formats of single files are opened, because FFmpeg also plays lists of other files and of addresses,
which must not be chosen by who made the file.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

from vemlight.errors import UserError
from vemlight.files import check_regular, one_line
from vemlight.light.colour_tags import ColourTags, tags_from_numbers
from vemlight.light.image_limits import LIMITS

FILM_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mxf", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".ogv", ".flv", ".y4m")
MAX_VIDEO_BYTES = 2**40  # a day at 100 Mbit/s
# What films begin with: Matroska and WebM, AVI, Ogg, MPEG program streams, Flash, YUV4MPEG, transport streams (two kinds), MXF.
SIGNATURES = (b"\x1a\x45\xdf\xa3", b"RIFF", b"OggS", b"\0\0\1\xba", b"FLV", b"YUV4MPEG2", b"\x47", b"\0\0\0\0\x47", b"\x06\x0e\x2b\x34")
QUICKTIME_ATOMS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # .mp4 and .mov
DEMUXERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,ogg,mpeg,flv,live_flv,yuv4mpegpipe,mpegts,mxf"
MAX_FPS = 1000.0  # in a film's header; a higher rate is taken for damage. Any value in 300 .. 10,000 does
MAX_FRAMES = 2**23  # of a film, 93 hours at 25 a second: each takes 200 bytes of index
CUT_S = 0.5  # by which a film may end before the length that its header says: rounding is below 0.1; any value to 2 s does
STEREO = {1: "side-by-side", 2: "top-bottom"}  # FFmpeg's numbers


def check_film_kind(path: Path) -> None:
    """Raises UserError for a file that is missing, no regular file, or no film by its first bytes."""
    check_regular(path, MAX_VIDEO_BYTES)
    try:
        with open(path, "rb") as file:
            head = file.read(12)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    if not head.startswith(SIGNATURES) and head[4:8] not in QUICKTIME_ATOMS:
        raise UserError(f"{path}: is no video that can be played; convert it to .mp4, or name a folder of pictures")


class FilmIndex(NamedTuple):
    """Of all pictures in the order in which they are shown: their stamps in `time_base`, and which of them can be decoded first."""

    pts: list[int]
    is_key: list[bool]
    has_stamps: bool  # else the stamps are counted, and pictures are found by decoding from the first


class FilmFile:
    """A film's pictures, fast one after the other, slower in any order. size: width, height in pixels."""

    def __init__(self, path: Path) -> None:
        """Reads the film once to its end, without decoding it. Raises UserError for one that cannot be played or is cut off."""
        check_film_kind(path)
        self.path = path
        with _readable(path):
            self._index, rate, self._time_base = _indexed(path)
            self._open()
        self.fps = float(rate) if 0 < rate <= MAX_FPS else self._mean_rate()
        codec = self._stream.codec_context
        self.size = (int(codec.width), int(codec.height))
        self.is_still_codec = codec.name in ("mjpeg", "png")
        LIMITS.check(path, *self.size, 2**40)

    def __len__(self) -> int:
        return len(self._index.pts)

    def _mean_rate(self) -> float:
        seconds = self.time_s(len(self) - 1)
        fps = (len(self) - 1) / seconds if seconds > 0 else 0.0
        if not 0 < fps <= MAX_FPS:
            fault = f"plays {fps:g} frames a second, and up to {MAX_FPS:g} are read" if fps else "has no frame rate"
            raise UserError(f"{self.path}: {fault}; encode it at another rate")
        return fps

    def time_s(self, k: int) -> float:
        """When picture k is shown, in seconds after the first one."""
        return float((self._index.pts[k] - self._index.pts[0]) * self._time_base)

    def frame(self, k: int) -> Any:
        """Picture k of 0 .. len - 1 as an av.VideoFrame, the same each time. Raises UserError for a damaged one and for another size."""
        with _readable(self.path, f"frame {k}"):
            if k < self._next or self._key_before(k) > self._next:
                self._seek(self._key_before(k))
            found = self._until(k)
            if found is None:  # the container led behind it
                self._seek(0)
                found = self._until(k)
        if found is None or found.is_corrupt:
            raise UserError(f"{self.path}: frame {k} of {len(self)} is damaged; copy it again")
        if (found.width, found.height) != self.size:
            raise UserError(
                f"{self.path}: frame {k} is {found.width}x{found.height} and the film {self.size[0]}x{self.size[1]}; convert it"
            )
        return found

    def _open(self) -> None:
        self._container = _opened(self.path)
        self._stream = _video_stream(self.path, self._container)
        self._stream.thread_type = "AUTO"
        self._frames: Iterator[Any] = self._container.decode(self._stream)
        self._next = 0

    def _key_before(self, k: int) -> int:
        if not self._index.has_stamps:
            return 0
        return next((n for n in range(k, -1, -1) if self._index.is_key[n]), 0)

    def _seek(self, k: int) -> None:
        if k == 0 or not self._index.has_stamps:
            self.close()
            self._open()
            return
        self._container.seek(self._index.pts[k], stream=self._stream)
        self._frames = self._container.decode(self._stream)
        self._next = k

    def _until(self, k: int) -> Any | None:
        """Decodes to picture k; None where the film ends before it or goes on behind it."""
        stamp = self._index.pts[k]
        for frame in self._frames:
            at = frame.pts if self._index.has_stamps and frame.pts is not None else self._index.pts[self._next]
            self._next += 1
            if at == stamp:
                self._next = k + 1
                return frame
            if at > stamp:
                break
        self._next = len(self)
        return None

    def close(self) -> None:
        """Ends the decoder's threads."""
        self._container.close()


@contextmanager
def _readable(path: Path, what: str = "") -> Iterator[None]:
    """Makes a UserError of what FFmpeg says about a file."""
    import av.error

    try:
        yield
    except UserError:
        raise
    except (av.error.FFmpegError, OSError, ValueError, MemoryError, OverflowError) as error:
        reason = getattr(error, "strerror", "") or one_line(error)
        raise UserError(f"{path}: {what or 'the film'} cannot be played ({reason}); it may be cut off, copy or convert it again") from error


def _opened(path: Path) -> Any:
    import av

    limits = {"protocol_whitelist": "file", "format_whitelist": DEMUXERS, "max_pixels": str(LIMITS.pixels)}
    return av.open(str(path), options=limits, metadata_errors="replace")


def _video_stream(path: Path, container: Any) -> Any:
    import av.stream

    streams = [s for s in container.streams.video if not s.disposition & av.stream.Disposition.attached_pic]
    if not streams:
        if container.streams.audio:
            raise UserError(f"{path}: holds sound only; name a film with pictures")
        raise UserError(f"{path}: holds no pictures; it may be cut off, copy it again, or name a film")
    if streams[0].codec_context is None:
        raise UserError(f"{path}: is coded in a way that is not known here; convert it to .mp4")
    return streams[0]


def _indexed(path: Path) -> tuple[FilmIndex, Fraction, Fraction]:
    """The index of a film's pictures, their mean rate (0: not said) and the unit of their stamps in seconds."""
    with _opened(path) as container:
        stream = _video_stream(path, container)
        codec = stream.codec_context
        LIMITS.check(path, int(codec.width), int(codec.height), 2**40)
        pictures: list[tuple[int | None, bool]] = []
        last_s = 0.0
        for packet in container.demux():
            if packet.size == 0:
                continue
            at = packet.pts if packet.pts is not None else packet.dts
            if at is not None:
                last_s = max(last_s, float((at + (packet.duration or 0)) * packet.time_base))
            if packet.stream.index == stream.index and not packet.is_discard:
                pictures.append((packet.pts, packet.is_keyframe))
            if len(pictures) > MAX_FRAMES:
                raise UserError(f"{path}: has more than {MAX_FRAMES} pictures; cut it")
        start_s = (container.start_time or 0) / 1e6
        declared_s = (container.duration or 0) / 1e6
        if not pictures:
            raise UserError(f"{path}: holds no pictures; copy it again")
        if len(pictures) < stream.frames or last_s - start_s < declared_s - CUT_S:
            raise UserError(f"{path}: is cut off: {last_s - start_s:.1f} of {declared_s:.1f} s are there; copy it again")
        index, rate = _shown_order(pictures), stream.average_rate or Fraction(0)
        return index, rate, stream.time_base if index.has_stamps or not rate else 1 / rate


def _shown_order(pictures: list[tuple[int | None, bool]]) -> FilmIndex:
    stamps = [pts for pts, _ in pictures if pts is not None]
    if len(set(stamps)) < len(pictures):
        return FilmIndex(list(range(len(pictures))), [n == 0 for n in range(len(pictures))], False)
    shown = sorted((pts, key) for pts, key in pictures if pts is not None)
    return FilmIndex([pts for pts, _ in shown], [key for _, key in shown], True)


def film_tags(frame: Any) -> ColourTags:
    """What a decoded frame says of its colours; formats that were made for full range alone (yuvj420p) say that, too."""
    tags = tags_from_numbers(frame.color_trc, frame.color_primaries, frame.colorspace, frame.color_range)
    return tags._replace(range="full") if frame.format.name.startswith("yuvj") else tags


def film_stereo(frame: Any) -> str | None:
    """How pictures for two eyes lie in a frame, as the film says it: "side-by-side", "top-bottom", or None for one eye."""
    for data in frame.side_data:
        if data.type.name == "STEREO3D":
            return STEREO.get(int.from_bytes(bytes(data)[:4], "little"))
    return None
