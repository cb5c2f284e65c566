"""The feeds on their way to pages: one frame for all, one message of a feed on its way to each, nothing piles up."""

import asyncio
import struct
from typing import cast

import pytest

from vemlight.viewer import broadcast
from vemlight.viewer.broadcast import BINARY, TEXT, Broadcast, Reader, websocket_frame
from vemlight.viewer.feeds import Condition, Feed


class Wire:
    """A transport: keeps what is written, and how much of it waits."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.waits = 0

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def is_closing(self) -> bool:
        return False

    def get_write_buffer_size(self) -> int:
        return self.waits


def reader_of(wire: Wire, *feeds: str, stalled=lambda: None) -> Reader:
    return Reader(cast(asyncio.WriteTransport, wire), feeds, stalled)


async def settled() -> None:
    for _ in range(20):
        await asyncio.to_thread(int)  # as frames are encoded: late where those are
        await asyncio.sleep(0.002)


class Site:
    """A broadcast of two feeds whose frames are numbers, in a running loop."""

    def __init__(self) -> None:
        changed = Condition()
        self.encoded: list[object] = []
        self.a, self.b = Feed(self._encode, changed), Feed(self._encode, changed)
        self.broadcast = Broadcast({"a": self.a, "b": self.b}, {"b": 7}, {"b"}, changed)

    def _encode(self, frame: int) -> bytes:
        self.encoded.append(frame)
        return str(int(frame)).encode()

    def run(self, steps) -> None:
        async def whole() -> None:
            self.broadcast.start()
            try:
                await steps(self)
            finally:
                self.broadcast.stop()

        asyncio.run(whole())


def test_a_frame_is_one_message_for_all_pages():
    async def steps(site: Site) -> None:
        wires = [Wire() for _ in range(5)]
        site.b.put(1)
        for wire in wires:
            site.broadcast.add(reader_of(wire, "a", "b"))
        await settled()
        assert [wire.written for wire in wires] == 5 * [[bytes([0x82, 2, 7]) + b"1"]]
        assert site.encoded == [1]
        assert len({id(wire.written[0]) for wire in wires}) == 1

    Site().run(steps)


def test_a_page_gets_one_of_each_feed_until_it_asks_and_then_the_newest():
    async def steps(site: Site) -> None:
        wire = Wire()
        reader = reader_of(wire, "a")
        site.broadcast.add(reader)
        for frame in range(5):
            site.a.put(frame)
            await settled()
        assert wire.written == [b"\x81\x010"]
        site.broadcast.ask(reader, "a")
        await settled()
        assert wire.written[1:] == [b"\x81\x014"]
        site.broadcast.ask(reader, "a")  # nothing newer yet
        site.broadcast.ask(reader, "a")
        await settled()
        assert len(wire.written) == 2
        site.a.put(5)
        await settled()
        assert wire.written[2:] == [b"\x81\x015"]
        assert site.encoded == [0, 4, 5]

    Site().run(steps)


def test_nothing_is_encoded_that_nobody_waits_for():
    async def steps(site: Site) -> None:
        reader = reader_of(Wire(), "a")
        site.a.put(0)
        site.b.put(0)
        site.broadcast.add(reader)
        await settled()
        site.broadcast.remove(reader)
        site.a.put(1)
        await settled()
        assert site.encoded == [0]

    Site().run(steps)


def test_a_frame_that_cannot_be_encoded_does_not_end_its_feed():
    async def steps(site: Site) -> None:
        wire, other = Wire(), Wire()
        reader = reader_of(wire, "a")
        site.broadcast.add(reader)
        site.broadcast.add(reader_of(other, "b"))
        for frame in (0, None, None, 3):  # of which None is no number
            site.a.put(frame)
            site.b.put(1)
            await settled()
            site.broadcast.ask(reader, "a")
            await settled()
        assert wire.written == [b"\x81\x010", b"\x81\x013"]
        assert site.encoded.count(None) == 2, "each is tried once"
        assert other.written, "others go on"

    Site().run(steps)


def test_a_page_that_comes_late_gets_what_the_others_have():
    async def steps(site: Site) -> None:
        site.a.put(3)
        wires = Wire(), Wire()
        for wire in wires:
            site.broadcast.add(reader_of(wire, "a"))
            await settled()
        assert [wire.written for wire in wires] == 2 * [[b"\x81\x013"]]
        assert site.encoded == [3]

    Site().run(steps)


def test_who_takes_nothing_is_ended_and_the_others_go_on(monkeypatch):
    monkeypatch.setattr(broadcast, "LOOK_S", 0.01)
    monkeypatch.setattr(broadcast, "STALL_S", 0.05)

    async def steps(site: Site) -> None:
        ended, stuck, well = [], Wire(), Wire()
        stuck.waits = 100
        readers = [reader_of(wire, "a", stalled=lambda wire=wire: ended.append(wire)) for wire in (stuck, well)]
        for reader in readers:
            site.broadcast.add(reader)
        await asyncio.sleep(0.2)
        assert ended == [stuck]
        site.a.put(1)
        await settled()
        assert (len(stuck.written), len(well.written)) == (0, 1)

    Site().run(steps)


@pytest.mark.parametrize(
    ("length", "head"),
    [
        (0, b"\x81\x00"),
        (125, b"\x81\x7d"),
        (126, b"\x81\x7e\x00\x7e"),
        (65_535, b"\x81\x7e\xff\xff"),
        (65_536, b"\x81\x7f" + struct.pack(">Q", 65_536)),
    ],
)
def test_frames_of_rfc_6455(length, head):
    assert websocket_frame(TEXT, b"x" * length) == head + b"x" * length
    assert websocket_frame(BINARY, b"", b"x" * length)[0] == 0x82
