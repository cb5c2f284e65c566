"""The file of a rig of cameras: what it says is kept, and what no rig can be is refused with the way out."""

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.fuse.rig_file import CameraRig, RigCamera, check_one_rate, read_camera_rig

GOOD = """pose_deg = 0.1
pose_m = 0.003
[[camera]]
name = "left"
source = "left"
lens = "left.toml"
at = [-0.5, 0.0, 1.0]
[[camera]]
name = "right-2"
source = "/dev/video1"
at = [0.5, 0.0, 1.0]
turn = [0.0, 0.0, 0.7071068, 0.7071068]
gain = [1.0, 2.0, 0.5]
"""


def read(folder, text):
    path = folder / "rig.toml"
    path.write_text(text)
    return read_camera_rig(path)


def test_a_rig_is_what_its_file_says(tmp_path):
    rig = read(tmp_path, GOOD)
    assert (rig.pose_deg, rig.pose_m) == (0.1, 0.003)
    left, right = rig.camera
    assert (left.name, left.source, left.lens, left.response) == ("left", str(tmp_path / "left"), str(tmp_path / "left.toml"), "")
    assert (right.source, right.gain, left.gain) == ("/dev/video1", (1.0, 2.0, 0.5), None)
    np.testing.assert_allclose(rig.centre, (0, 0, 1))
    np.testing.assert_allclose(left.world_from_camera, np.eye(3))
    # A quarter about +Z brings the camera's x to the world's y.
    np.testing.assert_allclose(right.world_from_camera @ (1, 0, 0), (0, 1, 0), atol=1e-6)


def test_a_stream_is_no_path(tmp_path):
    rig = read(tmp_path, GOOD.replace('"left"\nlens', '"rtsp://camera/live"\nlens'))
    assert rig.camera[0].source == "rtsp://camera/live"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "right-2"', 'name = "left"', "two cameras are called left; "),
        ("at = [0.5, 0.0, 1.0]", "at = [-0.495, 0.0, 1.0]", "cameras left and right-2 stand 0.5 cm from each other"),
        ("0.7071068, 0.7071068]", "0.7, 0.8]", "camera right-2: turn = [0, 0, 0.7, 0.8] is no unit quaternion"),
        ("0.7071068, 0.7071068]", "0.0, 0.0]", "is no unit quaternion"),
        ('name = "left"', 'name = "Left Eye"', "line 4: [camera 1] name"),
        ("gain = [1.0, 2.0, 0.5]", "gain = [1.0, 0.0, 0.5]", "gain"),
        ("gain = [1.0, 2.0, 0.5]", "gian = [1.0, 2.0, 0.5]", "did you mean gain?"),
        ("pose_m = 0.003", "pose_m = nan", "nan and inf are refused"),
        ("pose_deg = 0.1", "pose_deg = -0.1", "pose_deg = -0.1"),
        ('source = "left"\n', "", "has no source"),
        ('lens = "left.toml"\n', 'lens = ["a", "b"]\n', "lens"),
    ],
)
def test_no_rig_can_be_so(tmp_path, old, new, words):
    assert old in GOOD
    with pytest.raises(UserError) as error:
        read(tmp_path, GOOD.replace(old, new, 1))
    assert words in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "rig.toml"))


def test_one_camera_is_no_rig(tmp_path):
    with pytest.raises(UserError, match="the rig has 1 cameras"):
        read(tmp_path, GOOD[: GOOD.rindex("[[camera]]")])


def test_cameras_of_another_rate_are_no_rig(tmp_path):
    rig = read(tmp_path, GOOD)
    check_one_rate(tmp_path / "rig.toml", rig, [25.0, 25.0])
    with pytest.raises(UserError, match=r"camera right-2: has 24 frames a second and left has 25; "):
        check_one_rate(tmp_path / "rig.toml", rig, [25.0, 24.0])


def test_cameras_a_finger_apart_are_a_rig():
    places = ((0.0, 0.0, 0.0), (0.011, 0.0, 0.0))
    CameraRig(camera=tuple(RigCamera(name=f"c{n}", source=".", at=at) for n, at in enumerate(places)))
