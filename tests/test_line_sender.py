"""Lines to a reader over tcp: whole, in order, the newest for a slow one, and again when it comes back."""

import socket
import time

from vemlight.exchange import line_sender
from vemlight.exchange.line_sender import LineSender

PATIENCE_S = 20.0


def listener(port: int = 0) -> socket.socket:
    return socket.create_server(("127.0.0.1", port))


def sent(sender: LineSender) -> None:
    """Until nothing waits."""
    until = time.monotonic() + PATIENCE_S
    while sender.waiting and time.monotonic() < until:
        sender.send()
        time.sleep(0.001)


def test_a_reader_that_keeps_up_gets_every_line():
    with listener() as server:
        sender = LineSender("127.0.0.1", server.getsockname()[1])
        sender.offer(b"first\n")
        reader, _ = server.accept()
        for k in range(100):
            sender.offer(b"%d\n" % k)
            sent(sender)
        sender.close()
        received = b"".join(iter(lambda: reader.recv(4096), b""))
        reader.close()
    assert received == b"first\n" + b"".join(b"%d\n" % k for k in range(100))
    assert sender.passed_over == 0


def test_a_slow_reader_gets_whole_lines_and_then_the_newest():
    with listener() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sender = LineSender("127.0.0.1", server.getsockname()[1])
        for k in range(300):
            sender.offer(b"%04d" % k + b"x" * 20_000 + b"\n")
        reader, _ = server.accept()
        received = b""
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until and not received.endswith(b"0299" + b"x" * 20_000 + b"\n"):
            reader.settimeout(0.01)
            try:
                received += reader.recv(65536)
            except TimeoutError:
                sender.send()
        reader.close()
        sender.close()
    lines = received.splitlines()
    assert all(len(line) == 20_004 for line in lines)
    numbers = [int(line[:4]) for line in lines]
    assert numbers == sorted(numbers)
    assert numbers[-1] == 299
    assert sender.passed_over == 300 - len(numbers) > 200  # the kernel kept a few, nobody a queue


def test_a_reader_that_comes_back_begins_with_a_whole_line(monkeypatch, capfd):
    monkeypatch.setattr(line_sender, "RETRY_S", 0.01)
    with listener() as server:
        port = server.getsockname()[1]
    sender = LineSender("127.0.0.1", port)
    sender.offer(b"nobody\n")
    assert "nobody takes the lines (Connection refused); trying again each second" in capfd.readouterr().err
    time.sleep(0.02)
    with listener(port) as server:
        sender.offer(b"one\n")
        reader, _ = server.accept()
        assert reader.recv(100) == b"one\n"
        reader.close()
        until = time.monotonic() + PATIENCE_S
        server.settimeout(0.05)
        while time.monotonic() < until:
            sender.offer(b"two\n")
            try:
                again, _ = server.accept()
            except TimeoutError:
                continue
            assert again.recv(4) == b"two\n"
            again.close()
            break
        else:
            raise AssertionError("did not come back")
    sender.close()
    assert "connected" in capfd.readouterr().err
