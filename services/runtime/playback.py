"""Where a source of files stands, and what the person at the viewer makes it do: play, pause, seek, loop, other speeds, in and out points.

Pure: the clock is passed in. Stamps follow the clock of playing, not that of the recording: the stamp of each frame is later than the one
before by the interval at which they are due, whatever is played. A jump is said by `segment`, which counts them.
"""

from typing import NamedTuple

from vemlight.runtime import wire


class Playback(NamedTuple):
    """frames, fps: of the source. sequence: number of the next frame to publish. cursor: the frame of the source that it shows, with the
    fraction that a speed like 1.5 leaves. segment: jumps so far. first, last: the range that is played. seek_number: of the last seek.
    since, since_s: the number and time from which frames have been due at the present rate.
    """

    frames: int
    fps: float
    sequence: int = 0
    cursor: float = 0.0
    segment: int = 0
    first: int = 0
    last: int = 0
    speed: float = 1.0
    loop: bool = True
    paused: bool = False
    seek_number: int | None = None
    since: int = 0
    since_s: float = 0.0

    @staticmethod
    def start(frames: int, fps: float, sequence: int = 0, time_s: float = 0.0, segment: int = 0) -> "Playback":
        """From the first frame on; it is number `sequence`, due at `time_s`."""
        begin = Playback(frames, fps, sequence=sequence, segment=segment, last=frames - 1)
        return begin._replace(since=sequence, since_s=time_s)

    @property
    def index(self) -> int:
        """The frame of the source that is due."""
        return int(self.cursor)

    @property
    def rate_hz(self) -> float:
        """Frames published a second: slow motion shows each for longer, and a higher speed passes over some."""
        return self.fps if self.paused else self.fps * min(self.speed, 1.0)

    @property
    def time_s(self) -> float:
        """When the next frame is due: its stamp."""
        return self.since_s + (self.sequence - self.since) / self.rate_hz

    @property
    def is_whole(self) -> bool:
        """Whether all frames are in the range."""
        return self.first == 0 and self.last == self.frames - 1

    @property
    def at_end(self) -> bool:
        """Whether the last frame stands because nothing follows it."""
        return not self.loop and self.index >= self.last

    def obeying(self, control: wire.ControlMessage) -> "Playback":
        """The same after a control message. A seek has a number and is followed once, however often the message comes."""
        last = self.frames - 1
        first = self._frame(control.in_s, 0)
        after = self._replace(
            first=first,
            last=max(first, self._frame(control.out_s, last)),
            speed=control.speed or 1.0,
            loop=control.loop is not False,
            paused=control.paused,
        )
        if after.rate_hz != self.rate_hz:
            after = after._replace(since=self.sequence, since_s=self.time_s)
        if control.seek_number is None or control.seek_number == self.seek_number:
            return after
        after = after._replace(seek_number=control.seek_number)
        wanted = self._frame(control.seek_s, 0)
        return after if wanted == self.index else after._replace(cursor=float(wanted), segment=self.segment + 1)

    def after(self, published: int) -> "Playback":
        """The same when so many frames were published or have passed."""
        moved = self._replace(sequence=self.sequence + published)
        if self.paused or self.at_end:
            return moved
        inside = self.first <= self.index <= self.last
        cursor = self.cursor + published * max(self.speed, 1.0) if inside else float(self.first)
        segment = self.segment + (not inside)
        if int(cursor) > self.last:
            span = self.last - self.first + 1
            cursor = self.first + (cursor - self.first) % span if self.loop else float(self.last)
            segment += self.loop and not self.is_whole and span > 1
        return moved._replace(cursor=cursor, segment=segment)

    def in_step(self) -> "Playback":
        """At the frame that the number says, where several sources show one moment; paused as it is."""
        return self if self.paused else self._replace(cursor=float(self.sequence % self.frames))

    def _frame(self, at_s: float | None, default: int) -> int:
        return default if at_s is None else min(round(at_s * self.fps), self.frames - 1)
