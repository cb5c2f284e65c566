"""Every way out of running services gives the same light in the same frame: wire, websocket, JSON, JSON lines, OSC, the Python client."""

import asyncio
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import msgspec
import numpy as np
import pytest

from tests.support.exchange import messages_of
from tests.support.lights_files import light_set_from_row
from tests.support.viewer_process import PATIENCE_S, SimulatedServices, ViewerProcess, eventually, frames_of
from vemlight.light.light_set import LightSet, LightsRow
from vemlight.runtime import wire
from vemlight.settings import Wire
from vemlight_client import lights

ELSEWHERE = "https://stage.example:8443"


def soft_frames(sequence: int, count: int = 72) -> dict:
    """As `frames_of`, with extents."""
    frames = frames_of(sequence, count)
    header, arrays = frames["sampler"]
    covariances = np.tile(np.array([1e-3, 0, 0, 1e-3, 0, 0], np.float32), (count, 1))
    assert isinstance(header, wire.LightsMessage)
    header = wire.LightsMessage(stamp=header.stamp, count=count, coverage="hemisphere", soft=True)
    return {**frames, "sampler": (header, (*arrays[:3], covariances, *arrays[3:]))}


def truth(sequence: int) -> LightSet:
    return LightSet.of(*soft_frames(sequence)["sampler"][1][:4])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    folder.chmod(0o700)
    return folder


@pytest.fixture(scope="module")
def viewer(folder: Path) -> Iterator[ViewerProcess]:
    simulated = SimulatedServices(Wire(folder=str(folder)), soft_frames)
    simulated.start()
    viewer = ViewerProcess(folder, more=f'origins = ["{ELSEWHERE}"]')
    viewer.first_line()
    eventually(lambda: viewer.get("/healthz")[0] == 200, "all services seen")
    yield viewer
    viewer.end()
    simulated.end()


def decoded(data: bytes) -> tuple[int, LightSet]:
    """By the layout's text in docs/clients.md."""
    kind, layout, extent, coverage, count, sequence, time_s = struct.unpack_from("<BBBBIdd", data)
    assert (kind, layout, extent, coverage) == (3, 1, 6, 0)
    assert len(data) == 24 + count * (32 + 4 * extent)
    assert time_s == pytest.approx(sequence / 25)
    floats = np.frombuffer(data, "<f4", offset=24 + 8 * count)
    directions, irradiance, extents = np.split(floats, [3 * count, 6 * count])
    ids = np.frombuffer(data, "<f8", count, 24)
    return int(sequence), LightSet.of(ids, directions.reshape(-1, 3), irradiance.reshape(-1, 3), extents.reshape(-1, 6))


def check(sequence: int, found: LightSet) -> None:
    for one, other in zip(found, truth(sequence), strict=True):
        assert one is not None
        assert other is not None
        assert np.abs(one - other).max() <= 1e-6


def from_websocket(viewer: ViewerProcess) -> tuple[int, LightSet]:
    async def two() -> bytes:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{viewer.url}/ws?feeds=lights.bin") as reader:
            first = await reader.receive(PATIENCE_S)
            with pytest.raises(TimeoutError):  # nothing else, and no second one unasked
                await reader.receive(0.3)
            await reader.send_str("lights.bin")
            second = await reader.receive(PATIENCE_S)
            assert decoded(second.data)[0] > decoded(first.data)[0]
            return second.data

    return decoded(asyncio.run(two()))


def from_client(folder: Path) -> tuple[int, LightSet]:
    frame = next(lights(f"ipc://{folder}/sampler.publish", timeout_s=PATIENCE_S))
    return frame.sequence, LightSet(*frame[2:])


def test_websocket_json_and_client(viewer, folder):
    check(*from_websocket(viewer))
    check(*from_client(folder))
    row = msgspec.json.decode(viewer.get("/lights")[1], type=LightsRow)
    check(row.sequence, light_set_from_row(row))


def test_lines_of_json(viewer):
    with socket.create_server(("127.0.0.1", 0)) as server:
        command = [sys.executable, "-m", "vemlight", "stream", str(viewer.settings), "--jsonl", f"127.0.0.1:{server.getsockname()[1]}"]
        process = subprocess.Popen(command)
        server.settimeout(PATIENCE_S)
        reader, _ = server.accept()
        with reader.makefile("rb") as lines:
            rows = [msgspec.json.decode(next(lines), type=LightsRow) for _ in range(5)]
        process.kill()
        process.wait()
        reader.close()
    assert [row.sequence for row in rows] == sorted({row.sequence for row in rows})
    for row in rows:
        check(row.sequence, light_set_from_row(row))


def test_osc(viewer):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(PATIENCE_S)
        command = [sys.executable, "-m", "vemlight", "stream", str(viewer.settings), "--osc", f"127.0.0.1:{receiver.getsockname()[1]}"]
        process = subprocess.Popen(command)
        bundles = [receiver.recv(2000) for _ in range(12)]  # three frames of four
        process.kill()
        process.wait()
    frames: dict[int, dict[int, list[float]]] = {}
    for bundle in bundles:
        (_, (sequence, count)), *rest = messages_of(bundle)
        assert count == 72
        frames.setdefault(sequence, {}).update({arguments[0]: arguments[1:] for _, arguments in rest})
    sequence, whole = next((sequence, found) for sequence, found in frames.items() if len(found) == 72)
    numbers = np.array([whole[k] for k in range(72)], np.float32)
    expected = truth(sequence)
    assert np.abs(numbers[:, :3] - expected.directions).max() <= 1e-6
    assert np.abs(numbers[:, 3:6] - expected.irradiance).max() <= 1e-6


def test_a_socket_gets_the_feeds_that_it_names_and_no_others_exist(viewer):
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Version": "13"}
    upgrade["Sec_WebSocket_Key"] = "MDEyMzQ1Njc4OWFiY2RlZg=="
    for feeds in ("lights.bin,pictures", "", "lights,"):
        status, text = viewer.get(f"/ws?feeds={feeds}", **upgrade)
        assert status == 400
        assert text.startswith(b"feeds: choose from summary, lights, ")
        assert text.count(b"\n") == 1
        assert b" lights.bin, " in text


def test_a_page_elsewhere_that_the_settings_name_may_open_the_socket_and_nothing_else(viewer):
    async def opened(origin: str) -> int:
        async with aiohttp.ClientSession() as session:
            try:
                async with session.ws_connect(f"{viewer.url}/ws?feeds=lights.bin", headers={"Origin": origin}) as reader:
                    return len((await reader.receive(PATIENCE_S)).data)
            except aiohttp.WSServerHandshakeError as error:
                return error.status

    assert asyncio.run(opened(ELSEWHERE)) == 24 + 72 * 56
    assert asyncio.run(opened(ELSEWHERE.replace("8443", "8444"))) == 403
    assert viewer.get("/lights", Origin=ELSEWHERE)[0] == 403
    assert viewer.get("/control", b"{}", Content_Type="application/json", Origin=ELSEWHERE)[0] == 403


def test_a_service_that_is_silent_is_said(tmp_path):
    tmp_path.chmod(0o700)
    (tmp_path / "empty.toml").write_text(f'[wire]\nfolder = "{tmp_path}"\n')
    command = [sys.executable, "-m", "vemlight", "stream", str(tmp_path / "empty.toml"), "--osc", "127.0.0.1:9"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    stop = threading.Timer(PATIENCE_S, process.kill)
    stop.start()
    line = process.stderr.readline()
    stop.cancel()
    process.kill()
    process.wait()
    assert "no lights come; is the sampler running?" in line
