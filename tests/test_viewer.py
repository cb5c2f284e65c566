"""The viewer as a process, with other services that are made up: messages in, pages, pictures and choices out."""

import asyncio
import http.client
import json
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import cv2
import msgspec
import numpy as np
import pytest

from tests.support.lights_files import light_set_from_row
from tests.support.viewer_process import PATIENCE_S, SimulatedServices, ViewerProcess, eventually
from vemlight.light.light_set import LightsRow
from vemlight.runtime import wire
from vemlight.runtime.poses import MAX_POSES
from vemlight.settings import Wire
from vemlight.viewer.authentication import GUESSES_BURST, cookie_of
from vemlight.viewer.web import MAX_BODY, MAX_PAGES, MESSAGES_BURST


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    folder.chmod(0o700)
    return folder


@pytest.fixture(scope="module")
def simulated(folder: Path) -> Iterator[SimulatedServices]:
    simulated = SimulatedServices(Wire(folder=str(folder)))
    simulated.start()
    yield simulated
    simulated.end()


@pytest.fixture(scope="module")
def viewer(folder: Path, simulated: SimulatedServices) -> Iterator[ViewerProcess]:
    viewer = ViewerProcess(folder)
    assert f"{viewer.url} (for this machine only)" in viewer.first_line()
    eventually(lambda: viewer.get("/healthz")[0] == 200, "all services seen")
    yield viewer
    viewer.end()


def decoded(jpeg: bytes) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return pixels


def test_pictures_for_other_programs(viewer):
    for path in ("/snapshot.jpg", "/?action=snapshot"):
        status, jpeg = viewer.get(path)
        assert (status, decoded(jpeg).shape) == (200, (48, 64, 3))
    for path in ("/stream.mjpg", "/?action=stream"):
        stream = cv2.VideoCapture(viewer.url + path, cv2.CAP_FFMPEG)
        bars = []
        for _ in range(5):
            done, picture = stream.read()
            assert done
            bars.append(int((picture[..., 2].astype(int) - picture[..., 1]).mean(axis=0).argmax()))
        assert len(set(bars)) == 5  # the red bar moves: no picture comes twice
        stream.release()


def test_lights_are_the_file_form(viewer):
    row = msgspec.json.decode(viewer.get("/lights")[1], type=LightsRow)
    assert np.allclose(np.linalg.norm(light_set_from_row(row).directions, axis=1), 1, atol=1e-6)


def test_choices_are_published_whole_and_again(viewer, simulated):
    status, body = viewer.choose(count=17, exposure=-1.5)
    whole = msgspec.json.decode(msgspec.json.encode(wire.ControlMessage(count=17, exposure=-1.5)))
    assert (status, json.loads(body)) == (200, whole)
    viewer.choose(paused=True)
    chosen = wire.ControlMessage(count=17, exposure=-1.5, paused=True)
    eventually(lambda: simulated.controls[-3:] == [chosen] * 3, "the choices on their channel, again and again")
    eventually(lambda: viewer.health()["light_count"] == 17, "as many lights as were chosen")
    viewer.choose(count=None, exposure=None, paused=False)
    eventually(lambda: simulated.controls[-1] == wire.ControlMessage(), "the settings' own again")


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"[1]", b"7", b"\xff\xfe", b"[" * MAX_BODY, b'{"count": 0}', b'{"count": 2.5}', b'{"count": "many"}',
        b'{"count": 1e999}', b'{"exposure": 21}', b'{"exposure": NaN}', b'{"filtered": 1}', b'{"paused": 2}',
        b'{"lights": 3}', b'{"kind": "status"}',
    ],
)  # fmt: skip
def test_a_bad_choice_is_refused_in_one_line(viewer, body):
    before = viewer.health()["control"]
    status, line = viewer.get("/control", body, Content_Type="application/json")
    assert status == 400
    assert line.startswith(b"control: ")
    assert line.count(b"\n") == 1
    assert viewer.health()["control"] == before


def test_a_control_may_move_as_many_objects_as_a_message_holds(viewer):
    third = 1 / 3  # with all its digits
    poses = [
        {"name": f"an object with number {k}", "position": 3 * [-third], "rotation": [0.0, 0.0, -0.6000000000000001, 0.8000000000000002]}
        for k in range(MAX_POSES)
    ]
    assert viewer.choose(poses=poses)[0] == 200
    assert viewer.choose(poses=None)[0] == 200


def test_what_is_too_large_or_not_json_is_refused(viewer):
    assert viewer.get("/control", b" " * (MAX_BODY + 1), Content_Type="application/json")[0] == 413
    assert viewer.get("/control", b"{}", Content_Type="text/plain")[0] == 415


@pytest.mark.parametrize("path", ["/..%2f..%2fwire.py", "/page/index.html", "/../view.py", "/ws", "/?action=run", "/viewer.js/x"])
def test_nothing_else_is_served(viewer, path):
    assert viewer.get(path)[0] in (400, 404)


def test_foreign_names_and_pages_are_refused(viewer):
    assert viewer.get("/", Host="attacker.example")[0] == 403
    assert viewer.get("/", Host=f"localhost:{viewer.port}")[0] == 200
    for path, body in (("/control", b"{}"), ("/ws", None)):
        assert viewer.get(path, body, Content_Type="application/json", Origin="http://attacker.example")[0] == 403
    assert viewer.get("/control", b"{}", Content_Type="application/json", Origin=viewer.url)[0] == 200
    for origin in (viewer.url.replace("http:", "https:"), f"http://127.0.0.1:{viewer.port + 1}", "null"):
        assert viewer.get("/control", b"{}", Content_Type="application/json", Origin=origin)[0] == 403
    behind_tls = {"Host": "localhost", "X-Forwarded-Proto": "https", "Content-Type": "application/json"}
    assert viewer.get("/control", b"{}", **behind_tls, Origin="https://localhost")[0] == 200
    assert viewer.get("/control", b"{}", **behind_tls, Origin="http://localhost")[0] == 403


def test_every_answer_keeps_the_page_to_itself(viewer):
    for path in ("/", "/viewer.js", "/healthz", "/nowhere", "/snapshot.jpg"):
        connection = http.client.HTTPConnection("127.0.0.1", viewer.port)
        connection.request("GET", path)
        headers = connection.getresponse().headers
        assert headers["Content-Security-Policy"].startswith("default-src 'self';")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        connection.close()


def test_health_names_who_stalls_and_comes_back(viewer, simulated):
    simulated.publishing -= {"sampler", "renderer"}
    eventually(lambda: viewer.state("sampler") == "stalled", "the sampler shown as stalled")
    assert viewer.get("/healthz")[0] == 503
    assert (viewer.state("capture"), viewer.state("renderer")) == ("live", "waiting")
    eventually(lambda: viewer.state("sampler") == viewer.state("renderer") == "silent", "both shown as silent")
    simulated.publishing |= {"sampler", "renderer"}
    eventually(lambda: viewer.get("/healthz")[0] == 200, "health again")


def test_invalid_messages_are_counted_and_change_nothing(viewer, simulated):
    before = viewer.health()["services"][-1]
    random = np.random.default_rng(7)
    simulated.noise += [[topic, random.bytes(50)] for topic in (b"image", b"status", b"end") for _ in range(3)]
    simulated.noise += [wire.pack(wire.ControlMessage()), [b"endless", b""], [b"status"] * 9]
    refused = before["refused"] + 11  # all but the control, whose topic is not subscribed to
    eventually(lambda: viewer.health()["services"][-1]["refused"] >= refused, "the noise counted")
    eventually(lambda: viewer.health()["services"][-1]["frames"] > before["frames"] + 25, "frames as before")


def test_its_own_status(viewer, simulated):
    status = eventually(lambda: simulated.viewers and simulated.viewers[-1], "the viewer's status")
    assert (status.service, status.restarts) == ("viewer", 0)
    assert status.frames > 0


def test_a_page_gets_one_of_each_feed_until_it_asks(viewer):
    async def page() -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{viewer.url}/ws") as socket:
            first = [await socket.receive(PATIENCE_S) for _ in range(4)]
            assert sorted(kind_of(message) for message in first) == ["disc", "lights", "picture", "summary"]
            with pytest.raises(TimeoutError):  # 0.5 s: 12 frames later none has followed
                await socket.receive(0.5)
            for _ in range(3):
                await socket.send_str("disc")
                assert kind_of(await socket.receive(PATIENCE_S)) == "disc"
            await socket.send_str("everything")
            assert (await socket.receive(PATIENCE_S)).type is aiohttp.WSMsgType.CLOSE

    asyncio.run(page())


def kind_of(message: aiohttp.WSMessage) -> str:
    if message.type is aiohttp.WSMsgType.TEXT:
        return "lights" if "schema" in json.loads(message.data) else "summary"
    assert decoded(message.data[1:]).ndim == 3
    return {1: "disc", 2: "picture"}[message.data[0]]


def test_pages_are_bounded_and_come_free(viewer):
    open_ones = [http.client.HTTPConnection("127.0.0.1", viewer.port) for _ in range(MAX_PAGES)]
    for connection in open_ones:
        connection.request("GET", "/stream.mjpg")
        assert connection.getresponse().status == 200
    assert viewer.get("/stream.mjpg")[0] == 503
    assert viewer.get("/snapshot.jpg")[0] == 200
    for connection in open_ones:
        connection.close()
    eventually(lambda: viewer.health()["pages"] == 0, "the pages let go")


TOKEN = "0123456789-abcdef_XYZ"


@pytest.fixture
def guarded(tmp_path, simulated) -> Iterator[ViewerProcess]:
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path, more=f'token = "{TOKEN}"')
    assert f"{viewer.url}/?token={TOKEN} (for this machine only)" in viewer.first_line()
    yield viewer
    viewer.end()


def test_requests_without_the_token_are_refused(guarded):
    with_cookie = {"Cookie": f"vemlight-{guarded.port}={cookie_of(TOKEN)}"}
    for path in ("/", "/viewer.js", "/healthz", "/metrics", "/lights", "/snapshot.jpg", "/ws", "/nowhere", "/?action=stream"):
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Cookie": f"vemlight-{guarded.port + 1}={cookie_of(TOKEN)}"}):
            status, line = guarded.get(path, **headers)
            assert (status, line.count(b"\n"), TOKEN.encode() in line) == (401, 1, False)
        assert guarded.get(f"{path}{'&' if '?' in path else '?'}token={TOKEN[:-1]}")[0] == 401
    assert guarded.choose(count=3)[0] == 401
    assert guarded.get("/metrics", Authorization=f"Bearer {TOKEN}")[0] == 200
    assert guarded.get(f"/metrics?token={TOKEN}")[0] == 200
    assert guarded.get("/control", b'{"count": 3}', Content_Type="application/json", **with_cookie)[0] == 200
    assert guarded.get("/", Host="attacker.example", **with_cookie)[0] == 403  # the token opens nothing else
    assert guarded.get("/ws", Origin="http://attacker.example", **with_cookie)[0] == 403


def test_the_address_gives_the_browser_its_cookie(guarded):
    connection = http.client.HTTPConnection("127.0.0.1", guarded.port)
    connection.request("GET", f"/?token={TOKEN}")
    answer = connection.getresponse()
    answer.read()
    assert (answer.status, answer.headers["Location"]) == (303, "/")  # the token is not left in the address
    cookie, *flags = answer.headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Lax"} <= set(flags)
    connection.request("GET", "/", headers={"Cookie": cookie})
    assert connection.getresponse().status == 200
    connection.close()


def test_wrong_tokens_are_limited_and_the_cookie_is_not(guarded):
    with_cookie = {"Cookie": f"vemlight-{guarded.port}={cookie_of(TOKEN)}"}
    statuses = [guarded.get(f"/metrics?token=wrong-number-{k}")[0] for k in range(GUESSES_BURST + 5)]
    assert statuses[:GUESSES_BURST] == GUESSES_BURST * [401]
    assert statuses[-1] == 429
    assert guarded.get(f"/metrics?token={TOKEN}")[0] == 429  # not even compared
    assert guarded.get("/metrics")[0] == 401
    assert guarded.get("/metrics", **with_cookie)[0] == 200
    assert guarded.get("/metrics", Cookie=f"vemlight-{guarded.port}={TOKEN}")[0] == 401  # the token is no cookie


def test_a_page_that_sends_without_a_pause_is_cut(viewer):
    async def page(ping: bool) -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{viewer.url}/ws") as socket:
            for _ in range(100 * MESSAGES_BURST):
                await (socket.ping() if ping else socket.send_str("disc"))

    for ping in (False, True):
        with pytest.raises(ConnectionError):
            asyncio.run(page(ping))
    assert viewer.get("/healthz")[0] == 200


@pytest.mark.parametrize(("more", "words"), [("", "everyone on the network who has this address"), ("insecure = true", "EVERYONE")])
def test_whoever_listens_to_the_network_has_a_token_or_says_so(tmp_path, more, words):
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path, more=f'host = "0.0.0.0"\n{more}')
    line = viewer.first_line()
    assert f"(for {words}" in line
    _, _, token = line.partition("/?token=")
    assert viewer.get("/metrics")[0] == (200 if more else 401)
    assert bool(token) != bool(more)
    if token:
        assert viewer.get(f"/metrics?token={token.split()[0]}")[0] == 200
    viewer.end()


def test_a_viewer_that_starts_waits_for_the_pages_before_it_publishes_no_choices(tmp_path):
    tmp_path.chmod(0o700)
    simulated = SimulatedServices(Wire(folder=str(tmp_path)))
    simulated.start()
    viewer = ViewerProcess(tmp_path)
    viewer.first_line()
    eventually(lambda: len(simulated.viewers) >= 2, "two statuses")
    assert simulated.controls == []
    viewer.choose(count=31)
    eventually(lambda: simulated.controls and simulated.controls[0] == wire.ControlMessage(count=31), "what the page chose")
    viewer.end()
    simulated.controls.clear()
    again = ViewerProcess(tmp_path, port=viewer.port)
    eventually(lambda: simulated.controls and simulated.controls[0] == wire.ControlMessage(), "nothing, where no page comes back")
    again.end()
    simulated.end()


def test_before_any_message_has_come(tmp_path):
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path)
    viewer.first_line()
    assert viewer.get("/snapshot.jpg") == (503, b"no picture yet: the renderer has sent none\n")
    assert viewer.get("/lights")[0] == viewer.get("/healthz")[0] == 503
    assert {row["state"] for row in viewer.health()["services"][:-1]} == {"not seen"}
    assert viewer.get("/metrics")[0] == 200

    viewer.end()


def test_a_taken_port_is_one_line_and_status_2(tmp_path):
    tmp_path.chmod(0o700)
    with socket.create_server(("127.0.0.1", 0)) as holder:
        viewer = ViewerProcess(tmp_path, port=holder.getsockname()[1])
        _, errors = viewer.process.communicate(timeout=PATIENCE_S)
    assert viewer.process.returncode == 2
    assert errors.count("\n") == 1
    assert f"127.0.0.1:{viewer.port}: the viewer cannot listen there" in errors


def test_in_lossless_mode_controls_have_no_effect(tmp_path):
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path, top='mode = "lossless"')
    viewer.first_line()
    status, line = viewer.choose(count=3)
    assert (status, line[:14]) == (400, b"in lossless mo")
    viewer.end()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_pages_open(tmp_path, number):
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path)
    viewer.first_line()
    stream = http.client.HTTPConnection("127.0.0.1", viewer.port)
    stream.request("GET", "/stream.mjpg")
    assert stream.getresponse().status == 200
    viewer.process.send_signal(number)
    _, errors = viewer.process.communicate(timeout=PATIENCE_S)
    assert (viewer.process.returncode, errors) == (0, "")
