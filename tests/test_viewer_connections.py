"""Connections of the page: which give way, and how long a request may take."""

import asyncio
import contextlib
import logging
from typing import Any

import pytest

from vemlight.runtime.log_lines import LogLines
from vemlight.viewer import connections
from vemlight.viewer.connections import Connection, Connections, LineHandler


class Transport(asyncio.Transport):
    """A connection from an address, which remembers whether it was ended."""

    def __init__(self, address: str) -> None:
        super().__init__({"peername": (address, 1)})
        self.ended = False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        if name == "socket":
            return self
        return super().get_extra_info(name, default)

    def setsockopt(self, *_: int) -> None:
        """Takes any option."""

    def is_closing(self) -> bool:
        return self.ended

    def abort(self) -> None:
        self.ended = True


def opened(site: Connections, address: str = "10.0.0.1") -> tuple[Connection, Transport]:
    connection, transport = site(), Transport(address)
    connection.connection_made(transport)
    return connection, transport


@pytest.fixture
def site(monkeypatch) -> Connections:
    monkeypatch.setattr(connections, "MAX_CONNECTIONS", 8)
    return Connections(asyncio.Protocol, LogLines())


def test_of_an_address_with_half_of_all_connections_the_oldest_without_a_request_gives_way(site):
    async def run() -> None:
        four = [opened(site) for _ in range(4)]
        with four[0][0].busy():
            _, fifth = opened(site)
            assert [transport.ended for _, transport in four] == [False, True, False, False]
            _, other = opened(site, "10.0.0.2")
            assert not fifth.ended
            assert not other.ended

    asyncio.run(run())


def test_when_all_are_busy_the_new_one_is_refused(site):
    async def run() -> None:
        four = [opened(site) for _ in range(4)]
        with contextlib.ExitStack() as all_busy:
            for connection, _ in four:
                all_busy.enter_context(connection.busy())
            assert opened(site)[1].ended
            assert not any(transport.ended for _, transport in four)
            with four[2][0].waiting():  # for the rest of its request
                assert not opened(site)[1].ended
            assert four[2][1].ended

    asyncio.run(run())


def test_all_addresses_together_have_a_limit(site):
    async def run() -> None:
        eight = [opened(site, f"10.0.0.{k // 2}") for k in range(8)]
        opened(site, "10.0.1.1")
        assert [transport.ended for _, transport in eight] == [True] + 7 * [False]

    asyncio.run(run())


def test_an_address_of_ipv6_counts_with_its_network(site):
    async def run() -> None:
        five = [opened(site, f"2001:db8::{k}") for k in range(5)]
        assert five[0][1].ended
        assert not opened(site, "2001:db8:0:1::1")[1].ended

    asyncio.run(run())


def test_a_request_that_does_not_come_ends_the_connection(site, monkeypatch):
    monkeypatch.setattr(connections, "HEADER_S", 0.05)
    monkeypatch.setattr(connections, "IDLE_S", 0.05)

    async def run() -> None:
        _, silent = opened(site)
        busy, working = opened(site)
        with busy.busy():
            await asyncio.sleep(0.15)
            assert silent.ended
            assert not working.ended
        await asyncio.sleep(0.15)
        assert working.ended

    asyncio.run(run())


def test_more_bytes_than_a_page_sends_end_the_connection(site, capsys):
    async def run() -> None:
        connection, transport = opened(site)
        connection.data_received(bytes(connections.BYTES_BURST))
        assert not transport.ended
        connection.data_received(bytes(connections.BYTES_BURST // 2))
        assert transport.ended

    asyncio.run(run())
    assert "more bytes than a page sends" in capsys.readouterr().err


def test_what_libraries_log_is_one_line_a_minute(capsys):
    logger = logging.getLogger("test of lines")
    logger.propagate = False
    logger.addHandler(LineHandler(LogLines()))
    for k in range(100):
        try:
            raise OSError(f"number {k}")
        except OSError:
            logger.exception("accept %d failed", k)
    assert capsys.readouterr().err == "vemlight: viewer: accept 0 failed: OSError('number 0')\n"
