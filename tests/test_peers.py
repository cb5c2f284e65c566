"""Peers past their limits are disconnected, by what they do; those that keep to the protocol are not."""

import time
from collections.abc import Iterator

import pytest
import zmq

from tests.support.hostile_peers import zmtp
from tests.support.processes import free_port, wait_until
from vemlight.runtime import peer_guard, wire
from vemlight.runtime.peers import MANY_PARTS, PEERS, REFUSED_BURST, SUBSCRIPTIONS_BURST, WORK, receive
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.sync import receive_all
from vemlight.runtime.transport import MAX_ASKED, Transport, accept_subscriptions, endpoint
from vemlight.settings import Wire

PATIENCE_S = 20.0  # a peer is cut within 0.1 s on an idle machine


@pytest.fixture(params=["ipc", "tcp"])
def settings(request, tmp_path) -> Wire:
    if request.param == "ipc":
        return Wire(folder=str(tmp_path / "s"))
    return Wire(transport="tcp", insecure=True, port=free_port() // 10 * 10)


@pytest.fixture
def transport(settings) -> Iterator[Transport]:
    transport = Transport(settings)
    yield transport
    transport.close()


@pytest.fixture
def client(settings) -> Iterator[Transport]:
    client = Transport(settings)
    yield client
    client.close()


def greeted(settings: Wire, role, kind: bytes):
    connection = zmtp.opened(endpoint(settings, "capture", role))
    zmtp.greet(connection, kind)
    return connection


def is_ended(connection) -> bool:
    """Whether the other side ends it, in time."""
    connection.settimeout(PATIENCE_S)
    try:
        while connection.recv(4096):
            continue
    except TimeoutError:
        return False
    except ConnectionError:
        return True
    return True


@pytest.mark.parametrize("part", [b"", bytes(MAX_ASKED), bytes(MAX_ASKED + 1)], ids=["empty", "largest", "too large"])
def test_a_message_without_end_is_cut(transport, settings, part, capsys):
    bound = transport.bind("capture", "serve")
    with greeted(settings, "serve", b"DEALER") as connection:
        assert zmtp.send_until_cut(connection, 1000 * zmtp.frame(part, zmtp.MORE), PATIENCE_S) is not None
    if len(part) <= MAX_ASKED:
        wait_until(lambda: "capture: disconnected" in capsys.readouterr().err, "a line that says so")
    bound.close()


def test_on_tcp_the_bytes_of_a_message_without_end_are_counted():
    settings = Wire(transport="tcp", insecure=True, port=free_port() // 10 * 10)
    transport = Transport(settings)
    bound = transport.bind("capture", "serve")
    part = zmtp.frame(bytes(1000), zmtp.MORE)
    with greeted(settings, "serve", b"DEALER") as connection:
        for _ in range(3 * peer_guard.MAX_UNASKED // len(part)):  # slowly: no bytes wait, and memory hardly grows
            try:
                connection.sendall(part)
            except OSError:
                break
            time.sleep(0.001)
        assert is_ended(connection)
    bound.close()
    transport.close()


def test_a_publisher_of_frames_without_end_is_cut(settings, client, monkeypatch):
    monkeypatch.setattr(peer_guard, "MAX_UNFINISHED", 2**20)
    monkeypatch.setattr(peer_guard, "MAX_GROWTH", 2**25)
    monkeypatch.setattr(peer_guard, "MAX_GROWTH_UNASKED", 2**25)
    with zmtp.listening(endpoint(settings, "capture", "publish")) as listener:
        subscriber = client.subscribe("capture", "map")
        connection, _ = listener.accept()
        with connection:
            zmtp.greet(connection, b"XPUB")
            assert zmtp.send_until_cut(connection, zmtp.frame(bytes(2**20), zmtp.MORE), PATIENCE_S) is not None
    subscriber.close()


def test_memory_that_a_step_takes_is_nobodys_message(monkeypatch):
    guard = peer_guard.PeerGuard(zmq.Context.instance())
    guard.stop()
    memory, searched = [0], []
    monkeypatch.setattr(peer_guard, "_memory", lambda: memory[0])
    monkeypatch.setattr(guard, "_search", searched.append)
    guard._look()
    with WORK:
        memory[0] = 2 * peer_guard.MAX_GROWTH
        guard._look()
    guard._look()
    assert not searched  # it is the service's own from now on
    memory[0] *= 2
    guard._look()
    assert searched.pop() > peer_guard.MAX_GROWTH
    with WORK:
        memory[0] += peer_guard.MAX_OWN_GROWTH  # a step is no cover for what nobody needs
        guard._look()
    assert searched


def test_whole_requests_are_no_message_without_end_however_many_come(transport, client):
    router, dealer = transport.bind("capture", "serve"), client.request_from("capture")
    request = wire.pack(wire.RequestMessage(first=0, count=1))
    senders = set()
    for _ in range(3 * peer_guard.MAX_UNASKED // len(request[1]) // 3):
        for _ in range(3):
            dealer.send_multipart(request)
        for _ in range(3):
            assert router.poll(5000)
            senders.add(receive(router).sender)
    senders.discard(None)  # of the first ones, before the connection was noted
    (peer,) = senders
    assert peer
    assert not peer.offence
    assert peer in PEERS.values()  # still connected


def test_who_sends_unreadable_messages_is_cut_after_a_few(transport, client, settings):
    router, dealer = transport.bind("capture", "serve"), client.request_from("capture")
    stats = ServiceStats("capture", 0)
    senders = set()

    def take(count: int) -> None:
        for k in range(count):
            dealer.send_multipart([b"request", b"%d" % k])
            assert router.poll(5000)
            parts, sender = receive(router)
            with pytest.raises(ValueError):
                wire.unpack(parts[1:])
            stats.on_refused(ValueError("unreadable"), sender)
            senders.add(sender)

    while not senders - {None}:  # the first ones may come before the connection is noted
        take(1)
    senders.discard(None)
    take(REFUSED_BURST - 1)
    (sender,) = senders
    assert not sender.offence
    take(4)  # in a second or two, one is forgiven
    assert "cannot be read" in sender.offence
    wait_until(lambda: sender not in PEERS.values(), "the peer gone")


def test_a_peer_may_subscribe_to_every_kind_and_not_without_end(transport, settings):
    publisher = transport.bind("capture", "publish")
    with greeted(settings, "publish", b"SUB") as connection:
        connection.sendall(b"".join(zmtp.frame(b"\x01" + kind.encode()) for kind in wire.KINDS))
        received = 0
        for _ in range(200):
            accept_subscriptions(publisher)
            publisher.send_multipart([b"map"], zmq.NOBLOCK)
            connection.settimeout(0.02)
            try:
                received += len(connection.recv(4096))
            except TimeoutError:
                continue
            break
        assert received
        connection.sendall(b"".join(zmtp.frame(b"\x01topic %d" % k) for k in range(2 * SUBSCRIPTIONS_BURST)))
        until_s, ended = time.monotonic() + PATIENCE_S, False
        while not ended and time.monotonic() < until_s:
            accept_subscriptions(publisher)
            try:
                ended = not connection.recv(4096)
            except TimeoutError:
                continue
            except ConnectionError:
                ended = True
    assert ended


def test_of_a_message_of_many_parts_a_few_are_kept_and_the_next_message_is_whole(transport, client):
    router, dealer = transport.bind("capture", "serve"), client.request_from("capture")
    dealer.send_multipart((MANY_PARTS - 1) * [b"x"])
    dealer.send_multipart([b"a", b"b"])
    assert router.poll(5000)
    parts, sender = receive(router)
    assert len(parts) == wire.MAX_PARTS + 2
    assert sender
    assert not sender.offence
    assert router.poll(5000)
    assert receive(router).parts[1:] == [b"a", b"b"]
    dealer.send_multipart(3 * MANY_PARTS * [b""])
    assert router.poll(5000)
    assert len(receive(router).parts) == wire.MAX_PARTS + 2
    assert "parts" in sender.offence


def test_one_peer_too_many_is_refused_and_let_in_when_another_leaves(transport, settings, monkeypatch, capsys):
    monkeypatch.setattr(peer_guard, "peer_limit", lambda: 2)
    publisher = transport.bind("capture", "publish")
    clients = [Transport(settings) for _ in range(3)]

    def hears(listener) -> bool:
        accept_subscriptions(publisher)
        publisher.send_multipart(wire.pack(wire.EndMessage(sequence=0)), zmq.NOBLOCK)
        heard = bool(listener.poll(20))
        while listener.poll(0):
            listener.recv_multipart()
        return heard

    first, second = (client.subscribe("capture", "end") for client in clients[:2])
    wait_until(lambda: hears(first) and hears(second), "two peers served")
    third = clients[2].subscribe("capture", "end")
    said = []
    wait_until(lambda: said.append(capsys.readouterr().err) or "refused a peer: 2 are connected" in "".join(said), "the third refused")
    assert not hears(third)
    wait_until(lambda: hears(first) and hears(second), "the two served as before")
    clients[0].close()
    wait_until(lambda: hears(third), "the third served")
    for client in clients[1:]:
        client.close()


def test_the_address_of_a_hostile_peer_is_held_for_a_while_and_then_free(transport, settings, monkeypatch):
    monkeypatch.setattr(peer_guard, "HOLD_S", 0.5)
    bound = transport.bind("capture", "serve")
    with greeted(settings, "serve", b"DEALER") as connection:
        assert zmtp.send_until_cut(connection, 1000 * zmtp.frame(bytes(100), zmtp.MORE), PATIENCE_S) is not None
    cut_s = time.monotonic()

    def is_let_in() -> bool:
        try:
            with greeted(settings, "serve", b"DEALER") as connection:
                return zmtp.send_until_cut(connection, zmtp.frame(b"x"), 0.2, 0.05) is None
        except OSError:
            return False

    wait_until(is_let_in, "the address free")
    assert time.monotonic() - cut_s > 0.4
    bound.close()


def test_messages_within_a_process_have_no_sender():
    context = zmq.Context()
    one, other = context.socket(zmq.PAIR), context.socket(zmq.PAIR)
    one.bind("inproc://here")
    other.connect("inproc://here")
    other.send_multipart([b"status", b""])
    assert receive(one) == ([b"status", b""], None)
    other.send_multipart([b"status", b""])
    stats = ServiceStats("viewer", 0)
    assert receive_all(one, stats) == []
    assert stats.refused == 1
    context.destroy(linger=0)
