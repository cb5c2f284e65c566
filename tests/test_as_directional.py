"""Near lights where only directional ones are known: true at one place, in energy, direction and extent."""

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.lights_files import write_lights
from vemlight.commands.cli import main
from vemlight.exchange.gltf_lights import LM_PER_W, gltf_from_lights
from vemlight.exchange.stream import json_line
from vemlight.light.as_directional import NEAR_IDS, as_directional
from vemlight.light.light_set import LightSet, NearLights, are_covariances, lights_row
from vemlight.light.near_lights import NearLightSet
from vemlight.runtime import stamps, wire
from vemlight.runtime.near_frames import LAST_FRAMES, NearFrames

LAMPS = NearLightSet.of(
    np.array([0, 3]), np.array([[0, 0, 3], [2, 1, 1]]), np.array([[8, 4, 2], [1, 1, 1]]), np.array([0.25, 0]), np.array([0.01, 0.02])
)
NEAR = NearLights(LAMPS, (0.0, 0.0, 1.0))
FAR = LightSet.of(np.array([0, 1]), np.array([[0, 0, 1], [1, 0, 0]]), np.ones((2, 3)), np.zeros((2, 6)))


@pytest.mark.parametrize("place", [None, (0.0, 0.0, 1.0), (1.0, 1.0, 0.5)])
def test_each_channel_s_irradiance_and_each_direction_are_those_at_the_place(place):
    seen_from = np.array(NEAR.at if place is None else place)
    lights = as_directional(FAR, NEAR, place)
    np.testing.assert_array_equal(lights.irradiance[:2], FAR.irradiance)
    np.testing.assert_allclose(lights.irradiance[2:], LAMPS.irradiance_at(seen_from), rtol=1e-6)
    towards = LAMPS.at - seen_from
    np.testing.assert_allclose(lights.directions[2:], towards / np.linalg.norm(towards, axis=1, keepdims=True), atol=1e-6)
    assert lights.covariances is not None
    assert are_covariances(lights.covariances)
    assert len(set(lights.ids.tolist())) == 4, "a near light's id is not that of another"


def test_a_light_s_extent_is_that_of_its_disc_and_points_stay_points():
    lights = as_directional(FAR, NEAR)
    angular_radius = 0.25 / 2
    assert lights.covariances is not None
    np.testing.assert_allclose(lights.covariances[2], [angular_radius**2 / 4, 0, 0, angular_radius**2 / 4, 0, 0], atol=1e-9)
    assert as_directional(FAR._replace(covariances=None), NEAR).covariances is None


@pytest.mark.parametrize("near", [None, NearLights(NearLightSet.empty(), (0.0, 0.0, 0.0))])
def test_without_near_lights_nothing_changes(near):
    assert as_directional(FAR, near) is FAR


def test_a_light_at_the_place_itself_is_finite():
    lights = as_directional(FAR, NEAR, (0.0, 0.0, 3.0))
    assert lights.covariances is not None
    assert all(np.isfinite(array).all() for array in lights if array is not None)
    assert are_covariances(lights.covariances)


def points_message(sequence: int) -> tuple[wire.PointsMessage, tuple[np.ndarray, ...]]:
    return wire.PointsMessage(stamp=stamps.stamp(sequence, 0.0), count=2, at=NEAR.at), LAMPS.arrays()


def test_near_lights_are_those_of_the_frame_or_the_newest():
    frames = NearFrames()
    assert frames.of(stamps.stamp(0, 0.0)) is None
    for sequence in range(LAST_FRAMES + 5):
        header, arrays = points_message(sequence)
        frames.take(header, (np.array([sequence, 10**6]), *arrays[1:]))
    its, newest = frames.of(stamps.stamp(9, 0.0)), frames.of(stamps.stamp(1, 0.0))
    assert its
    assert its.points.ids[0] == 9
    assert newest
    assert newest.points.ids[0] == LAST_FRAMES + 4, "long gone"


def test_near_lights_of_before_a_restart_are_none_of_a_frame_behind_it():
    """A fuse that is restarted counts from 0 again."""
    frames = NearFrames()
    for sequence, id_ in ((0, 1), (1, 1), (2, 1), (0, 7)):
        header, arrays = points_message(sequence)
        frames.take(header, (np.array([id_, 10**6]), *arrays[1:]))
    near = frames.of(stamps.stamp(2, 0.0))
    assert near
    assert near.points.ids[0] == 7


def test_streams_of_json_have_them_as_files_have():
    lights = wire.LightsMessage(stamp=stamps.stamp(4, 0.1), count=1, coverage="hemisphere")
    arrays = np.zeros(1, np.int64), np.array([[0, 0, 1]], np.float32), np.ones((1, 3), np.float32)
    none = np.zeros((0, 3), np.float32)
    row = msgspec.json.decode(json_line((lights, (*arrays, none, none)), NEAR))
    assert (row["schema"], row["at"], [point["id"] for point in row["points"]]) == ("vemlight.lights/2", [0.0, 0.0, 1.0], [0, 3])


def test_gltf_has_them_as_points_at_their_places_in_candela():
    document = gltf_from_lights(FAR, 0, 0.0, None, NEAR)
    lights = document["extensions"]["KHR_lights_punctual"]["lights"]
    assert [light["type"] for light in lights] == ["directional", "directional", "point", "point"]
    assert lights[2]["intensity"] == pytest.approx(8 * LM_PER_W)
    assert lights[2]["color"] == [1, 0.5, 0.25]
    assert document["nodes"][3]["translation"] == [2, 1, -1], "y up"
    assert [node["extensions"]["KHR_lights_punctual"]["light"] for node in document["nodes"]] == [0, 1, 2, 3]
    assert document["nodes"][2]["extras"]["vemlight"]["radius"] == 0.25


def test_a_file_with_near_lights_is_exported_and_usd_says_how(tmp_path):
    write_lights(tmp_path / "l.jsonl", [lights_row(FAR, k, k / 25, "hemisphere", near=NEAR) for k in range(2)])
    command = ["export", str(tmp_path / "l.jsonl"), "--usd", str(tmp_path / "l.usda"), "--gltf", str(tmp_path / "l.gltf")]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    assert "2 lights and 2 near lights of frame 0" in done.output
    assert "near lights are directional there, as they are seen from 0, 0, 1 m; --gltf has them as points" in done.stderr
    assert f'DistantLight "light_{NEAR_IDS}"' in (tmp_path / "l.usda").read_text()
