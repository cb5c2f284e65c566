"""The fixtures' service as a process, seen by a receiver at another address: live when armed, held, restarted, terminated."""

import os
import signal
import time

import msgspec
import numpy as np
import pytest

from tests.support.processes import LOADED_S, children, wait_until
from tests.support.sacn_receiver import SacnReceiver, accepted, most_in_a_second
from vemlight.errors import UserError
from vemlight.fixtures import service
from vemlight.fixtures.last_look import FILE, forget_look, load_look, save_look
from vemlight.fixtures.rig_file import read_rig
from vemlight.fixtures.sender import MAX_HZ
from vemlight.fixtures.slots import universes_of
from vemlight.settings_file import check_settings

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

    os.kill(pids["fixtures"], signal.SIGKILL)  # restarted, it goes on with the look, in sequences that a receiver accepts
    killed_s = time.monotonic()
    wait_until(lambda: children(process.pid).get("fixtures") not in (None, pids["fixtures"]), "a restart")
    again = receiver.wait_for(lambda packet: packet.at_s > killed_s + 0.1, LOADED_S)
    assert again.slots == held[1].slots  # without any light: the sampler is still stopped
    assert not again.preview
    os.kill(pids["sampler"], signal.SIGCONT)
    receiver.wait_for(lambda packet: packet.at_s > again.at_s and packet.slots != again.slots, LOADED_S)

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


class Sending:
    """A sender, by what is kept of it."""

    def __init__(self, slots) -> None:
        self.slots, self.armed, self.blackout = slots, True, False


def test_a_look_is_kept_for_a_moment_and_for_its_rig(tmp_path, rig, monkeypatch):
    made = read_rig(rig)
    look = universes_of(made, np.array([1000, 2000]))
    save_look(tmp_path, "rig.toml", Sending(look), 5.0)  # type: ignore[arg-type]
    found = load_look(tmp_path, "rig.toml", made)
    assert found
    assert (found.universes, found.armed, found.blackout, found.gain) == (look, True, False, 5.0)
    assert load_look(tmp_path, "other.toml", made) is None
    moved = msgspec.structs.replace(made, fixture=(msgspec.structs.replace(made.fixture[0], universe=2),))
    assert load_look(tmp_path, "rig.toml", moved) is None
    now_ns = time.monotonic_ns()
    monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns + int(31e9))
    assert load_look(tmp_path, "rig.toml", made) is None
    monkeypatch.undo()
    (tmp_path / FILE).write_bytes((tmp_path / FILE).read_bytes()[:-3])
    assert load_look(tmp_path, "rig.toml", made) is None
    forget_look(tmp_path)
    assert load_look(tmp_path, "rig.toml", made) is None
    save_look(tmp_path, "rig.toml", Sending(None), 5.0)  # type: ignore[arg-type]
    assert list(tmp_path.glob("*.look*")) == []


@pytest.mark.parametrize(("error", "is_said"), [(RuntimeError("a fault"), False), (UserError("no port"), True)])
def test_a_fault_says_no_end_because_another_process_goes_on(make_settings, receiver, rig, monkeypatch, error, is_said):
    def shows_and_fails(_settings, stage, sender, *_):
        sender.show(universes_of(stage.system.rig, np.array([40_000, 0])))
        receiver.wait_for(lambda packet: packet.kind == "data")
        raise error

    monkeypatch.setattr(service, "_serve", shows_and_fails)
    settings, _ = make_settings(fixtures={"rig": str(rig), "arm": True})
    with pytest.raises(type(error)):
        service.main(settings)
    time.sleep(0.1)
    assert any(packet.terminated for packet in receiver.data()) == is_said


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
