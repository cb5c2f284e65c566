"""Newest-only feeds: encoded once for all, and never when nobody asks."""

import asyncio

from vemlight.viewer.feeds import Condition, Feed


class Encoder:
    def __init__(self) -> None:
        self.encoded: list[int] = []

    def __call__(self, frame: int) -> bytes:
        self.encoded.append(frame)
        return str(frame).encode()


def test_a_frame_that_cannot_be_encoded_is_said_once_and_passed_over():
    async def run() -> None:
        tried: list[int] = []

        def encode(frame: int) -> bytes:
            tried.append(frame)
            if frame % 2:
                raise ValueError(f"no {frame}\x1b")
            return str(frame).encode()

        feed = Feed(encode, Condition())
        for frame, newest, failure in [
            (2, (1, b"2"), ""),
            (3, (1, b"2"), "ValueError: no 3 "),
            (5, (1, b"2"), "ValueError: no 5 "),
            (6, (4, b"6"), ""),
        ]:
            feed.put(frame)
            assert [await feed.newest(), await feed.newest()] == [newest, newest]
            assert feed.failure == failure
        assert tried == [2, 3, 5, 6]
        waiting = asyncio.create_task(feed.after(4))
        for frame in (7, 8):
            feed.put(frame)
            await asyncio.sleep(0.05)
        assert await waiting == (6, b"8")

    asyncio.run(run())


def test_a_frame_is_encoded_once_for_any_number_of_readers():
    async def run() -> None:
        encode = Encoder()
        feed = Feed(encode, Condition())
        assert await feed.newest() == (0, b"")
        for frame in range(10):
            feed.put(frame)
        assert encode.encoded == []
        assert await asyncio.gather(*(feed.newest() for _ in range(20))) == [(10, b"9")] * 20
        assert encode.encoded == [9]

    asyncio.run(run())


def test_after_waits_for_a_later_frame_and_gives_the_newest():
    async def run() -> None:
        feed = Feed(Encoder(), Condition())
        feed.put(1)
        assert await feed.after(0) == (1, b"1")
        waiting = asyncio.gather(*(feed.after(1) for _ in range(3)))
        await asyncio.sleep(0)
        feed.put(2)
        feed.put(3)
        assert await waiting == [(3, b"3")] * 3

    asyncio.run(run())


def test_a_condition_notified_after_wait_was_called_ends_that_wait():
    async def run() -> None:
        condition = Condition()
        waiting = condition.wait()
        condition.notify()
        notified = asyncio.ensure_future(waiting)
        await asyncio.wait({notified}, timeout=5)
        assert notified.done()

    asyncio.run(run())


def test_a_frame_that_comes_while_another_is_encoded_is_not_lost():
    async def run() -> None:
        feed = Feed(lambda frame: str(frame).encode(), Condition())
        feed.put(1)
        first = asyncio.create_task(feed.newest())
        await asyncio.sleep(0)
        feed.put(2)
        assert await first == (1, b"1")
        assert await feed.newest() == (2, b"2")

    asyncio.run(run())
