"""The health check hears a service of its own, and nothing else."""

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
def speaking(settings, *messages):
    """A sampler's publisher that says these messages again and again."""
    stop, ready = threading.Event(), threading.Event()

    def speak():
        transport = Transport(settings.wire)
        publisher = transport.bind("sampler", "publish")
        ready.set()
        while not stop.wait(0.02):
            accept_subscriptions(publisher)
            for parts in messages:
                publisher.send_multipart(parts, zmq.NOBLOCK)
        transport.close()

    thread = threading.Thread(target=speak)
    thread.start()
    assert ready.wait(10)
    try:
        yield
    finally:
        stop.set()
        thread.join()


def status(service):
    said = ServiceStats(service, 0).status_if_due()
    assert said
    return wire.pack(said)


def test_a_status_is_health(settings, capsys):
    with speaking(settings, status("sampler")):
        health.check_health(settings, "sampler")
    assert capsys.readouterr().out == "vemlight: sampler: no frame yet\n"


@pytest.mark.parametrize("said", [(), (status("capture"),), ([b"status", b"\xff" * 40],)])
def test_silence_another_service_and_random_bytes_are_none(said, settings, monkeypatch):
    monkeypatch.setattr(health, "STATUS_TIMEOUT_S", 0.4)
    with speaking(settings, *said), pytest.raises(SystemExit, match="sampler: no status within"):
        health.check_health(settings, "sampler")


def test_a_status_is_awaited_for_two_seconds():
    assert health.STATUS_TIMEOUT_S == 2.0  # as docs/containers.md says


def test_a_service_that_does_not_run_is_not_healthy(settings, monkeypatch):
    monkeypatch.setattr(health, "STATUS_TIMEOUT_S", 0.1)
    with pytest.raises(SystemExit, match="sampler: no status within"):
        health.check_health(settings, "sampler")
