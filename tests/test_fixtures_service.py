"""The fixtures' service as a process, seen by a receiver at another address: live when armed, held, restarted, terminated."""

import os
import signal
import time

import pytest

from tests.support.processes import LOADED_S, children, wait_until
from tests.support.sacn_receiver import SacnReceiver, accepted, most_in_a_second
from vemlight.errors import UserError
from vemlight.fixtures.sender import MAX_HZ
from vemlight.settings import check_settings

RECEIVER = "127.0.0.32"
RIG = """
target = [0.0, 0.0, 1.5]
gain = 0.05
[output]
destination = "{address}:{port}"
[[fixture]]
name = "key"
at = [2.0, 1.0, 4.0]
candela = 9000
beam_deg = 30
address = 1
bits = 16
[[fixture]]
name = "fill"
at = [-2.0, 1.0, 3.0]
candela = 9000
beam_deg = 30
address = 3
bits = 16
"""


@pytest.fixture
def receiver():
    made = SacnReceiver(RECEIVER)
    made.start()
    yield made
    made.close()


@pytest.fixture
def rig(tmp_path, receiver):
    path = tmp_path / "rig.toml"
    path.write_text(RIG.format(address=RECEIVER, port=receiver.port))
    return path


def test_a_run_drives_fixtures_and_holds_their_look(run, receiver, rig):
    _, process = run(fixtures={"rig": str(rig), "arm": True}, renderer={"frame_ms": 0, "width": 32, "height": 24})
    receiver.wait_for(lambda packet: packet.kind == "data" and any(packet.slots), LOADED_S)
    pids = children(process.pid)
    assert "fixtures" in pids

    os.kill(pids["sampler"], signal.SIGSTOP)  # no lights: the last look is repeated
    time.sleep(2.2)
    held = receiver.data()[-2:]
    assert any(held[0].slots)
    assert held[0].slots == held[1].slots
    assert held[1].at_s - held[0].at_s < 1.05
    os.kill(pids["sampler"], signal.SIGCONT)

    os.kill(pids["fixtures"], signal.SIGKILL)  # restarted, with sequences that a receiver accepts
    killed_s = time.monotonic()
    wait_until(lambda: children(process.pid).get("fixtures") not in (None, pids["fixtures"]), "a restart")
    receiver.wait_for(lambda packet: packet.at_s > killed_s + 0.3 and any(packet.slots), LOADED_S)

    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=10) == 0
    data = receiver.data()
    ended = [packet for packet in data if packet.terminated]
    assert data[-3:] == ended
    assert any(ended[-1].slots)
    assert not any(packet.preview for packet in data)
    assert len(accepted(data)) >= len(data) - 20
    assert most_in_a_second([packet.at_s for packet in data]) <= MAX_HZ
    _, errors = process.communicate()
    assert b"the last look is held" in errors


def test_files_are_not_made_while_lamps_are_driven(make_settings, rig):
    with pytest.raises(UserError, match=r"\[fixtures\] rig drives lamps"):
        check_settings(make_settings(mode="lossless", fixtures={"rig": str(rig)})[0])


@pytest.mark.parametrize(("text", "words"), [("", "target"), (RIG.format(address="h", port=0), "port")])
def test_a_wrong_rig_ends_the_run_before_it_starts(run, tmp_path, text, words):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    _, process = run(fixtures={"rig": str(path)})
    _, errors = process.communicate(timeout=LOADED_S)
    assert process.returncode == 2
    (line,) = errors.decode().splitlines()
    assert "[fixtures] rig" in line
    assert words in line
