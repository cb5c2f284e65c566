"""`vemlight dmx` with a file of lights: levels as records, and a play at its own times that ends as a signal says."""

import json
import signal
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.lights_files import write_lights
from tests.support.processes import LOADED_S, vemlight
from tests.support.sacn_receiver import SacnReceiver
from vemlight.light.light_set import LightSet, lights_row

RIG = Path(__file__).parents[1] / "services" / "fixtures" / "rigs" / "dome.toml"


@pytest.fixture
def lights(tmp_path) -> Path:
    """Two seconds in which the light goes from above to +x, then half a second without any."""
    rows = []
    for k in range(25):
        angle = k / 24 * np.pi / 2
        made = LightSet.of(np.zeros(1), np.array([[np.sin(angle), 0, np.cos(angle)]]), np.array([[3.0, 2.0, 1.0]]))
        rows.append(lights_row(made if k < 20 else LightSet.none(), k, k / 10, "sphere"))
    path = tmp_path / "lights.jsonl"
    write_lights(path, rows)
    return path


def test_levels_are_written_as_records(lights, tmp_path):
    out = tmp_path / "levels.jsonl"
    done = vemlight("dmx", "bundled", "--lights", lights, "--out", out)
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert [row["sequence"] for row in rows] == list(range(25))
    assert all(row["schema"] == "vemlight.levels/1" for row in rows)
    for row in rows:
        for fixture in row["fixtures"]:
            sixteen = [coarse * 256 + fine for coarse, fine in zip(fixture["dmx"][::2], fixture["dmx"][1::2], strict=True)]
            np.testing.assert_allclose(fixture["levels"], np.array(sixteen) / 65_535, atol=1e-5)
    tops = [max(max(fixture["levels"]) for fixture in row["fixtures"]) for row in rows]
    assert tops[0] == pytest.approx(0.8, abs=0.01)
    assert tops[-1] == 0  # without lights
    assert rows[-1]["unmatched"] == 0
    assert "gain = " in done.stderr
    assert vemlight("dmx", "bundled", "--lights", lights, "--out", "-").stdout.count("\n") == 25


def test_a_play_keeps_its_times_holds_and_ends(lights, tmp_path, services):
    receiver = SacnReceiver("127.0.0.35")
    receiver.start()
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.read_text().replace('"127.0.0.1"', f'"127.0.0.35:{receiver.port}"'))
    process = services.start("vemlight", "dmx", str(rig), "--lights", str(lights))
    first = receiver.wait_for(lambda packet: packet.kind == "data", LOADED_S)
    dark = receiver.wait_for(lambda packet: packet.kind == "data" and not any(packet.slots), LOADED_S)
    assert dark.at_s - first.at_s == pytest.approx(2.0, abs=0.4)
    time.sleep(0.3)
    assert process.poll() is None  # it holds the last look
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=LOADED_S) in (0, 130)
    receiver.close()
    assert all(packet.preview for packet in receiver.data())
    assert [packet.terminated for packet in receiver.data()[-4:]] == [False, True, True, True]


def test_a_record_names_what_is_at_full(tmp_path):
    """More light than the rig has."""
    bright = LightSet.of(np.zeros(1), np.array([[0.0, 0, 1]]), np.full((1, 3), 1e7))
    write_lights(tmp_path / "lights.json", [lights_row(bright, 0, 0.0, "sphere")])
    rig = tmp_path / "rig.toml"
    rig.write_text("gain = 1.0\n" + RIG.read_text())
    done = vemlight("dmx", rig, "--lights", tmp_path / "lights.json", "--out", "-")
    (row,) = (msgspec.json.decode(line) for line in done.stdout.splitlines())
    assert "dome 1" in row["limited"]
    assert row["unmatched"] > 0.9
    assert row["unmatched_at"][2] > 0.9
