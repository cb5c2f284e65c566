"""The health check takes the status of the service that it asks about, and nothing else."""

import threading
from contextlib import contextmanager

import msgspec
import pytest
import tomli_w
import zmq

from vemlight.errors import UserError
from vemlight.runtime import health, wire
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Rig, Settings, Wire


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


def test_a_name_that_no_process_has_is_said_at_once(settings, tmp_path, monkeypatch):
    """Of a rig each camera has its own; another run's renderer may be asked through the first one's settings."""
    monkeypatch.setattr(health, "STATUS_TIMEOUT_S", 0.1)
    cameras = [{"name": name, "source": name, "at": [k, 0, 1]} for k, name in enumerate(("left", "right"))]
    (tmp_path / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    of_rig = msgspec.structs.replace(settings, rig=Rig(file=str(tmp_path / "rig.toml")))
    for asked, service in ((settings, "fuse"), (of_rig, "capture"), (of_rig, "capture.lft")):
        with pytest.raises(UserError, match=f"^{service}: no process of these settings is called so; ask for one of capture.*, sampler"):
            health.check_health(asked, service)
    for service in ("capture.left", "fuse", "renderer.wall"):
        with pytest.raises(SystemExit, match=f"{service}: no status within"):
            health.check_health(of_rig, service)
