"""Controls of a camera: what adjusts itself is stopped, what is asked for is set and read back, and all is restored in the end."""

from types import SimpleNamespace

import pytest

from vemlight.capture import camera_controls as module
from vemlight.capture.camera_controls import CameraControls, controls_of
from vemlight.capture.camera_source import raw_attributes
from vemlight.capture.v4l2 import RawFrame
from vemlight.errors import UserError

device = pytest.importorskip("linuxpy.video.device", reason="linuxpy is for Linux")
AUTO, EXPOSURE, GAIN, AUTOGAIN, POWER_LINE = 0x009A0901, 0x009A0902, 0x00980913, 0x00980912, 0x00980918


class Driver:
    """Controls by id: [name, type, minimum, maximum, flags, value]. stubborn: ids that keep their value."""

    def __init__(self, rows, stubborn=(), grabbed_while=()):
        self.rows, self.stubborn, self.grabbed_while, self.log = (
            {row[0]: list(row[1:]) for row in rows},
            set(stubborn),
            dict(grabbed_while),
            [],
        )

    def iterate(self, _device):
        for id_, (name, kind, low, high, flags, _) in self.rows.items():
            yield SimpleNamespace(id=id_, name=name.encode(), type=kind, minimum=low, maximum=high, flags=flags)

    def get(self, _device, id_):
        if id_ not in self.rows:
            raise OSError(22, "Invalid argument")
        return self.rows[id_][5]

    def set(self, _device, id_, value):
        blocker = self.grabbed_while.get(id_)
        if blocker and self.rows[blocker[0]][5] == blocker[1]:
            raise OSError(13, "Permission denied")
        self.log.append((id_, value))
        if id_ not in self.stubborn:
            self.rows[id_][5] = value


WEBCAM = [
    (AUTO, "Auto Exposure", 3, 0, 3, 0, 3), (EXPOSURE, "Exposure Time, Absolute", 1, 3, 2047, 0, 250), (GAIN, "Gain", 1, 0, 100, 0, 64),
    (AUTOGAIN, "Gain, Automatic", 2, 0, 1, 0, 1), (POWER_LINE, "Power Line Frequency", 3, 0, 2, 0, 2),
    (0x00990900, "Codec Thing", 1, 0, 9, 0, 5), (0x00980001, "User Controls", 6, 0, 0, 0, 0), (0x00980914, "Off", 2, 0, 1, 1, 0),
]  # fmt: skip


@pytest.fixture
def driver(monkeypatch):
    def installed(made):
        for name, call in {"iter_read_controls": made.iterate, "get_control": made.get, "set_control": made.set}.items():
            monkeypatch.setattr(device, name, call)
        return made

    return installed


def values(driver):
    return {id_: row[5] for id_, row in driver.rows.items()}


def test_names_are_those_of_v4l2_ctl(driver):
    driver(Driver(WEBCAM))
    assert list(controls_of(3)) == ["auto_exposure", "exposure_time_absolute", "gain", "gain_automatic", "power_line_frequency"]


def test_what_adjusts_itself_is_stopped_and_all_is_restored(driver, capsys):
    camera = driver(Driver(WEBCAM, grabbed_while={EXPOSURE: (AUTO, 3)}))
    before = values(camera)
    controls = CameraControls(3, "/dev/video7", {"exposure_time_absolute": 80, "gain": 10})
    assert {id_: values(camera)[id_] for id_ in (AUTO, EXPOSURE, GAIN, AUTOGAIN, POWER_LINE)} == {
        AUTO: 1, EXPOSURE: 80, GAIN: 10, AUTOGAIN: 0, POWER_LINE: 0,
    }  # fmt: skip
    assert controls.exposure_s == pytest.approx(0.008)
    assert controls.values["gain"] == 10
    assert not capsys.readouterr().err
    controls.restore()
    assert values(camera) == before


def test_what_is_asked_for_wins_over_what_is_stopped(driver):
    camera = driver(Driver(WEBCAM))
    CameraControls(3, "/dev/video7", {"power_line_frequency": 1})
    assert values(camera)[POWER_LINE] == 1


def test_a_camera_that_does_not_obey_is_told(driver, capsys):
    driver(Driver(WEBCAM, stubborn=[AUTO, GAIN]))
    controls = CameraControls(3, "/dev/video8", {"gain": 10})
    line = capsys.readouterr().err
    assert "/dev/video8: does not obey: auto_exposure is 3, gain is 64" in line
    assert controls.values["gain"] == 64


def test_a_camera_without_control_of_its_exposure_is_told(driver, capsys):
    driver(Driver(WEBCAM[2:4]))
    assert CameraControls(3, "/dev/video9", {}).exposure_s is None
    assert "/dev/video9: has no control for its exposure" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wanted", "words"), [({"gian": 3}, "no control gian but auto_exposure"), ({"gain": 101}, "gain = 101 is not in 0 .. 100")]
)
def test_wrong_controls_are_refused_before_anything_is_set(driver, wanted, words):
    camera = driver(Driver(WEBCAM))
    with pytest.raises(UserError, match=words):
        CameraControls(3, "/dev/video7", wanted)
    assert not camera.log


def test_controls_are_in_the_header_of_a_frame(driver):
    driver(Driver(WEBCAM))
    controls = CameraControls(3, "/dev/video7", {"exposure_time_absolute": 80})
    attributes = raw_attributes(RawFrame(None, None, 1, 10**9, 0), 25.0, controls)
    assert attributes["expTime"] == pytest.approx(0.008)
    assert '"exposure_time_absolute": 80' in attributes["vemlight:controls"]
    assert "vemlight:mosaic" not in attributes
    assert "expTime" not in raw_attributes(RawFrame(None, "mono", 1, 10**9, 0), 25.0)


def test_every_automatic_has_a_value_that_stops_it():
    assert module.MANUAL[AUTO] == 1
    assert all(value == 0 for id_, value in module.MANUAL.items() if id_ != AUTO)
