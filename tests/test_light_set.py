"""LightSet as files: what is written comes back, what is not lights is named."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tests.support.lights_files import light_set_from_row, read_lights, write_lights
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet, LightsFile, are_covariances, check_lights_path, lights_row

FLOATS = arrays.arrays(np.float32, (3, 3), elements=st.floats(allow_nan=False, allow_infinity=False, width=32))


def lights(count: int = 3) -> LightSet:
    generator = np.random.default_rng(count)
    return LightSet.of(np.arange(count) + 2**40, generator.standard_normal((count, 3)), generator.random((count, 3)))


@given(FLOATS, FLOATS)
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_number_comes_back_as_it_was(tmp_path, directions, irradiance):
    given_lights = LightSet.of(np.array([0, 7, 2**53]), directions, irradiance)
    write_lights(tmp_path / "l.json", [lights_row(given_lights, 5, 0.2, "sphere")])
    (row,) = read_lights(tmp_path / "l.json")
    assert (row.sequence, row.time_s, row.coverage) == (5, 0.2, "sphere")
    for one, other in zip(light_set_from_row(row)[:3], given_lights[:3], strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_extents_come_back_and_make_version_two_of_the_file(tmp_path):
    covariances = np.array([[0.1, 0.01, 0, 0.2, 0, 1e-9], [0] * 6], np.float32)
    soft = LightSet.of(np.arange(2), np.array([[0, 0, 1], [1, 0, 0]]), np.ones((2, 3)), covariances)
    write_lights(tmp_path / "l.json", [lights_row(soft, 0, 0.0, "hemisphere")])
    (row,) = read_lights(tmp_path / "l.json")
    assert row.schema == "vemlight.lights/2"
    np.testing.assert_array_equal(light_set_from_row(row).covariances, covariances)


@pytest.mark.parametrize(
    ("covariance", "can_be"),
    [
        ([0] * 6, True), ([0.4, 0, 0, 0.3, 0, 0.3], True), ([-5e-7, 0, 0, 0, 0, 0], True), ([-2e-6, 0, 0, 0, 0, 0], False),
        ([0.5, 0, 0, 0.5, 0, 1e-5], False), ([0.1, 0.2, 0, 0.1, 0, 0], False), ([np.nan, 0, 0, 0, 0, 0], False),
    ],
)  # fmt: skip
def test_a_covariance_of_directions_has_no_negative_eigenvalue_and_a_trace_up_to_one(covariance, can_be):
    assert are_covariances(np.array([covariance], np.float32)) == can_be


def test_the_file_is_the_json_that_the_documents_describe(tmp_path):
    one = LightSet.of(np.zeros(1), np.array([[0, 0, 1]]), np.ones((1, 3)))
    write_lights(tmp_path / "l.json", [lights_row(one, 0, 0.0, "hemisphere")])
    assert json.loads((tmp_path / "l.json").read_text()) == {
        "schema": "vemlight.lights/1", "sequence": 0, "time_s": 0.0, "coverage": "hemisphere",
        "lights": [{"id": 0, "direction": [0.0, 0.0, 1.0], "irradiance": [1.0, 1.0, 1.0]}],
    }  # fmt: skip


def test_several_frames_are_lines_and_no_lights_are_a_frame_too(tmp_path):
    rows = [lights_row(lights(count), count, count / 25, "hemisphere") for count in (3, 0, 1)]
    write_lights(tmp_path / "l.jsonl", rows)
    assert read_lights(tmp_path / "l.jsonl") == rows
    assert light_set_from_row(rows[1]).directions.shape == (0, 3)


@pytest.mark.parametrize(
    ("name", "frames", "words"),
    [("l.txt", 1, ".jsonl"), ("l.json", 2, ".jsonl"), ("l.json", 0, "one frame"), ("no/l.json", 1, "no such folder")],
)
def test_a_path_where_lights_cannot_be_written_is_one_line(tmp_path, name, frames, words):
    with pytest.raises(UserError, match=words):
        check_lights_path(tmp_path / name, frames)


def test_appending_removes_a_line_that_a_killed_writer_left_half_written(tmp_path):
    path = tmp_path / "new" / "l.jsonl"
    first = LightsFile(path, can_be_made_again=False)
    first.append(lights(), 0, 0.0, "hemisphere")
    first.close()
    with open(path, "ab") as file:
        file.write(b'{"schema": "vemlight')
    again = LightsFile(path, can_be_made_again=False)
    assert again.count == 1
    again.append(lights(2), 1, 0.04, "hemisphere")
    assert [len(row.lights) for row in read_lights(path)] == [3, 2]
