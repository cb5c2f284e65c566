"""Files of lights read frame by frame: what was written comes back, and what no frame of lights is is refused by its line."""

import msgspec
import numpy as np
import pytest

from tests.support.lights_files import write_lights
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet, LightsFile, NearLights, lights_json, lights_row
from vemlight.light.lights_reader import is_lights_file, lights_frames
from vemlight.light.near_lights import NearLightSet

GOOD = b'{"schema":"vemlight.lights/1","sequence":0,"time_s":0.0,"coverage":"sphere","lights":[%s]}\n'
GOOD_2 = GOOD.replace(b"lights/1", b"lights/2")
LIGHT = b'{"id":3,"direction":[0,0,1],"irradiance":[1,2,3]}'


POINT = b'{"id":1,"at":[1,2,3],"intensity":[5,5,5],"radius":0,"sigma":0.1}'


def with_points(points: bytes) -> bytes:
    """A frame of one light and these near lights."""
    return (GOOD_2 % LIGHT)[:-2] + b',"at":[0,0,1],"points":[' + points + b"]}\n"


def some_lights(count: int, soft: bool, seed: int = 0) -> LightSet:
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    covariances = (across * random.uniform(0, 0.1, (count, 1, 1)))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return LightSet.of(random.permutation(10 * count)[:count], directions, random.random((count, 3)), covariances if soft else None)


def test_a_byte_order_mark_is_passed_over(tmp_path):
    (tmp_path / "a.jsonl").write_bytes(b"\xef\xbb\xbf" + GOOD % LIGHT)
    assert [len(frame.lights.ids) for frame in lights_frames(tmp_path / "a.jsonl")] == [1]


@pytest.mark.parametrize("soft", [False, True])
def test_what_was_written_comes_back_to_the_bit(tmp_path, soft):
    sets = [some_lights(count, soft, count) for count in (5, 0, 72)]
    write_lights(tmp_path / "a.jsonl", [lights_row(lights, k, k / 25, "sphere") for k, lights in enumerate(sets)])
    frames = list(lights_frames(tmp_path / "a.jsonl"))
    assert [(frame.sequence, frame.time_s, frame.coverage) for frame in frames] == [(k, k / 25, "sphere") for k in range(3)]
    for frame, lights in zip(frames, sets, strict=True):
        for found, given in zip(frame.lights, lights, strict=True):
            assert (found is None) == (given is None)
            assert found is None or given is None or np.array_equal(found, given)


NEAR = NearLights(
    NearLightSet.of(
        np.array([5, 2**40]), np.array([[1, 2, 3], [0.1, 0, -4]]), np.array([[9, 8, 7], [0, 0, 1e-3]]), np.zeros(2), np.full(2, 0.02)
    ),
    (0.0, 0.25, 1.5),
)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("near", [NEAR, NearLights(NearLightSet.empty(), (0.0, 0.0, 0.0))])
def test_near_lights_come_back_to_the_bit_and_make_version_two_of_the_file(tmp_path, soft, near):
    lights = some_lights(4, soft)
    write_lights(tmp_path / "a.json", [lights_row(lights, 0, 0.0, "sphere", near=near)])
    (frame,) = lights_frames(tmp_path / "a.json")
    assert frame.near
    assert (frame.schema, frame.near.at) == ("vemlight.lights/2", near.at)
    assert (frame.lights.covariances is not None) == soft
    for found, given in zip(frame.near.points.arrays(), near.points.arrays(), strict=True):
        assert found.dtype == given.dtype
        assert found.tolist() == given.tolist()


def test_a_frame_without_near_lights_says_nothing_of_them(tmp_path):
    write_lights(tmp_path / "a.json", [lights_row(some_lights(1, True), 0, 0.0, "sphere")])
    assert b"points" not in (tmp_path / "a.json").read_bytes()
    (frame,) = lights_frames(tmp_path / "a.json")
    assert frame.near is None


def test_a_run_s_chained_lines_and_a_json_over_several_lines_are_read(tmp_path):
    file = LightsFile(tmp_path / "lights.jsonl", can_be_made_again=False)
    file.append(some_lights(3, True), 7, 0.28, "hemisphere")
    file.close()
    (frame,) = lights_frames(tmp_path / "lights.jsonl")
    assert frame.row_json == (tmp_path / "lights.jsonl").read_bytes().strip()
    assert frame.sequence == 7
    row = msgspec.json.format(lights_json(lights_row(some_lights(3, False), 1, 0.04, "sphere")))
    (tmp_path / "one.json").write_bytes(row)
    assert [one.sequence for one in lights_frames(tmp_path / "one.json")] == [1]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "holds no frame"),
        (b"\n\n", "holds no frame"),
        (GOOD % LIGHT + b"nonsense\n", "line 2: is not a frame of lights in JSON"),
        (GOOD % LIGHT + GOOD % LIGHT, "line 2: time_s 0 is not after 0 of the frame before"),
        ((GOOD % LIGHT).replace(b"lights/1", b"lights/3"), "line 1: schema vemlight.lights/3 is not vemlight.lights/1 or /2"),
        (b'{"lights": []}\n', r"line 1: schema \(none\) is not"),
        ((GOOD % LIGHT).replace(b"sphere", b"cube"), "line 1: is not a frame of lights"),
        ((GOOD % LIGHT).replace(b'"id":3', b'"idd":3'), "line 1: is not a frame of lights"),
        ((GOOD % LIGHT).replace(b"0,0,1", b"0,0,2"), "line 1: light 3 has a direction that is no unit vector"),
        ((GOOD % LIGHT).replace(b"1,2,3", b"1,-2,3"), "line 1: light 3 has negative irradiance"),
        ((GOOD % LIGHT).replace(b"1,2,3", b"1,2,1e39"), "line 1: a direction or irradiance is too large"),
        ((GOOD % LIGHT).replace(b'"id":3', b'"id":-3'), "line 1: an id is below 0"),
        ((GOOD % LIGHT).replace(b'"id":3', b'"id":9223372036854775808'), "line 1: an id is below 0 or above"),
        (GOOD % (LIGHT + b"," + LIGHT), "line 1: an id stands there twice"),
        ((GOOD % LIGHT).replace(b"[1,2,3]", b'[1,2,3],"covariance":[-1,0,0,0,0,0]'), "line 1: a covariance is one that no directions have"),
        ((GOOD % LIGHT).replace(b"[1,2,3]", b'[1,2,3],"covariance":[1e99,0,0,0,0,0]'), "line 1: a covariance is one that no"),
        ((GOOD % LIGHT).replace(b'"time_s":0.0', b'"time_s":-1.0'), "line 1: sequence 0 or time_s -1 is below 0"),
        ((GOOD % LIGHT).replace(b'"time_s":0.0', b'"time_s":NaN'), "line 1: is not a frame of lights in JSON"),
        (with_points(b"").replace(b"lights/2", b"lights/1"), "line 1: has points, which are of schema vemlight.lights/2"),
        (with_points(b"").replace(b',"at":[0,0,1]', b""), "line 1: has one of the keys at and points"),
        (with_points(b"").replace(b'"at":[0,0,1]', b'"at":[0,0,1e7]'), "line 1: .* at is beyond 1e[+]06 m"),
        (with_points(POINT).replace(b'"id":1', b'"id":-1'), "line 1: a near light's id is below 0"),
        (with_points(POINT + b"," + POINT), "line 1: near lights have an id twice"),
        (with_points(POINT).replace(b'"radius":0', b'"radius":-1'), "line 1: near lights have a negative intensity, radius or sigma"),
        (with_points(POINT).replace(b"[5,5,5]", b"[5,5,1e39]"), "line 1: near lights have a number that is not finite"),
        (with_points(POINT).replace(b'"sigma"', b'"sigmas"'), "line 1: is not a frame of lights"),
        (with_points(b",".join(257 * [POINT])), "line 1: has 257 near lights, at most 256"),
        (b"[" * 100_000 + b"\n", "line 1: is not a frame of lights in JSON"),
    ],
)
def test_what_is_no_frame_is_refused_by_its_line(tmp_path, content, words):
    path = tmp_path / "bad.jsonl"
    path.write_bytes(content)
    with pytest.raises(UserError, match=f"bad.jsonl: .*{words}"):
        list(lights_frames(path))


def test_files_are_known_by_their_suffix():
    assert is_lights_file("a.jsonl")
    assert is_lights_file("A.JSON")
    assert not is_lights_file("sky.hdr")
    assert not is_lights_file("rtsp://camera/live")
