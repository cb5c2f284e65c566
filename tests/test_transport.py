"""Sockets: who may use their folder and their keys, and the limits that each gets."""

import fcntl
import os
import re
import stat

import pytest
import zmq

from vemlight.errors import UserError
from vemlight.runtime import transport, wire
from vemlight.runtime.channels import QUEUE_FRAMES
from vemlight.runtime.transport import Transport, accept_subscriptions, endpoint, make_keys, read_keys, runtime_folder
from vemlight.settings import Wire


@pytest.mark.parametrize(("mode", "accepted"), [
    (0o700, True), (0o500, True), (0o710, False), (0o750, False), (0o720, False), (0o701, False),
])
def test_only_this_user_may_use_the_sockets_folder(tmp_path, mode, accepted):
    folder = tmp_path / "s"
    folder.mkdir()
    folder.chmod(mode)
    if accepted:
        assert runtime_folder(Wire(folder=str(folder))) == folder
    else:
        with pytest.raises(UserError, match="others may use the sockets"):
            runtime_folder(Wire(folder=str(folder)))


def test_a_new_folder_is_for_this_user_alone(tmp_path):
    assert stat.S_IMODE(runtime_folder(Wire(folder=str(tmp_path / "s"))).stat().st_mode) == 0o700


@pytest.mark.parametrize(("excess", "accepted"), [(0, True), (1, False)])
def test_a_sockets_path_has_up_to_107_bytes(tmp_path, excess, accepted):
    longest = len("/renderer.publish")
    folder = str(tmp_path / "s") + "s" * (107 - longest - len(str(tmp_path / "s")) + excess)
    if accepted:
        assert str(runtime_folder(Wire(folder=folder))) == folder
    else:
        with pytest.raises(UserError, match="108 of 107 bytes"):
            runtime_folder(Wire(folder=folder))


def test_an_address_is_locked_by_the_file_that_has_its_name(tmp_path, monkeypatch):
    """Who ends removes the file: another one that had opened it before must not hold a lock on a file without a name."""
    path, flock = tmp_path / "capture.publish.lock", fcntl.flock
    calls: list[int] = []

    def removed_meanwhile(lock: int, how: int) -> None:
        calls.append(lock)
        flock(lock, how)
        if len(calls) == 1:
            path.unlink()

    monkeypatch.setattr(fcntl, "flock", removed_meanwhile)
    lock = transport._locked(path)
    assert len(calls) == 2
    assert os.path.samestat(os.fstat(lock), path.stat())
    with pytest.raises(BlockingIOError):
        transport._locked(path)
    os.close(lock)


def test_an_address_that_cannot_be_locked_is_one_line(tmp_path, monkeypatch):
    made = Transport(Wire(folder=str(tmp_path / "s")))
    monkeypatch.setattr(transport, "_locked", lambda _: os.open(tmp_path / "gone" / "lock", os.O_CREAT))
    with pytest.raises(UserError, match=r"capture.publish.lock: cannot be locked \(No such file or directory\); make room"):
        made.bind("capture", "publish")
    made.close()


def test_a_secret_key_that_others_may_read_is_refused(tmp_path):
    make_keys(tmp_path / "keys")
    (secret,) = (tmp_path / "keys").glob("*.key_secret")
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    public, private = read_keys(tmp_path / "keys")
    assert public != private
    secret.chmod(0o640)
    with pytest.raises(UserError, match="others may read this key"):
        read_keys(tmp_path / "keys")


def test_each_socket_has_limits_against_hostile_peers(tmp_path):
    transport = Transport(Wire(folder=str(tmp_path / "s")))
    sockets = [transport.bind("capture", "publish"), transport.bind("capture", "serve"), transport.subscribe("sampler", "lights")]
    assert [socket.maxmsgsize for socket in sockets] == [1024, 1024, wire.MAX_PART]  # requests and subscriptions are small
    assert transport.subscribe("sampler", "status").maxmsgsize < 2 * wire.MAX_HEADER
    for socket in sockets:
        assert 5000 <= socket.getsockopt(zmq.TCP_MAXRT) <= 30000
        assert socket.sndhwm == socket.rcvhwm == QUEUE_FRAMES == 4
        assert 1000 <= socket.handshake_ivl <= 3000  # a handshake takes 100 ms on a busy machine, and silent peers shall not pile up
        assert socket.linger == 0
        gone_s = socket.tcp_keepalive_idle + socket.tcp_keepalive_cnt * socket.tcp_keepalive_intvl
        assert socket.tcp_keepalive == 1
        assert 3 <= gone_s <= 6  # a host that vanished is noticed in so long
        assert 2 <= socket.tcp_keepalive_cnt <= 5  # one lost packet ends no connection
        assert socket.connect_timeout > 600, "a round trip by a geostationary satellite"
        assert socket.connect_timeout + socket.reconnect_ivl_max + socket.reconnect_ivl <= 950, "a link that heals is found in a second"
    transport.close()


def test_a_publisher_takes_subscriptions_to_channels_alone(tmp_path):
    transport = Transport(Wire(folder=str(tmp_path / "s")))
    publisher = transport.bind("capture", "publish")
    listener = transport.subscribe("capture", "map")
    listener.subscribe(b"a topic of nobody's")
    received = []
    for _ in range(200):
        accept_subscriptions(publisher)
        publisher.send_multipart([b"a topic of nobody's"], zmq.NOBLOCK)
        publisher.send_multipart([b"map"], zmq.NOBLOCK)
        while listener.poll(5):
            received += listener.recv_multipart()
        if len(received) > 3:
            break
    assert set(received) == {b"map"}
    transport.close()


def test_a_socket_belongs_to_one_process(tmp_path):
    settings = Wire(folder=str(tmp_path / "s"))
    first, second = Transport(settings), Transport(settings)
    first.bind("sampler", "publish")
    with pytest.raises(UserError, match="another sampler runs there"):
        second.bind("sampler", "publish")
    first.close()
    second.bind("sampler", "publish")
    second.close()


def test_each_service_has_two_ports_of_its_own():
    addresses = [endpoint(Wire(transport="tcp", insecure=True), service, role)
                 for service in ("capture", "sampler", "renderer", "viewer", "plate") for role in ("publish", "serve")]
    assert addresses == [f"tcp://127.0.0.1:{port}" for port in range(5600, 5610)]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: b"", "holds no key"),
        (lambda text: text[:-30], "no secret key"),
        (lambda text: text.replace(b'public-key = "', b"public-key "), "holds no key"),
        (lambda text: text.replace(b'secret-key = "', b'secret-key = "#'), "no secret key"),
        (lambda text: text.replace(b'secret-key = "', b"secret-key = \"\xff\xff"), "no secret key"),
        (lambda text: re.sub(rb'(public-key = ").', rb"\1#", text), "do not fit"),
        (lambda text: re.sub(rb'(secret-key = ").{40}', rb"\1" + b"#" * 40, text), "do not fit"),
        (lambda text: text + b"\n" * 4096, "at most 4096"),
    ],
)
def test_a_damaged_key_file_is_one_line_that_names_it(tmp_path, damage, reason):
    make_keys(tmp_path / "keys")
    secret = tmp_path / "keys" / "vemlight.key_secret"
    secret.write_bytes(damage(secret.read_bytes()))
    with pytest.raises(UserError, match=rf"vemlight\.key_secret: .*{reason}"):
        read_keys(tmp_path / "keys")


def test_a_damaged_key_of_a_peer_is_found_before_anybody_connects(tmp_path):
    make_keys(tmp_path / "keys")
    (tmp_path / "keys" / "friend.key").write_text("public-key\n")
    transport = Transport(Wire(transport="tcp", keys=str(tmp_path / "keys")))
    try:
        with pytest.raises(UserError, match=r"friend\.key: holds no key"):
            transport.bind("capture", "publish")
    finally:
        transport.close()
