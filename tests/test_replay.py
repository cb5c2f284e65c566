"""Each service as a process on its own: recorded messages in, messages out compared; then all together on the bundled sequences."""

import signal
import time

import msgspec
import numpy as np
import pytest
import tomli_w
import zmq

from tests import references
from tests.support.lights_files import light_set_from_row, read_lights
from tests.support.processes import LOADED_S
from vemlight.runtime import wire
from vemlight.runtime.demand import Pull, Supply
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.transport import Transport

TONE = ("tone_scale", "tone_white")  # of a picture: means over its pixels


def exact_fields(header: wire.Header) -> dict:
    """The header's fields but clocks and those in TONE."""
    return {name: value for name, value in references.without_clocks(header).items() if name not in TONE}


def assert_same(seen: list[wire.Message], expected: list[wire.Message]) -> None:
    """Maps and lights to 1e-5 (another processor rounds otherwise); pictures to 2 codes but for 1 pixel in 200, at edges."""
    assert [exact_fields(header) for header, _ in seen] == [exact_fields(header) for header, _ in expected]
    for (header, arrays), (recorded, wanted) in zip(seen, expected, strict=True):
        for name in TONE:
            assert getattr(header, name, 0.0) == pytest.approx(getattr(recorded, name, 0.0), rel=1e-3), name
        for array, reference in zip(arrays, wanted, strict=True):
            if isinstance(header, wire.ImageMessage):
                differs = (np.abs(array.astype(int) - reference) > 2).any(axis=-1)
                assert differs.mean() < 1 / 200, f"picture {header.stamp.sequence}: {differs.sum()} pixels differ"
            else:
                scale = np.abs(reference).max(initial=0)
                np.testing.assert_allclose(array, reference, rtol=1e-5, atol=1e-5 * scale)


@pytest.fixture
def small(tmp_path):
    """Writes the references' settings with sockets of this test's own."""

    def make(sequence: str, **changes):
        sockets = tmp_path / "sockets"
        sockets.mkdir(mode=0o700)
        settings = references.settings(sequence, wire={"folder": str(sockets)}, **changes)
        path = tmp_path / "vemlight.toml"
        path.write_text(tomli_w.dumps(msgspec.to_builtins(settings)))
        return msgspec.convert(msgspec.to_builtins(settings), type(settings)), path

    return make


def fed(supply: Supply | None, messages: list[wire.Message], pull: Pull | None, count: int) -> list[wire.Message]:
    """Feeds a service what it asks for and asks it for what it makes."""
    out: list[wire.Message] = []
    until = time.monotonic() + LOADED_S
    while len(out) < count and time.monotonic() < until:
        if supply:
            supply.earliest_requested()
            supply.send(lambda k: messages[k] if k < len(messages) else None, end=len(messages))
        if pull and (message := pull.frame(len(out))):
            out.append(message)
        time.sleep(0.005)
    return out


@pytest.mark.parametrize("sequence", references.SEQUENCES)
def test_capture_alone(sequence, small, services):
    settings, path = small(sequence)
    transport = Transport(settings.wire)
    process = services.start("vemlight.capture", str(path))
    pull = Pull(transport.request_from("capture"), "map", ServiceStats("sampler", 0))
    seen = fed(None, [], pull, references.FRAMES)
    until = time.monotonic() + 5
    while pull.end is None and time.monotonic() < until:
        pull.frame(references.FRAMES)
    assert pull.end == references.FRAMES
    transport.close()
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=10) == 0
    assert_same(seen, references.recorded(sequence, "map"))


@pytest.mark.parametrize("sequence", references.SEQUENCES)
def test_sampler_alone(sequence, small, services):
    settings, path = small(sequence)
    transport = Transport(settings.wire)
    supply = Supply(transport.bind("capture", "serve"), ServiceStats("capture", 0))
    services.start("vemlight.sampler", str(path))
    pull = Pull(transport.request_from("sampler"), "lights", ServiceStats("renderer", 0))
    seen = fed(supply, references.recorded(sequence, "map"), pull, references.FRAMES)
    transport.close()
    assert_same(seen, references.recorded(sequence, "lights"))


@pytest.mark.parametrize("sequence", references.SEQUENCES)
def test_renderer_alone(sequence, small, services):
    settings, path = small(sequence)
    transport = Transport(settings.wire)
    supplies = [Supply(transport.bind(service, "serve"), ServiceStats(service, 0)) for service in ("sampler", "capture")]
    recorded = [references.recorded(sequence, kind) for kind in ("lights", "map")]  # glossy surfaces reflect the map
    listener = transport.subscribe("renderer", "image", "status")
    process = services.start("vemlight.renderer", str(path))
    assert listener.poll(LOADED_S * 1e3)  # it publishes: the subscription is in place before the first picture is asked for
    seen = []
    until = time.monotonic() + LOADED_S
    while len(seen) < references.FRAMES and time.monotonic() < until:
        for supply, messages in zip(supplies, recorded, strict=True):
            supply.earliest_requested()
            supply.send(lambda k, messages=messages: messages[k] if k < len(messages) else None, end=len(messages))
        patience_ms = 5
        while listener.poll(patience_ms, zmq.POLLIN):  # all that is there: few pictures wait, and the next drop out
            message = wire.unpack(listener.recv_multipart())
            seen += [message] if isinstance(message[0], wire.ImageMessage) else []
            patience_ms = 0
    assert process.wait(timeout=LOADED_S) == 0  # the last service ends with the last frame
    transport.close()
    assert_same(seen, references.recorded(sequence, "image"))


@pytest.mark.parametrize("sequence", references.SEQUENCES)
def test_all_together(sequence, small, services, tmp_path):
    out = tmp_path / "out"
    _, path = small(sequence, out=str(out))
    running = [services.start(f"vemlight.{name}", str(path)) for name in ("capture", "sampler", "renderer")]
    assert running[-1].wait(timeout=LOADED_S) == 0
    rows = read_lights(out / "lights.jsonl")
    assert [row.sequence for row in rows] == list(range(references.FRAMES))
    for row, (_, (ids, directions, irradiance, *_)) in zip(rows, references.recorded(sequence, "lights"), strict=True):
        lights = light_set_from_row(row)
        assert lights.ids.tolist() == ids.tolist()
        np.testing.assert_allclose(lights.directions, directions, atol=1e-5)
        np.testing.assert_allclose(lights.irradiance, irradiance, rtol=1e-4, atol=1e-5 * irradiance.max())
    assert sorted(path.name for path in out.glob("frame_*.png")) == [f"frame_{k:04d}.png" for k in range(references.FRAMES)]


@pytest.mark.parametrize("sequence", references.SEQUENCES)
def test_steps_give_the_references(sequence):
    for kind, messages in references.made(sequence).items():
        assert_same(messages, references.recorded(sequence, kind))
