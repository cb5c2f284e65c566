"""A rig measured from end to end: packets to a receiver, lamps that are not what the file says, a virtual camera, the file."""

import math
import time

import msgspec
import numpy as np
import pytest

from tests.support.fixture_rigs import RGB, TARGET, beam, rig_of
from tests.support.sacn_receiver import SacnReceiver
from vemlight.capture.frames import FrameMaker
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.response import Log, write_response
from vemlight.capture.simulation.environment import Environment, SunDisc
from vemlight.capture.simulation.optics import fisheye_radiance
from vemlight.capture.simulation.sensor import VirtualCamera, behind_lens, exposed, fixed_pattern
from vemlight.commands.rig_calibration import seen_of
from vemlight.errors import UserError
from vemlight.fixtures.measuring import Measured, Seen, measure
from vemlight.fixtures.photometrics import emitter_colours
from vemlight.fixtures.rig import Output
from vemlight.fixtures.rig_file import read_rig
from vemlight.fixtures.rig_writing import write_measured
from vemlight.fixtures.sender import Sender
from vemlight.light.sphere import cell_directions, cell_solid_angles
from vemlight.settings import Capture

LENS = Lens(size=(160, 160), f=(50.0, 50.0), c=(79.5, 79.5), k1=-0.01, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)
RESPONSE = Log(bits=12, a=1200.0, b=180.0, c=0.002)
LX_PER_UNIT = 40.0
WALLS = 0.3  # radiance of the room without fixtures, in units of the map
DIRECTIONS = [[0.6, 0.0, 0.8], [-0.5, 0.5, 0.707], [0.0, -0.8, 0.6]]
TEXT = """# our stage
target = [0.0, 0.0, 1.5]   # a head
gain = 100.0

[[fixture]]
name = "beam 0"   # the key
at = {0}
candela = 9000.0 # from the data sheet
beam_deg = 30.0
address = 1
bits = 16
emitters = [ # of the data sheet
  {{name = "red", xy = [0.690, 0.308], share = 0.24}}, # a comment with ] in it
  {{name = "green", xy = [0.190, 0.720], share = 0.66}},
  {{name = "blue", xy = [0.140, 0.050], share = 0.10}},
]

[[fixture]]
name = "beam 1"
emitters = [{{name = "white"}}]
at = {1}
aim = [0.0, 0.0,
  1.5]
beam_deg = 30.0
candela = 9000.0
address = 7

[output]
priority = 120
"""


class Stage:
    """Lamps and a camera: what `look` is given goes out as packets, and what comes in lights the virtual camera's picture."""

    def __init__(self, rig, true_rig, folder, receiver) -> None:
        self.rig, self.true, self.receiver = rig, true_rig, receiver
        self.camera = VirtualCamera(lens=LENS, response=RESPONSE, noise_codes=0.5)
        write_lens(folder / "lens.toml", LENS)
        write_response(folder / "response.toml", RESPONSE)
        self.maker = FrameMaker(Capture(), folder)
        self.sender = Sender(rig, "rig.toml", armed=True, blackout_at_end=True)
        self.looks = 0

    def look(self, slots) -> Seen:
        self.sender.show(slots)
        self.receiver.wait_for(lambda packet: packet.kind == "data" and not packet.preview and packet.slots == slots[1])
        self.looks += 1
        frames = []
        for k in range(2):
            environment = Environment(np.full((32, 64, 3), WALLS), self.suns(slots[1]))
            radiance = behind_lens(fisheye_radiance(environment, np.eye(3), LENS), LENS)
            codes = exposed(radiance, self.camera, fixed_pattern(self.camera, 0), (self.looks, k))
            frames.append(self.maker.frame("f", codes, {"vemlight:kind": "codes"}, k / 25))
        return seen_of(frames)

    def suns(self, slots: bytes) -> list[SunDisc]:
        """The true lamps at what they receive, as small discs."""
        suns = []
        for fixture in self.true.fixture:
            levels = [int.from_bytes(slots[fixture.address - 1 + s : fixture.address + 1 + s]) / 65_535 for s in fixture.emitter_slots()]
            offset = np.subtract(fixture.at, TARGET)
            lux = fixture.candela / (offset @ offset) * np.array(levels) @ emitter_colours(fixture.emitters)
            if lux.any():
                suns.append(SunDisc(offset / np.linalg.norm(offset), math.radians(3), np.maximum(lux, 0) / LX_PER_UNIT))
        return suns


@pytest.fixture
def receiver():
    made = SacnReceiver("127.0.0.33")
    made.start()
    yield made
    made.close()


def measured_by(rig, look) -> Measured:
    *lines, found = measure(rig, look)
    assert isinstance(found, Measured)
    assert len(lines) == len(rig.fixture)
    return found


def test_lamps_that_are_not_what_the_file_says_are_measured(tmp_path, receiver):
    rig = rig_of([beam(k, d) for k, d in enumerate(DIRECTIONS)])
    rig = msgspec.structs.replace(rig, output=Output(destination=f"127.0.0.33:{receiver.port}"))
    colours = ((0.62, 0.34), (0.31, 0.59), (0.17, 0.08))
    shifted = tuple(msgspec.structs.replace(emitter, xy=xy) for emitter, xy in zip(RGB, colours, strict=True))
    candelas = (9000.0, 6000.0, 13_500.0)  # their mean (of logarithms) is that of the file
    true = msgspec.structs.replace(rig, fixture=tuple(
        msgspec.structs.replace(fixture, candela=candela, emitters=shifted)
        for fixture, candela in zip(rig.fixture, candelas, strict=True)
    ))  # fmt: skip
    stage = Stage(rig, true, tmp_path, receiver)
    try:
        found = measured_by(rig, stage.look)
    finally:
        stage.sender.close()
    for fixture, candela in zip(found.fixtures, candelas, strict=True):
        assert fixture.candela == pytest.approx(candela, rel=0.03)
        np.testing.assert_allclose([emitter.xy for emitter in fixture.emitters], [emitter.xy for emitter in shifted], atol=0.012)
        np.testing.assert_allclose(emitter_colours(fixture.emitters), emitter_colours(shifted), atol=0.03)
    assert found.lx_per_unit == pytest.approx(LX_PER_UNIT, rel=0.03)
    assert found.unseen == ()
    time.sleep(0.1)
    assert not any(receiver.data()[-4].slots)  # dark before the end
    live = [packet for packet in receiver.data() if any(packet.slots)]
    assert all(sum(value > 0 for value in packet.slots) <= 2 for packet in live)  # never more than one emitter of 16 bits


def spots(irradiance: list[float], saturated: int = 0):
    """A camera by arithmetic: fixture k gives irradiance[k] in its cell."""
    cells, solid = cell_directions(45, 90, "hemisphere"), cell_solid_angles(45, 90, "hemisphere")

    def look(slots) -> Seen:
        radiance = np.ones((45, 90, 3))
        for k, direction in enumerate(DIRECTIONS):
            i, j = np.unravel_index(int((cells @ np.array(direction)).argmax()), cells.shape[:2])
            radiance[i, j] += irradiance[k] / solid[i] * slots[1][6 * k] / 255
        return Seen(radiance, "hemisphere", saturated if any(slots[1]) else 0, None)

    return look


def test_what_is_not_seen_stays_as_it_was():
    rig = rig_of([beam(k, d, RGB[:1]) for k, d in enumerate(DIRECTIONS)])
    rig = msgspec.structs.replace(rig, fixture=tuple(msgspec.structs.replace(f, address=1 + 6 * k) for k, f in enumerate(rig.fixture)))
    found = measured_by(rig, spots([5.0, 0.0, 5.0]))
    assert found.unseen == ("beam 1",)
    assert found.fixtures[1] == rig.fixture[1]
    with pytest.raises(UserError, match="no fixture is seen"):
        measured_by(rig, spots([0.0, 0.0, 0.0]))
    with pytest.raises(UserError, match="beam 0 clips the camera"):
        measured_by(rig, spots([5.0, 5.0, 5.0], saturated=9))


def test_the_file_keeps_its_comments_and_the_old_one(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(TEXT.format([1.8, 0.0, 3.9], [-1.5, 1.5, 3.6]))
    rig = read_rig(path)
    first, second = rig.fixture
    changed = (
        msgspec.structs.replace(first, candela=8123.4, emitters=tuple(msgspec.structs.replace(e, share=1.5) for e in first.emitters)),
        msgspec.structs.replace(second, candela=77.0),
    )
    old = write_measured(path, changed)
    assert old.read_text() == TEXT.format([1.8, 0.0, 3.9], [-1.5, 1.5, 3.6])
    assert read_rig(path).fixture == changed
    text = path.read_text()
    for comment in ("# our stage", "# a head", "# the key", "# from the data sheet"):
        assert comment in text
    assert read_rig(path).output == rig.output
    assert write_measured(path, changed).name == "rig.old2.toml"


def test_a_text_that_cannot_be_changed_in_place_is_written_anew(tmp_path):
    path = tmp_path / "rig.toml"
    lamp = 'name = "a", at = [0.0, 0.0, 4.0], candela = 9.0, beam_deg = 9.0, address = 1'
    path.write_text(f"target = [0.0, 0.0, 1.5]\nfixture = [{{{lamp}}}] # x\n")
    (only,) = read_rig(path).fixture
    write_measured(path, (msgspec.structs.replace(only, candela=5.0),))
    assert read_rig(path).fixture[0].candela == 5
    assert (tmp_path / "rig.old.toml").read_text().endswith("# x\n")
