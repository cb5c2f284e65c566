"""`vemlight relay`: many listeners, small frames, keys, slow links and cuts."""

import os
import resource
import signal
import socket as network
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq

from tests.support.processes import LOADED_S, children, free_port, wait_until
from tests.support.slow_link import SlowLink
from tests.support.viewer_process import PATIENCE_S, SimulatedServices, eventually, frames_of
from vemlight.exchange.fewer_lights import error_of
from vemlight.exchange.relay import PART_BYTES, Feed, Relayed, downstream
from vemlight.exchange.stream import Destination, light_set
from vemlight.light.light_set import LightSet
from vemlight.runtime import wire
from vemlight.runtime.reports import LightsReport
from vemlight.runtime.transport import Transport, endpoint, make_keys, read_keys
from vemlight.settings import Wire
from vemlight_client import lights

SUBSCRIBERS = 200


def soft_frames(sequence: int, count: int = 150) -> dict:
    frames = frames_of(sequence, count)
    header, arrays = frames["sampler"]
    assert isinstance(header, wire.LightsMessage)
    covariances = np.tile(np.array([1e-3, 0, 0, 1e-3, 0, 0], np.float32), (count, 1))
    report = LightsReport(error_ratio=0.03)
    header = wire.LightsMessage(stamp=header.stamp, count=count, coverage="hemisphere", soft=True, report=report)
    return {**frames, "sampler": (header, (*arrays[:3], covariances, *arrays[3:]))}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Iterator[Path]:
    """Running services of 150 soft lights a frame, with keys for other hosts."""
    folder = tmp_path_factory.mktemp("place")
    folder.chmod(0o700)
    make_keys(folder / "keys")
    (folder / "place.toml").write_text(f'[wire]\nfolder = "{folder}"\nkeys = "{folder}/keys"\n')
    simulated = SimulatedServices(Wire(folder=str(folder)), lambda sequence, _: soft_frames(sequence))
    simulated.start()
    yield folder
    simulated.end()


@pytest.fixture
def relay(place: Path) -> Iterator:
    """Starts one; gives its port."""
    processes = []

    def start(*options: str, files: int = 0) -> int:
        port = free_port()
        limited = partial(resource.setrlimit, resource.RLIMIT_NOFILE, (files, files)) if files else None
        command = [sys.executable, "-m", "vemlight", "relay", "sampler", str(place / "place.toml"), "--listen", f"127.0.0.1:{port}"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        processes.append(subprocess.Popen([*command, *options], **pipes, preexec_fn=limited))
        assert f"lights at tcp://127.0.0.1:{port}" in processes[-1].stdout.readline()
        return port

    start.processes = processes
    yield start
    for process in processes:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(("feed", "most"), [(Feed(), 91), (Feed(count=24), 24), (Feed(max_bytes=2000), 20)])
def test_a_frame_fits_and_has_all_the_light(feed, most):
    relayed = Relayed(feed)
    message = soft_frames(3, 300)["sampler"]
    parts = relayed.frame(message)
    assert sum(map(len, parts)) + PART_BYTES * len(parts) <= feed.max_bytes
    header, arrays = wire.unpack(parts)
    assert isinstance(header, wire.LightsMessage)
    assert (header.count, header.gloss_count, header.stamp) == (most, 0, message[0].stamp)
    fewer, whole = light_set(header, arrays), LightSet(*message[1][:4])
    assert np.allclose(fewer.irradiance.sum(axis=0), whole.irradiance.sum(axis=0), rtol=1e-5)
    assert relayed.error == pytest.approx(error_of(fewer, whole), rel=1e-6)
    assert header.report.error_ratio == pytest.approx(np.hypot(0.03, relayed.error))


def test_a_frame_that_fits_already_is_passed_on_to_the_bit():
    message = soft_frames(3, 72)["sampler"]
    header, arrays = wire.unpack(Relayed(Feed()).frame(message))
    assert header == message[0]
    assert all(np.array_equal(one, other) for one, other in zip(arrays, message[1], strict=True))


def test_its_status_counts_its_own_frames():
    relayed = Relayed(Feed())
    relayed.frame(soft_frames(1)["sampler"])
    status = wire.StatusMessage(
        service="sampler", sequence=9, rate_hz=25, age_ms=1, step_ms=1, frames=999, skipped=0, dropped=0, refused=0, restarts=0
    )
    header, _ = wire.unpack(relayed.status((status, ())))
    assert isinstance(header, wire.StatusMessage)
    assert (header.frames, header.sequence, header.rate_hz) == (1, 9, 25)


def sequence_of(parts) -> int:
    header, _ = wire.unpack(parts)
    assert isinstance(header, wire.LightsMessage)
    return header.stamp.sequence


def test_two_hundred_listeners_with_keys_get_the_same_frames(place, relay):
    port = relay()
    context = zmq.Context()
    context.set(zmq.MAX_SOCKETS, 2048)
    keys = read_keys(place / "keys")
    poller, seen = zmq.Poller(), {}
    for _ in range(SUBSCRIBERS):
        socket: Any = context.socket(zmq.SUB)
        socket.linger = 0
        socket.curve_publickey, socket.curve_secretkey = keys
        socket.curve_serverkey = keys.public
        socket.subscribe(b"lights")
        socket.connect(f"tcp://127.0.0.1:{port}")
        poller.register(socket, zmq.POLLIN)
        seen[socket] = []
    until = time.monotonic() + LOADED_S
    while time.monotonic() < until and not all(len(frames) >= 3 for frames in seen.values()):
        for socket, _ in poller.poll(1000):
            seen[socket].append(tuple(socket.recv_multipart()))
    assert all(len(frames) >= 3 for frames in seen.values())
    number = {parts: sequence_of(parts) for frames in seen.values() for parts in frames}
    assert len(set(number.values())) == len(number)  # of a frame all have the same bytes
    for frames in seen.values():
        assert [number[parts] for parts in frames] == sorted(number[parts] for parts in frames)
    context.destroy(linger=0)


def test_without_its_key_a_listener_gets_nothing(place, relay, tmp_path):
    port = relay()
    make_keys(tmp_path / "other")
    for keys in (None, tmp_path / "other"):
        with pytest.raises(TimeoutError):
            next(lights(f"tcp://127.0.0.1:{port}", keys, timeout_s=1.5))
    assert len(next(lights(f"tcp://127.0.0.1:{port}", place / "keys", timeout_s=PATIENCE_S)).ids) == 91


def test_it_listens_where_it_is_told_whatever_ports_the_place_has():
    inner = Wire(transport="tcp", insecure=True, ports={"sampler": 5900}, hosts={"sampler": "10.0.0.7"})
    assert endpoint(downstream(inner, Destination("127.0.0.1", 5702)), "sampler", "publish") == "tcp://127.0.0.1:5702"


def test_a_service_elsewhere_takes_it_for_the_sampler(place, relay):
    """A renderer or viewer whose settings name the relay's host and port."""
    port = relay("--count", "24", "--rate", "10")
    there = Transport(Wire(transport="tcp", port=port - 2, keys=str(place / "keys")))
    socket = there.subscribe("sampler", "lights", "status")
    kinds: dict[str, list] = {"lights": [], "status": []}
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until and min(len(kinds["lights"]) - 21, len(kinds["status"]) - 1) < 0:
        if socket.poll(100):
            header, _ = wire.unpack(socket.recv_multipart())
            kinds[header.kind].append(header)
    assert {header.count for header in kinds["lights"]} == {24}
    assert kinds["status"]
    first, *_, last = kinds["lights"]
    assert last.stamp.sequence - first.stamp.sequence >= 2 * (len(kinds["lights"]) - 1)  # ten of 25 a second: of 20 gaps 2.5 each
    there.close()


def test_a_relay_that_is_killed_comes_back_and_its_listeners_with_it(place, relay):
    port = relay()
    (supervisor,) = relay.processes
    frames = lights(f"tcp://127.0.0.1:{port}", place / "keys", timeout_s=LOADED_S)
    assert len(next(frames).ids) == 91
    for number in (1, 2):
        worker, before = children(supervisor.pid)["exchange.relay"], next(frames).sequence
        os.kill(worker, signal.SIGKILL)
        assert f"lights at tcp://127.0.0.1:{port}" in supervisor.stdout.readline()
        line = next(line for line in supervisor.stderr if "relay was killed" in line)
        assert f"by SIGKILL; restart {number} in " in line
        assert any(frame.sequence > before + 25 for frame in frames), "the same listener, a frame of a second later"
    supervisor.kill()
    wait_until(lambda: not children(supervisor.pid), "the end of the worker", 5)


def knocking(port: int) -> network.socket:
    """A connection on its way in, which is not waited for and says nothing."""
    caller = network.socket()
    caller.setblocking(False)
    caller.connect_ex(("127.0.0.1", port))
    return caller


def test_a_crowd_beyond_its_open_files_is_refused_in_one_line_and_listeners_go_on(place, relay):
    port = relay(files=256)
    (supervisor,) = relay.processes
    worker = children(supervisor.pid)["exchange.relay"]
    frames = lights(f"tcp://127.0.0.1:{port}", place / "keys", timeout_s=LOADED_S)
    before = next(frames).sequence
    said: list[str] = []
    threading.Thread(target=said.extend, args=(supervisor.stderr,), daemon=True).start()
    crowd = deque(knocking(port) for _ in range(300))
    refused = "refused a peer: 42 are connected, as many as a limit of 256 open files allows; raise it"
    until, newest = time.monotonic() + LOADED_S, before
    while newest < before + 75 or not any(refused in line for line in said):
        newest = next(frames).sequence
        assert time.monotonic() < until, f"no line says so: {said}"
        # Of the 300 the kernel's queue had room for 17: others come in their place, and never more than that at once
        for _ in range(8):
            crowd.popleft().close()
            crowd.append(knocking(port))
    assert children(supervisor.pid)["exchange.relay"] == worker, "it lives"
    for each in crowd:
        each.close()
    supervisor.kill()
    wait_until(lambda: not children(supervisor.pid), "the end of the worker", 10)
    assert sum(refused in line for line in said) == 1


def test_a_relay_that_cannot_listen_ends_with_its_line(place, relay):
    port = relay()
    command = [sys.executable, "-m", "vemlight", "relay", "sampler", str(place / "place.toml"), "--listen", f"127.0.0.1:{port}"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=LOADED_S, check=False)
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert f"127.0.0.1:{port}" in ended.stderr


def test_over_a_slow_link_frames_are_young_and_a_cut_of_5_s_heals(place, relay):
    """1 Mbit/s, 200 ms each way, 24 of 150 lights: 0.4 Mbit/s."""
    link = SlowLink(relay("--count", "24"), 1e6 / 8, 0.2)
    frames = lights(f"tcp://127.0.0.1:{link.port}", place / "keys", timeout_s=PATIENCE_S)
    newest: list[tuple[float, int]] = []
    stop = threading.Event()

    def listen() -> None:
        for frame in frames:
            newest.append((time.monotonic(), frame.sequence))
            if stop.is_set():
                return

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    eventually(lambda: len(newest) > 20, "frames over the link")
    link.cut = True
    time.sleep(5)
    before = newest[-1][1]
    link.cut = False
    eventually(lambda: newest[-1][1] > before + 100, "a frame that was made at the cut's end")
    stop.set()
    listener.join(PATIENCE_S)
    link.end()
    gaps = np.diff([at for at, _ in newest])
    assert gaps.max() > 4  # it was a cut
    assert [sequence for _, sequence in newest] == sorted(sequence for _, sequence in newest)
