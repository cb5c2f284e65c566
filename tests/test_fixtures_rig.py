"""The rig file: what is refused, with the fixture or key and a way out; what fixtures give at the target; their slots."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.fixture_rigs import RGB, TARGET, beam, rig_of
from vemlight.errors import UserError
from vemlight.fixtures import rig as rig_module
from vemlight.fixtures.photometrics import MIN_PIECES, pieces_of
from vemlight.fixtures.rig import Emitter, Fixture
from vemlight.fixtures.rig_file import read_rig
from vemlight.fixtures.rig_system import RigSystem
from vemlight.fixtures.slots import between, fixture_slots, universes_of

BUNDLED = Path(rig_module.__file__).parent / "rigs" / "dome.toml"
HEAD = "target = [0.0, 0.0, 1.5]\n"
LAMP = 'name = "key"\nat = [2.0, 0.0, 3.0]\ncandela = 9000\nbeam_deg = 30\naddress = 1\n'
ONE = HEAD + "[[fixture]]\n" + LAMP
SECOND = "[[fixture]]\n" + LAMP.replace("key", "fill").replace("address = 1", "address = 4")



def crowded(k: int) -> str:
    """A fixture of twelve emitters, forty to a universe."""
    lamp = LAMP.replace("key", f"f{k}").replace("address = 1", f"address = {1 + 12 * (k % 40)}")
    emitters = ", ".join(12 * ['{name = "a"}'])
    return f"[[fixture]]\n{lamp}universe = {1 + k // 40}\nemitters = [{emitters}]\n"


REFUSED = {
    "unknown key": (ONE + "candle = 3\n", "line 8 | candle | did you mean candela?"),
    "nan": (ONE.replace("[2.0,", "[nan,"), "fixture 1 | at | nan and inf"),
    "inf": (ONE.replace("9000", "inf"), "candela | nan and inf"),
    "no colour": (ONE + 'emitters = [{name = "red", xy = [0.7, 0.4]}]\n', "emitter red | [0.7, 0.4] | x + y <= 1"),
    "no luminance": (ONE + 'emitters = [{name = "deep", xy = [0.2, 0.0]}]\n', "emitter deep | y > 0"),
    "at the target": (ONE.replace("[2.0, 0.0, 3.0]", "[0.0, 0.05, 1.5]"), "key | within 0.1 m of the target"),
    "aims at itself": (ONE + "aim = [2.0, 0.0, 3.0]\n", "key aims at itself"),
    "overlapping slots": (ONE + 'emitters = [{name = "a"}, {name = "b"}, {name = "c"}, {name = "d"}]\n' + SECOND, "fill | slot 4 | key"),
    "past the universe": (ONE.replace("address = 1", "address = 512") + "bits = 16\n", "key | slot 513 of universe 1 is past 512"),
    "address": (ONE.replace("address = 1", "address = 0"), "address | 0 | >= 1"),
    "universe": (ONE + "universe = 64000\n", "universe | 64000 | <= 63999"),
    "priority": (ONE + "[output]\npriority = 201\n", "priority | 201 | <= 200"),
    "rate": (ONE + "[output]\nrate_hz = 50\n", "rate_hz | 50 | <= 44"),
    "names": (ONE + SECOND.replace("fill", "key"), "two fixtures are named key"),
    "curve": (ONE + "curve = [[0.0, 0.0], [0.6, 0.7], [0.5, 0.8], [1.0, 1.0]]\n", "key | monotonic"),
    "falling curve": (ONE + "curve = [[0.0, 0.0], [0.5, 0.7], [0.6, 0.6], [1.0, 1.0]]\n", "key | monotonic"),
    "curve's name": (ONE + 'curve = "cubic"\n', "curve"),
    "no shape": (ONE.replace("beam_deg = 30\n", ""), "key | beam_deg, size, photometry"),
    "two shapes": (ONE + "size = [1.0, 1.0]\n", "key | beam_deg and size"),
    "no candela": (ONE.replace("candela = 9000\n", ""), "key has no candela"),
    "bits": (ONE + "bits = 12\n", "bits | 12"),
    "no fixture": (HEAD, "fixture"),
    "no target": ("[[fixture]]\n" + LAMP, "target"),
    "gain": ('gain = "loud"\n' + ONE, "gain"),
    "no destination": (ONE + '[output]\nprotocol = "artnet"\n', "artnet has no destination"),
    "artnet universe": (ONE + 'universe = 40000\n[output]\nprotocol = "artnet"\ndestination = "h"\n', "key | 40000 | 32767"),
    "group": (ONE + '[[group]]\nfixtures = ["kye"]\nwatts = 9\n', "kye | no fixture"),
    "group without watts": (ONE + '[[group]]\nfixtures = ["key"]\nwatts = 9\n', "key | no watts"),
    "two groups": (ONE + "watts = 5\n" + 2 * '[[group]]\nfixtures = ["key"]\nwatts = 9\n', "key is in two groups"),
    "slot twice": (ONE + "constants = [[1, 255]]\n", "key writes a slot twice"),
    "not TOML": ("target = [\n", "not TOML"),
    "many emitters": (HEAD + "".join(crowded(k) for k in range(180)), "2160 emitters | 2048"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_rig_is_refused_by_one_line(name, tmp_path):
    text, words = REFUSED[name]
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        read_rig(path)
    assert str(caught.value).startswith(f"{path}: ")
    for word in words.split(" | "):
        assert word in str(caught.value)


def test_the_bundled_rig_is_read_and_stays_on_this_machine():
    rig = read_rig(BUNDLED)
    assert rig.output.destination == "127.0.0.1"
    assert RigSystem.of(rig).blind() == []


def test_a_beam_has_half_its_intensity_at_half_its_width():
    aside = Fixture(name="a", at=(3.0, 0.0, 1.5), aim=(0.0, 3 * math.tan(math.radians(15)), 1.5), candela=900.0, beam_deg=30.0, address=1)
    assert pieces_of(rig_of([aside])).strengths[0] == pytest.approx(50.0)
    centred = msgspec.structs.replace(aside, aim=None)
    assert pieces_of(rig_of([centred])).strengths[0] == pytest.approx(100.0)


@pytest.mark.parametrize("metres", [4.0, 0.5])
def test_a_panel_gives_what_its_surface_integrates_to(metres):
    """A Lambertian panel of radiance L = candela / area, on a plane that faces it."""
    panel = Fixture(name="p", at=(metres, 0.0, 1.5), candela=100.0, size=(1.0, 0.5), address=1)
    pieces = pieces_of(rig_of([panel]))
    y, z = np.meshgrid((np.arange(400) + 0.5) / 400 - 0.5, ((np.arange(400) + 0.5) / 400 - 0.5) / 2)
    r2 = metres**2 + y**2 + z**2
    truth = np.mean(100.0 * metres**2 / r2**2)
    assert pieces.strengths @ pieces.directions[:, 0] == pytest.approx(truth, rel=0.02)
    assert len(pieces.strengths) >= MIN_PIECES**2
    assert np.ptp(pieces.directions[:, 1]) > np.ptp(pieces.directions[:, 2])  # the width lies level


def test_photometry_is_read_and_may_be_scaled(tmp_path):
    table = "\n".join(["IESNA:LM-63-2002", "TILT=NONE", "1 -1 1 3 1 1 2 0 0 0", "1 1 10", "0 45 90", "0", "400 100 0"])
    (tmp_path / "lamp.ies").write_text(table + "\n")
    text = ONE.replace("beam_deg = 30\n", "").replace("candela = 9000\n", 'photometry = "lamp.ies"\n')
    (tmp_path / "rig.toml").write_text(text)
    rig = read_rig(tmp_path / "rig.toml")
    distance2 = math.dist(rig.fixture[0].at, TARGET) ** 2
    assert pieces_of(rig).strengths[0] == pytest.approx(400 / distance2)
    scaled = msgspec.structs.replace(rig, fixture=(msgspec.structs.replace(rig.fixture[0], candela=800.0),))
    assert pieces_of(scaled).strengths[0] == pytest.approx(800 / distance2)
    (tmp_path / "lamp.ies").write_text("no lamp\n")
    with pytest.raises(UserError, match=r"lamp.ies: is no valid photometry"):
        pieces_of(rig)


def test_a_fixture_that_does_not_reach_the_target_is_named():
    away = Fixture(name="away", at=(3.0, 0.0, 1.5), aim=(6.0, 0.0, 1.5), candela=900.0, beam_deg=20.0, address=9)
    assert RigSystem.of(rig_of([beam(0, [0, 0, 1]), away])).blind() == ["away"]


def test_slots_lie_where_the_rig_says():
    fine = beam(0, [0, 0, 1], bits=16)
    fine = msgspec.structs.replace(fine, address=10, constants=((7, 255), (8, 3)))
    coarse = msgspec.structs.replace(
        beam(1, [0, 0, 1], emitters=(Emitter(name="w"), Emitter(name="c", slot=4)), bits=8), universe=2, address=511 - 3
    )
    look = universes_of(rig_of([coarse, fine]), np.array([7, 9, 0x1234, 65_535, 0]))
    assert list(look) == [1, 2]
    assert look[1][9:17] == bytes([0x12, 0x34, 255, 255, 0, 0, 255, 3])
    assert look[2][507:511] == bytes([7, 0, 0, 9])
    assert sum(look[1]) == 0x12 + 0x34 + 3 * 255 + 3
    assert fixture_slots(coarse, np.array([7, 9])) == [(0, 7), (3, 9)]


def test_between_two_looks_sixteen_bits_are_one_number():
    rig = rig_of([msgspec.structs.replace(beam(0, [0, 0, 1], emitters=RGB[:1]), constants=((3, 200),))])
    low, high = (universes_of(rig, np.array([number])) for number in (0x00FF, 0x0101))
    assert between(low, high, 0.5, rig)[1][:3] == bytes([0x01, 0x00, 200])
    assert between(low, high, 0.0, rig)[1] == low[1]
    assert between(low, high, 1.0, rig)[1] == high[1]
