"""The client in one file for other Python programs."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zmq

from tests.support.processes import free_port
from tests.support.viewer_process import frames_of
from vemlight.light.light_set import LightSet
from vemlight.runtime import wire
from vemlight.runtime.transport import Transport, accept_subscriptions, make_keys
from vemlight.settings import Wire
from vemlight_client import lights

PATIENCE_S = 20.0
ROOT = Path(__file__).parents[1]


def soft_message(sequence: int, count: int = 5) -> wire.Message:
    header, arrays = frames_of(sequence, count)["sampler"]
    assert isinstance(header, wire.LightsMessage)
    header = wire.LightsMessage(stamp=header.stamp, count=count, coverage="hemisphere", soft=True)
    covariances = np.tile(np.array([1e-3, 0, 0, 1e-3, 0, 0], np.float32), (count, 1))
    return header, (*arrays[:3], covariances, *arrays[3:])


def publish_until_subscribed(publisher, message: wire.Message) -> None:
    """Sends it again and again until a subscriber has come, then three times."""
    give_up_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < give_up_s:
        if publisher.poll(50):
            accept_subscriptions(publisher)
            break
    for _ in range(3):
        accept_subscriptions(publisher)
        publisher.send_multipart(wire.pack(*message))


def next_in_thread(iterator):
    """The next value of an iterator that waits for it, while this thread publishes."""
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(1)
    future = pool.submit(next, iterator)
    pool.shutdown(wait=False)
    return future


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("transport", ["ipc", "tcp", "keys"])
def test_a_frame_comes_to_the_bit(tmp_path, soft, transport):
    keys = None
    port = free_port() - 2  # the sampler's is two higher
    settings = Wire(folder=str(tmp_path / "s"))
    if transport != "ipc":
        settings = Wire(transport="tcp", port=port, insecure=transport == "tcp", keys=str(tmp_path / "keys") if transport == "keys" else "")
    if transport == "keys":
        make_keys(tmp_path / "keys")
        keys = tmp_path / "keys"
    sockets = Transport(settings)
    publisher = sockets.bind("sampler", "publish")
    address = f"ipc://{tmp_path}/s/sampler.publish" if transport == "ipc" else f"tcp://127.0.0.1:{port + 2}"
    message = soft_message(7) if soft else frames_of(7, 5)["sampler"]
    frames = lights(address, keys, timeout_s=PATIENCE_S)
    coming = next_in_thread(frames)
    publish_until_subscribed(publisher, message)
    frame = coming.result(PATIENCE_S)
    sent = LightSet(*message[1][: 4 if soft else 3])
    assert (frame.sequence, frame.time_s) == (7, 7 / 25)
    for found, given in zip(frame[2:], sent, strict=True):
        assert (found is None) == (given is None)
        assert given is None or np.array_equal(found, given)
    frames.close()
    sockets.close()


def test_who_is_slow_gets_the_newest_and_an_older_one_never(tmp_path):
    sockets = Transport(Wire(folder=str(tmp_path / "s")))
    publisher = sockets.bind("sampler", "publish")
    frames = lights(f"ipc://{tmp_path}/s/sampler.publish", timeout_s=PATIENCE_S)
    coming = next_in_thread(frames)
    publish_until_subscribed(publisher, frames_of(0)["sampler"])
    coming.result(PATIENCE_S)
    for sequence in range(1, 61):
        publisher.send_multipart(wire.pack(*frames_of(sequence)["sampler"]))
        time.sleep(0.005)
    time.sleep(0.3)
    assert next(frames).sequence == 60
    frames.close()
    sockets.close()


def test_what_it_cannot_read_is_said(tmp_path):
    with pytest.raises(TimeoutError, match=r"no lights within 0\.2 s"):
        next(lights(f"ipc://{tmp_path}/nobody", timeout_s=0.2))
    with pytest.raises(FileNotFoundError):
        next(lights("tcp://127.0.0.1:9", keys=tmp_path))
    (tmp_path / "vemlight.key_secret").write_text("nothing\n")
    with pytest.raises(ValueError, match="holds no key pair"):
        next(lights("tcp://127.0.0.1:9", keys=tmp_path))


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([b"lights"], "not a message of lights"),
        ([b"lights", b"\x80"], "not a message of lights"),
        ([b"lights", b"\x82\xa4kind\xa6lights\xa7version\x03"], "wire version 3; this client reads 2"),
        ([b"lights", b"\x81\xa4kind\xa6lights"], "wire version 1; this client reads 2"),
        ([*wire.pack(*frames_of(0, 3)["sampler"])[:3], b"1234", b""], "array of 1 numbers"),
        (wire.pack(*frames_of(0, 3)["sampler"])[:4], "2 arrays, the header says 3"),
    ],
)
def test_another_message_is_refused(parts, words):
    from vemlight_client import _decoder, _frame

    with pytest.raises(ValueError, match=words):
        _frame(parts, _decoder())


def test_it_needs_neither_vemlight_nor_msgspec(tmp_path):
    """Where msgspec is missing, msgpack decodes."""
    code = "import sys; sys.path.insert(0, sys.argv[1]); import vemlight_client"
    code += "; print([name for name in sys.modules if name.startswith('vemlight')])"
    (tmp_path / "vemlight_client.py").write_bytes((ROOT / "vemlight_client.py").read_bytes())
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout == "['vemlight_client']\n"
    source = (ROOT / "vemlight_client.py").read_text()
    assert "import vemlight\n" not in source
    assert "from vemlight." not in source


def test_its_context_may_be_given(tmp_path):
    context = zmq.Context()
    with pytest.raises(TimeoutError):
        next(lights(f"ipc://{tmp_path}/nobody", timeout_s=0.1, context=context))
    context.term()  # which would wait for a socket left open
