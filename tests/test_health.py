"""The health check takes the status of the service that it asks about, and nothing else."""

import threading
from contextlib import contextmanager

import pytest
import zmq

from vemlight.runtime import health, wire
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings, Wire


@pytest.fixture
def settings(tmp_path):
    return Settings(wire=Wire(folder=str(tmp_path / "s")))


@contextmanager
def publishing(settings, *messages):
    """A sampler's publisher that repeats these messages."""
    stop, ready = threading.Event(), threading.Event()

    def publish():
        transport = Transport(settings.wire)
        publisher = transport.bind("sampler", "publish")
        ready.set()
        while not stop.wait(0.02):
            accept_subscriptions(publisher)
            for parts in messages:
                publisher.send_multipart(parts, zmq.NOBLOCK)
        transport.close()

    thread = threading.Thread(target=publish)
    thread.start()
    assert ready.wait(10)
    try:
        yield
    finally:
        stop.set()
        thread.join()


def status(service):
    header = ServiceStats(service, 0).status_if_due()
    assert header
    return wire.pack(header)


def test_a_status_is_health(settings, capsys):
    with publishing(settings, status("sampler")):
        health.check_health(settings, "sampler")
    assert capsys.readouterr().out == "vemlight: sampler: no frame yet\n"


@pytest.mark.parametrize("published", [(), (status("capture"),), ([b"status", b"\xff" * 40],)])
def test_silence_another_service_and_random_bytes_are_none(published, settings, monkeypatch):
    monkeypatch.setattr(health, "STATUS_TIMEOUT_S", 0.4)
    with publishing(settings, *published), pytest.raises(SystemExit, match="sampler: no status within"):
        health.check_health(settings, "sampler")


def test_a_status_is_awaited_for_two_seconds():
    assert health.STATUS_TIMEOUT_S == 2.0  # as docs/containers.md says


def test_a_service_that_does_not_run_is_not_healthy(settings, monkeypatch):
    monkeypatch.setattr(health, "STATUS_TIMEOUT_S", 0.1)
    with pytest.raises(SystemExit, match="sampler: no status within"):
        health.check_health(settings, "sampler")
