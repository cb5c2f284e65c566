"""Packets and when they go out: seen by a receiver that is written from the standards' layouts."""

import time

import msgspec
import numpy as np
import pytest

from tests.support.fixture_rigs import beam, rig_of
from tests.support.sacn_receiver import SacnReceiver, accepted, most_in_a_second, parsed
from vemlight.errors import UserError
from vemlight.fixtures import packets
from vemlight.fixtures.rig import Output, Protocol, Rig
from vemlight.fixtures.sender import MAX_HZ, Sender
from vemlight.fixtures.slots import universes_of
from vemlight.fixtures.transmission import KEEP_ALIVE_S, Mode, Transmission, first_transmission, packets_at, source_id

RECEIVER = "127.0.0.31"  # another address than the sender's


def rig_to(port: int = 5568, universes: int = 1, protocol: Protocol = "sacn", **output) -> Rig:
    fixtures = [msgspec.structs.replace(beam(k, [0, 0, 1]), universe=1 + k % universes) for k in range(max(universes, 2))]
    return msgspec.structs.replace(
        rig_of(fixtures), output=Output(protocol=protocol, destination=f"{RECEIVER}:{port}", priority=120, **output)
    )


def look(rig: Rig, level: float) -> dict[int, bytes]:
    return universes_of(rig, np.full(rig.emitter_count, round(level * 65_535)))


@pytest.fixture
def receiver():
    made = SacnReceiver(RECEIVER)
    made.start()
    yield made
    made.close()


def ticks(rig: Rig, looks, mode: Mode = "live", period_s: float = 0.025):
    """The packets of each tick, with its time."""
    state, now_s, sent = first_transmission(rig, 100.0), 100.0, []
    for each in looks:
        state, made = packets_at(rig, bytes(16), state, each, mode, now_s)
        sent.append((now_s, made))
        now_s += period_s
    return sent


def test_a_data_packet_has_the_layout_of_the_standard():
    rig = rig_to(universes=2)
    (_, made), *_ = ticks(rig, [look(rig, 0.5)])
    first, second, sync, discovery = (parsed(packet.content) for packet in made)
    assert (first.universe, second.universe, first.size, sync.size) == (1, 2, 638, 49)
    assert (first.priority, first.preview, first.terminated, first.sync, sync.universe) == (120, False, False, 1, 1)
    assert first.slots == look(rig, 0.5)[1]
    assert discovery.slots == bytes([0, 1, 0, 2])
    assert packets.sacn_group(0x1234) == "239.255.18.52"


def test_artnet_and_ddp_packets():
    content = bytes(range(256)) * 2
    made = packets.artnet_dmx(0x0102, content, sequence=255)
    assert made == b"Art-Net\0" + bytes([0, 0x50, 0, 14, 255, 0, 2, 1, 2, 0]) + content
    assert packets.artnet_dmx(1, content, sequence=256)[12] == 1  # never 0, which says that there is none
    assert packets.artnet_sync() == b"Art-Net\0" + bytes([0, 0x52, 0, 14, 0, 0])
    assert packets.ddp_data(1440, b"abc", sequence=16, last=True) == bytes([0x41, 1, 0x0B, 1, 0, 0, 5, 160, 0, 3]) + b"abc"
    assert packets.ddp_data(0, b"abc", sequence=15, last=False)[:2] == bytes([0x40, 15])


def test_ddp_sends_a_strip_up_to_its_last_slot():
    rig = rig_to(universes=3, protocol="ddp")
    (_, made), *_ = ticks(rig, [look(rig, 1.0)])
    strip = b"".join(packet.content[10:] for packet in made)
    assert len(strip) == 2 * 512 + 18
    assert strip[:6] == bytes(6 * [255])
    assert [packet.content[0] for packet in made] == [0x41]


@pytest.mark.parametrize("protocol", ["sacn", "artnet", "ddp"])
def test_nothing_is_live_before_it_is_armed(protocol):
    rig = rig_to(protocol=protocol)
    sent = [packet for _, made in ticks(rig, 20 * [look(rig, 0.5)], "preview") for packet in made]
    if protocol == "sacn":
        assert sent
        assert all(parsed(packet.content).preview for packet in sent)
    else:
        assert sent == []


def test_equal_packets_become_rare_and_none_is_missed_for_longer_than_a_second():
    rig = rig_to()
    times_s = [at_s for at_s, made in ticks(rig, 400 * [look(rig, 0.5)]) if made]
    assert len([at_s for at_s in times_s if at_s < 100.2]) == 3
    gaps_s = np.diff(times_s[2:])
    assert (gaps_s >= 0.8).all()
    assert (gaps_s <= 1.0).all()
    changing = [made for _, made in ticks(rig, [look(rig, k / 100) for k in range(100)])]
    assert all(changing)
    assert KEEP_ALIVE_S == 0.85


def test_sequences_rise_by_one_and_go_on_after_a_restart():
    rig = rig_to()
    numbers = [parsed(made[0].content).sequence for _, made in ticks(rig, [look(rig, k / 300) for k in range(300)])]
    assert set(np.diff(numbers) % 256) == {1}
    before, after = first_transmission(rig, 1000.0), first_transmission(rig, 1001.0)  # a second later, as a restart is
    assert after.sequences[1] - before.sequences[1] == 40
    assert source_id(rig, "a.toml") == source_id(rig, "a.toml") != source_id(rig, "b.toml")


def test_a_change_is_sent_at_once_after_equal_packets():
    rig = rig_to()
    sent = ticks(rig, 10 * [look(rig, 0.5)] + [look(rig, 0.6)])
    assert sent[-2][1] == []
    assert sent[-1][1]


def test_the_sender_seen_by_a_receiver(receiver):
    rig = rig_to(receiver.port, rate_hz=40)
    sender = Sender(rig, "rig.toml", armed=False, blackout_at_end=False)
    try:
        sender.show(look(rig, 0.25))
        receiver.wait_for(lambda packet: packet.kind == "data")
        assert all(packet.preview for packet in receiver.data())
        sender.arm(True)
        receiver.wait_for(lambda packet: packet.kind == "data" and not packet.preview)
        until_s, k = time.monotonic() + 2.0, 0
        while time.monotonic() < until_s:  # a look every 20 ms
            sender.show(look(rig, (k % 50) / 100))
            time.sleep(0.02)
            k += 1
        live = [packet for packet in receiver.data() if not packet.preview]
        assert most_in_a_second([packet.at_s for packet in live]) <= MAX_HZ
        assert len(accepted(live)) == len(live)
        sender.black_out(True)
        receiver.wait_for(lambda packet: packet.kind == "data" and not any(packet.slots) and not packet.preview)
        dark_s = time.monotonic()
        sender.black_out(False)
        held = receiver.wait_for(lambda packet: packet.at_s > dark_s and any(packet.slots))
        sender.arm(False)
        receiver.wait_for(lambda packet: packet.terminated)
        back = receiver.wait_for(lambda packet: packet.preview and packet.at_s > held.at_s and not packet.terminated)
        stopped = [packet for packet in receiver.data() if held.at_s < packet.at_s < back.at_s and packet.terminated]
        assert [(packet.preview, packet.slots) for packet in stopped] == 3 * [(False, held.slots)]
    finally:
        sender.close()


@pytest.mark.parametrize("blackout", [False, True])
def test_the_end_is_said_three_times_and_is_dark_on_demand_alone(receiver, blackout):
    rig = rig_to(receiver.port)
    sender = Sender(rig, "rig.toml", armed=True, blackout_at_end=blackout)
    sender.show(look(rig, 0.5))
    receiver.wait_for(lambda packet: packet.kind == "data")
    started_s = time.monotonic()
    sender.close()
    assert time.monotonic() - started_s < 1.0
    receiver.wait_for(lambda packet: packet.terminated)
    time.sleep(0.1)
    ended = [packet for packet in receiver.data() if packet.terminated]
    assert len(ended) == 3
    dark = [packet for packet in receiver.data() if not any(packet.slots)]
    assert len(dark) == (6 if blackout else 0)
    assert receiver.data()[-3:] == ended


def test_a_rig_that_never_had_light_sends_nothing(receiver):
    sender = Sender(rig_to(receiver.port), "rig.toml", armed=True, blackout_at_end=True)
    time.sleep(0.2)
    sender.close()
    assert receiver.raw == []


@pytest.mark.parametrize(("output", "words"), [
    ({"destination": "no.such.host.invalid"}, "no.such.host.invalid | no host"),
    ({"destination": "127.0.0.1:0"}, "no port"),
    ({"destination": "127.0.0.1:x"}, "no port"),
    ({"interface": "198.51.100.7"}, "interface 198.51.100.7 | no address"),
])  # fmt: skip
def test_an_output_that_cannot_be_used_is_refused(output, words):
    rig = msgspec.structs.replace(rig_of([beam(0, [0, 0, 1])]), output=Output(**output))
    with pytest.raises(UserError) as caught:
        Sender(rig, "rig.toml", armed=False, blackout_at_end=False)
    for word in words.split(" | "):
        assert word in str(caught.value)


def test_linear_looks_pass_through_what_lies_between(receiver):
    rig = msgspec.structs.replace(rig_to(receiver.port), between="linear")
    sender = Sender(rig, "rig.toml", armed=True, blackout_at_end=False)
    for level in (0.0, 1.0, 0.0):
        sender.show(look(rig, level))
        time.sleep(0.3)
    sender.close()
    first = [packet.slots[0] for packet in receiver.data()]
    assert any(20 < value < 230 for value in first)


def test_a_transmission_that_is_off_sends_nothing():
    rig = rig_to()
    state, made = packets_at(rig, bytes(16), Transmission({1: 0}), look(rig, 1.0), "off", 0.0)
    assert made == []
    assert state.look is None
