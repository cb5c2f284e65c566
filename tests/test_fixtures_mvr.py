"""Rigs from MVR and GDTF files: places, axes, addresses, emitters, beams; what is damaged or hostile is refused."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.support import stage_files
from tests.support.stage_files import FIXTURES, FOCUS, HANGING, fixture, gdtf, mvr, packed
from vemlight.errors import UserError
from vemlight.fixtures import packed_xml
from vemlight.fixtures.gdtf import beam_steradians, read_gdtf
from vemlight.fixtures.mvr import read_mvr
from vemlight.fixtures.photometrics import beam_profile
from vemlight.fixtures.rig_file import read_rig


def written(folder: Path, content: bytes, name: str = "stage.mvr") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def test_a_stage_becomes_a_rig(tmp_path):
    rig = read_rig(written(tmp_path, mvr(*FIXTURES, FOCUS)))
    key, fill, head = rig.fixture
    assert rig.target == (0.0, 0.0, 1.6)
    assert (key.universe, key.address) == (2, 1)  # 513, counted through all universes
    assert (fill.universe, fill.address) == (1, 100)
    assert (key.at, key.aim) == ((2.0, 1.0, 4.0), (2.0, 1.0, 3.0))
    np.testing.assert_allclose(fill.at, (0, -3, 3), atol=1e-9)  # in a truss that is turned by 90 degrees
    assert fill.aim == pytest.approx((0, -2, 3), abs=1e-9)
    assert head.aim == (0.0, 0.0, 1.6)  # its focus point
    assert [emitter.name for emitter in key.emitters] == ["Red", "Green", "Blue"]
    assert key.emitters[0].xy == (0.69, 0.308)
    assert (key.bits, key.emitter_slots()) == (16, (1, 3, 5))
    assert key.constants == ((1, 255), (8, 255), (9, 12))  # dimmer full, shutter as highlighted, macro by default
    assert (head.bits, head.emitter_slots()) == (8, (4, 3))
    assert dict(head.constants) == {1: 128}


def test_a_rig_file_may_name_a_stage(tmp_path):
    written(tmp_path, mvr(*FIXTURES))
    more = '[[fixture]]\nname = "more"\nat = [0.0, -2.0, 2.0]\ncandela = 900\nbeam_deg = 30\nuniverse = 9\naddress = 1\n'
    path = tmp_path / "rig.toml"
    path.write_text('target = [0.0, 0.0, 1.5]\nmvr = "stage.mvr"\n' + more)
    assert [each.name for each in read_rig(path).fixture] == ["key", "fill", "head", "more"]
    path.write_text('target = [0.0, 0.0, 1.5]\nmvr = "../stage.mvr"\n')
    with pytest.raises(UserError, match="leads out of its folder"):
        read_rig(path)


@pytest.mark.parametrize("beam_deg", [5.0, 40.0, 120.0])
def test_a_flux_becomes_an_intensity(beam_deg):
    """The intensity on the axis times the profile's integral is the flux, whatever the width."""
    made = read_gdtf("lamp.gdtf", gdtf(flux=5000.0, beam_deg=beam_deg), "Standard")
    z = 1 - 2 * (np.arange(400_000) + 0.5) / 400_000  # all directions by their height
    mean = np.mean(beam_profile(np.degrees(np.arccos(z)), beam_deg))
    assert made.candela * 4 * math.pi * mean == pytest.approx(5000.0, rel=1e-3)
    assert beam_steradians(5.0) == pytest.approx(math.pi * math.radians(2.5) ** 2 / math.log(2), rel=1e-2)


def test_a_dimmer_alone_is_a_white_lamp():
    made = read_gdtf("lamp.gdtf", gdtf(), "White")
    assert len(made.emitters) == 1
    assert (made.emitters[0].slot, made.constants, made.moves) == (1, (), False)


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>'
REFUSED = {
    "no zip": (b"PK\x03\x04 no archive", "no zip archive"),
    "empty": (b"", "no zip archive"),
    "no scene": (packed({"other.xml": b"<a/>"}), "holds no GeneralSceneDescription.xml"),
    "no XML": (packed({"GeneralSceneDescription.xml": b"<a"}), "no XML"),
    "UTF-16": (packed({"GeneralSceneDescription.xml": "<a/>".encode("utf-16")}), "no XML in UTF-8"),
    "DOCTYPE": (mvr(*FIXTURES, FOCUS, head=BOMB), "DOCTYPE, which is refused"),
    "DOCTYPE of the fixture": (mvr(*FIXTURES, FOCUS, lamp=gdtf(head=BOMB)), "Lamp.gdtf | DOCTYPE"),
    "deep": (packed({"GeneralSceneDescription.xml": b"<a>" * 5000 + b"</a>" * 5000}), "nests more than 64"),
    "no fixture": (mvr(FOCUS), "has 0 fixtures"),
    "no address": (mvr(fixture("key", HANGING + "{0,0,4000}", ""), FOCUS), "fixture key has no address"),
    "odd address": (mvr(fixture("key", HANGING + "{0,0,4000}", "1.x"), FOCUS), "fixture key has no address"),
    "no matrix": (mvr(fixture("key", "{1,0}{0}", "1"), FOCUS), "is no matrix"),
    "far away": (mvr(fixture("key", HANGING + "{0,0,nan}", "1"), FOCUS), "is no place"),
    "no mode": (mvr(fixture("key", HANGING + "{0,0,4000}", "1", "Standrad"), FOCUS), "no mode Standrad | did you mean Standard?"),
    "no light": (mvr(fixture("key", HANGING + "{0,0,4000}", "1", "Nothing"), FOCUS), "0 channels of colour"),
    "no GDTF": (mvr(fixture("key", HANGING + "{0,0,4000}", "1"), FOCUS).replace(b"Lamp.gdtf", b"Lump.gdtf"), "Lamp.gdtf"),
    "GDTF is no zip": (mvr(*FIXTURES, FOCUS, lamp=b"lamp"), "Lamp.gdtf: is no zip archive"),
    "no target": (mvr(*FIXTURES), "has 0 focus points | target = [x, y, z]"),
    "two addresses": (mvr(*(fixture(name, HANGING + "{0,0,4000}", "1") for name in "ab"), FOCUS), "belongs to a, too"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_stage_is_refused_by_one_line(name, tmp_path):
    content, words = REFUSED[name]
    path = written(tmp_path, content)
    with pytest.raises(UserError) as caught:
        read_rig(path)
    assert str(caught.value).startswith(f"{path}: ")
    for word in words.split(" | "):
        assert word in str(caught.value)


def test_what_would_unpack_without_end_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(packed_xml, "MAX_MEMBER_BYTES", 100_000)
    bomb = packed({"GeneralSceneDescription.xml": b"<a>" + b" " * 200_000 + b"</a>"})
    assert len(bomb) < 1000
    with pytest.raises(UserError, match="unpacks to more than 100000 bytes"):
        read_mvr(written(tmp_path, bomb))
    many = mvr(*FIXTURES, FOCUS, lamp=packed({"description.xml": b"<a>" + b" " * 99_000 + b"</a>"}))
    with pytest.raises(UserError):
        read_mvr(written(tmp_path, many))


def test_a_limit_holds_for_all_that_is_read_of_an_archive():
    archive = packed_xml.PackedXml("a.mvr", packed({"a": bytes(2**25), "b": bytes(2**25), "c": b"x"}))
    archive.member("a")
    archive.member("b")
    with pytest.raises(UserError, match="c unpacks to more than"):
        archive.member("c")
    assert stage_files.packed({}) != b""
