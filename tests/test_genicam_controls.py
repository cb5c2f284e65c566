"""Features of a GenICam camera: what adjusts itself is stopped, what is asked for is set and read back, and all is restored in the end."""

import struct

import pytest

from tests.support.genicam import RO, Feature, camera_nodes, gige_chunks, real_nodes
from vemlight.capture.genicam_controls import GenicamControls
from vemlight.errors import UserError

NAME = "genicam:1"


def held(nodes, name, wanted):
    controls = GenicamControls(nodes, name)
    try:
        controls.hold(wanted)
    except UserError:
        controls.restore()
        raise
    controls.read_back()
    return controls


def test_what_adjusts_itself_is_stopped_and_all_is_restored(capsys):
    nodes = camera_nodes()
    before = nodes.values()
    controls = held(nodes, NAME, {"ExposureTime": 8000, "Gain": 0})
    stopped = {"ExposureAuto": "Off", "GainAuto": "Off", "BalanceWhiteAuto": "Off", "GammaEnable": False}
    assert {name: nodes.values()[name] for name in stopped} == stopped
    assert (nodes.ExposureTime.value, nodes.Gain.value) == (8000.0, 0.0)
    assert controls.exposure_s == pytest.approx(0.008)
    assert controls.values.items() >= {**stopped, "ExposureTime": 8000.0, "Gain": 0.0}.items()
    assert controls.is_linear
    controls.write("ExposureTime", 100)
    controls.write("ExposureTime", 200)
    assert not capsys.readouterr().err
    controls.restore()
    assert nodes.values() == before
    assert nodes.ExposureTime.log[-1] == 250.0  # while it could still be set, before automatic took over again


def test_what_is_asked_for_wins_over_what_is_stopped():
    nodes = camera_nodes()
    controls = held(nodes, NAME, {"GammaEnable": 1})
    assert nodes.GammaEnable.value is True
    assert nodes.Gamma.value == 1.0
    assert controls.is_linear


def test_a_gamma_that_stays_is_not_linear():
    nodes = camera_nodes()
    nodes.GammaEnable.stubborn, nodes.Gamma.stubborn = True, True
    assert not held(nodes, NAME, {}).is_linear


def test_a_camera_that_does_not_obey_is_told(capsys):
    nodes = camera_nodes()
    nodes.ExposureAuto.stubborn = nodes.Gain.stubborn = True
    held(nodes, "genicam:stubborn", {"Gain": 10})
    line = capsys.readouterr().err
    assert "genicam:stubborn: does not obey: ExposureAuto is Continuous, Gain is 3.0; its light may change by itself" in line


def test_an_exposure_by_rows_obeys_and_what_is_far_off_does_not(capsys):
    class Rows(Feature):
        step = 15.0

        @property
        def value(self):
            return self.step * round(self._own[""] / self.step)

        value = value.setter(Feature.value.fset)

    nodes = camera_nodes()
    nodes.ExposureTime = Rows(250.0, 10, 1e6)
    assert held(nodes, "genicam:rows", {"ExposureTime": 1000}).exposure_s == pytest.approx(1005e-6)
    assert not capsys.readouterr().err
    Rows.step = 300.0
    held(nodes, "genicam:coarse", {"ExposureTime": 1000})
    assert "ExposureTime is 900.0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"Gian": 3}, "genicam:1: has no control Gian"),
        ({"Gain": 25}, "Gain = 25 is not in 0 .. 24"),
        ({"ExposureTime": 9}, r"ExposureTime = 9 is not in 10 .. 1e\+06"),
        ({"GainAuto": 1}, "GainAuto is Continuous, and no number"),
    ],
)
def test_wrong_controls_are_refused_and_leave_the_camera_as_it_was(wanted, words):
    nodes = camera_nodes()
    before = nodes.values()
    with pytest.raises(UserError, match=words):
        held(nodes, NAME, wanted)
    assert nodes.values() == before


@pytest.mark.parametrize(
    ("features", "control", "exposure_s"),
    [
        ({"ExposureTimeAbs": 8000.0, "ExposureTimeRaw": 400}, "ExposureTimeAbs", 0.008),
        ({"ExposureTimeRaw": 400, "ExposureTimeBaseAbs": 20.0}, "ExposureTimeRaw", 0.008),
        ({"ExposureTimeRaw": 400}, "ExposureTimeRaw", None),
        ({}, "ExposureTime", None),
    ],
)
def test_exposures_of_older_cameras(features, control, exposure_s, capsys):
    nodes = camera_nodes()
    del nodes.ExposureTime
    for name, value in features.items():
        setattr(nodes, name, Feature(value, 1, 1e6))
    controls = held(nodes, f"genicam:{control}{len(features)}", {})
    assert controls.time_control == control
    assert controls.exposure_s == (None if exposure_s is None else pytest.approx(exposure_s))
    assert ("does not tell its exposure" in capsys.readouterr().err) == (exposure_s is None)


def test_what_cannot_be_set_is_as_the_camera_is_built(capsys):
    nodes = camera_nodes()
    nodes.GainAuto.mode = RO
    held(nodes, "genicam:built", {})
    assert not capsys.readouterr().err


def test_by_genapi_itself_exposure_is_unlocked_set_restored_and_told_by_chunks():
    genapi = pytest.importorskip("genicam.genapi", reason="harvesters is not installed: pip install 'vemlight[genicam]'")
    nodes, port = real_nodes()
    memory = port.memory
    before = bytes(memory)
    controls = held(nodes, NAME, {"ExposureTime": 8000})
    assert struct.unpack_from(">d", memory, 32) == (8000.0,)
    assert struct.unpack_from(">I", memory, 16) == (0,)
    assert controls.values == {"ExposureAuto": "Off", "ExposureTime": 8000.0}
    assert controls.exposure_s == pytest.approx(0.008)
    assert controls.read("ChunkExposureTime") is None  # no frame has come
    adapter = genapi.ChunkAdapterGEV(nodes)
    for k, exposure_us in enumerate((7990.0, 125.0)):
        buffer = gige_chunks(bytes(16), exposure_us)
        _ = adapter.update_buffer(buffer) if k else adapter.attach_buffer(buffer, len(buffer))
        assert controls.read("ChunkExposureTime") == exposure_us
    with pytest.raises(UserError, match="has no control Gain"):
        controls.limits("Gain")
    assert controls.limits("ExposureTime") == (10.0, 1e6)
    controls.restore()
    assert bytes(memory) == before
