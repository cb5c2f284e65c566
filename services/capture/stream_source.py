"""Streams of a network (HTTP, RTSP and others) as a camera: the newest picture wins, and a server that is gone is waited for."""

import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from vemlight.capture.film_source import PictureMaker
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.recorder import Recorder
from vemlight.capture.recording_attributes import map_attributes
from vemlight.errors import UserError
from vemlight.files import one_line
from vemlight.light.film_file import MAX_FPS
from vemlight.light.image_limits import LIMITS
from vemlight.settings import Capture
from vemlight.source_names import shown_source

OPEN_S = 10.0  # for a server to answer and to send its first picture; slow ones take 2 to 5 s to begin a group of pictures
SILENT_S = 5.0  # without a picture, after which the connection counts as lost; any value from 2 to 30 does
RETRY_S = 1.0  # between two tries to connect again; any value from 0.2 to 5 does
PROTOCOLS = "http,https,httpproxy,tcp,tls,udp,rtp,rtsp,rtsps,rtmp,rtmps,rtmpt,crypto"  # and no files, which a server must not choose
DEMUXERS = "mpjpeg,mjpeg,rtsp,rtp,mpegts,hls,mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,flv,live_flv,ogg"


class StreamPicture(NamedTuple):
    """A decoded picture. lost: those before it that were passed over."""

    picture: Any  # av.VideoFrame
    monotonic_ns: int  # of its arrival, on this host's clock
    lost: int
    is_still_codec: bool


class StreamReader:
    """Decodes a stream in a thread of its own and keeps the newest picture. `state` describes it, `outages` counts lost connections."""

    def __init__(self, address: str, default_fps: float) -> None:
        """Waits for the first picture. Raises UserError for a server that refuses, is not there, or sends none within OPEN_S."""
        self._address, self.name = address, shown_source(address)
        self.fps, self.outages, self.state = default_fps, 0, f"{self.name}: connecting"
        self._newest: StreamPicture | None = None
        self._failure: UserError | None = None
        self._came, self._closed, self._started = threading.Condition(), False, False
        self._thread = threading.Thread(target=self._read, name="stream", daemon=True)
        self._thread.start()
        with self._came:
            if self._came.wait_for(lambda: self._newest or self._failure, OPEN_S) and not self._failure:
                return
        self.close()
        raise self._failure or UserError(f"{self.name}: sent no picture within {OPEN_S:g} s; check the address and the server")

    def next(self, wait_s: float) -> StreamPicture | None:
        """The newest picture that was not taken yet, or None when none came within `wait_s`. Raises UserError for one of another size."""
        with self._came:
            self._came.wait_for(lambda: self._newest or self._failure, wait_s)
            if self._failure:
                raise self._failure
            taken, self._newest = self._newest, None
            return taken

    def close(self) -> None:
        """Lets the thread end; it may still wait for the server for SILENT_S, and is not waited for."""
        self._closed = True

    def _read(self) -> None:
        """Connects, decodes, and connects again, until closed. What fails before the first picture is a failure, afterwards an outage."""
        import av.error

        while not self._closed:
            try:
                self._decode()
                reason = "the server ended it"
            except UserError as error:
                self._fail(error)
                return
            except (av.error.FFmpegError, OSError, ValueError) as error:
                reason = getattr(error, "strerror", "") or one_line(error)
            if self._closed:
                return
            if not self._started:
                self._fail(UserError(f"{self.name}: cannot be played ({reason}); check the address, the name and password, and the server"))
                return
            self.outages += 1
            self.state = f"{self.name}: is gone ({reason}), outage {self.outages}; waiting for it"
            time.sleep(RETRY_S)

    def _fail(self, error: UserError) -> None:
        with self._came:
            self._failure = error
            self._came.notify_all()

    def _decode(self) -> None:
        import av

        options = {"fflags": "nobuffer", "rtsp_transport": "tcp", "protocol_whitelist": PROTOCOLS, "format_whitelist": DEMUXERS,
                   "max_pixels": str(LIMITS.pixels), "analyzeduration": "1000000"}  # fmt: skip
        with av.open(self._address, options=options, timeout=(OPEN_S, SILENT_S), metadata_errors="replace") as container:
            if not container.streams.video:
                raise UserError(f"{self.name}: sends no pictures; name a stream with pictures")
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"  # threads by frame would delay each picture by their number
            rate = float(stream.average_rate or 0)
            self.fps = rate if 0 < rate <= MAX_FPS else self.fps
            for picture in container.decode(stream):
                if self._closed:
                    return
                if picture.is_corrupt:
                    continue
                LIMITS.check(self.name, picture.width, picture.height, 2**40)
                self._put(picture, stream.codec_context.name in ("mjpeg", "png"))

    def _put(self, picture: Any, is_still_codec: bool) -> None:
        with self._came:
            lost = self._newest.lost + 1 if self._newest else 0
            self._newest = StreamPicture(picture, time.monotonic_ns(), lost, is_still_codec)
            self._started = True
            self.state = f"{self.name}: {picture.width}x{picture.height} {picture.format.name} at {self.fps:g} a second"
            self._came.notify_all()


class StreamSource:
    """A stream's pictures as they arrive, each made into a polar map of radiance, and recorded as such if the settings say so."""

    def __init__(self, settings: Capture) -> None:
        """Raises UserError for a stream, lens or response that cannot be used."""
        self._maker = FrameMaker(settings, Path.cwd())
        self._reader = StreamReader(settings.source, settings.fps)
        self._pictures = PictureMaker(settings, self._maker, self._reader.name)
        self.recorder: Recorder | None = None
        self.calibration: tuple[Path, ...] = ()  # maps are recorded, which need none
        self._first_ns: int | None = None
        self._count = 0
        try:  # computes the weights and compiles the loops before the first frame is due
            taken = self._reader.next(OPEN_S)
            assert taken is not None
            self._pictures.frame(taken.picture, 0.0, taken.is_still_codec)
            if settings.record:
                self.recorder = Recorder(Path(settings.record))
        except UserError:
            self._reader.close()
            raise

    @property
    def fps(self) -> float:
        """Pictures a second, as the stream says, or the settings."""
        return self._reader.fps

    @property
    def state(self) -> str:
        """For a log: what the stream sends, that it is gone, or why nothing is recorded."""
        return self.recorder.last_error if self.recorder and self.recorder.refusing else self._reader.state

    @property
    def unrecorded(self) -> int:
        """Frames that were to be recorded and are not, because the disk was full or too slow."""
        return self.recorder.failed + self.recorder.dropped if self.recorder else 0

    def next(self, wait_s: float) -> Frame | None:
        """The next frame, or None when none came within `wait_s`; `state` then says why. Raises UserError for one of another size."""
        taken = self._reader.next(wait_s)
        if taken is None:
            return None
        self._first_ns = taken.monotonic_ns if self._first_ns is None else self._first_ns
        self._count += taken.lost + 1
        time_s = (taken.monotonic_ns - self._first_ns) / 1e9
        frame = self._pictures.frame(taken.picture, time_s, taken.is_still_codec)
        if self.recorder:
            self.recorder.put(frame.radiance, map_attributes(frame, self.fps), self._count - 1, time_s)
        return frame._replace(lost=taken.lost, monotonic_ns=taken.monotonic_ns)

    def close(self) -> None:
        """Ends the connection and the recording."""
        self._reader.close()
        if self.recorder:
            self.recorder.close()
