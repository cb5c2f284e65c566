"""`vemlight locate`: recordings of a rig become a file of near lights and directional ones, which have all the light; or one true line."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.analytic_rooms import TRIANGLE, rig_of
from tests.support.lamp_maps import Bulb, far, lamp_map, lamp_maps
from tests.support.rig_recordings import write_rig
from vemlight.commands.cli import main
from vemlight.light.lights_reader import lights_frames
from vemlight.light.sphere import map_irradiance

RIG = rig_of(TRIANGLE)
BULBS = (Bulb((1.6, 1.2, 2.3), (1.0, 0.8, 0.6)), Bulb((-1.9, 0.7, 1.9), (0.6, 0.7, 0.9), 0.08))
SKY = (*BULBS, far((0.3, -0.5, 0.8), 0.4))


def located(path: Path, name: str = "lights.jsonl", *options: str):
    return CliRunner().invoke(main, ["locate", str(path), "--out", str(path.with_name(name)), *options], prog_name="vemlight")


def rows_of(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.fixture(scope="module")
def moments() -> list:
    maps = lamp_maps(SKY, RIG, np.random.default_rng(1))
    return [maps, maps, maps]


@pytest.fixture
def recorded(tmp_path: Path, moments: list) -> Path:
    return write_rig(tmp_path / "rig", RIG, moments)


def test_a_recording_has_its_lamps_at_their_places_and_all_its_light(recorded):
    done = located(recorded)
    assert done.exit_code == 0, done.output
    assert "2 near lights in 3 frames of 3 cameras" in done.stdout
    assert "fit no place" not in done.stdout
    assert "no near light is published" not in done.stdout
    rows = rows_of(recorded.with_name("lights.jsonl"))
    assert [row["sequence"] for row in rows] == [0, 1, 2]
    assert [row["time_s"] for row in rows] == pytest.approx([0.0, 0.04, 0.08])
    assert [len(row["points"]) for row in rows] == [0, 2, 2]  # seen twice
    truth = lamp_map(SKY, RIG.centre, np.eye(3))
    for frame in lights_frames(recorded.with_name("lights.jsonl")):
        assert frame.near is not None
        np.testing.assert_allclose(frame.near.at, RIG.centre)
        total = frame.lights.irradiance.sum(axis=0) + frame.near.points.irradiance_at(frame.near.at).sum(axis=0)
        np.testing.assert_allclose(total, map_irradiance(truth.radiance, truth.coverage), rtol=0.02)
    for bulb in BULBS:
        at = min((point["at"] for point in rows[2]["points"]), key=lambda place: np.linalg.norm(np.subtract(place, bulb.at)))
        assert np.linalg.norm(np.subtract(at, bulb.at)) < 0.05


def test_frames_whose_lamps_fit_no_place_publish_none_and_a_line_says_why(tmp_path):
    """Three lamps, since two fit some place by chance more often."""
    rng = np.random.default_rng(0)
    maps = lamp_maps((*SKY, Bulb((0.7, -1.5, 2.1), (0.8, 0.8, 0.8))), RIG, rng)
    wrong = rng.normal(0, 0.03, (3, 3))  # m, where the file says 2 mm
    moved = [msgspec.structs.replace(c, at=tuple(np.add(c.at, by).tolist())) for c, by in zip(RIG.camera, wrong, strict=True)]
    recorded = write_rig(tmp_path / "rig", msgspec.structs.replace(RIG, camera=tuple(moved)), [maps] * 3)
    done = located(recorded)
    assert done.exit_code == 0, done.output
    assert "in 3 frames no near light is published: lamps do not fit one place each" in done.stdout
    assert not any(row["points"] for row in rows_of(recorded.with_name("lights.jsonl")))


def test_a_still_has_its_near_lights_though_they_are_seen_once(tmp_path, moments):
    path = write_rig(tmp_path / "rig", RIG, moments[:1])
    assert located(path, "lights.json").exit_code == 0
    (row,) = rows_of(path.with_name("lights.json"))
    assert len(row["points"]) == 2


def test_the_first_frames_of_all_are_used_and_a_line_says_so(recorded):
    (recorded.parent / "b" / "map_0002.exr").unlink()
    done = located(recorded)
    assert "camera a: has 3 frames and another 2; the first 2 are used" in done.stderr
    assert len(rows_of(recorded.with_name("lights.jsonl"))) == 2
    done = located(recorded, "one.json", "--frames", "1")
    assert done.exit_code == 0, done.output
    assert len(rows_of(recorded.with_name("one.json"))) == 1


def test_cameras_count_more_near_the_subject(recorded):
    """The rest of a lamp that camera a alone sees is a third of its light, and nearly all of it beside that camera."""
    seen_by_a = lamp_maps((*SKY, Bulb((0.0, 2.5, 1.5))), RIG, np.random.default_rng(1))
    without = lamp_maps(SKY, RIG, np.random.default_rng(1))
    path = write_rig(recorded.parent / "other", RIG, [[seen_by_a[0], *without[1:]]] * 2)
    plain = located(path)
    assert "up to 1 compact sources a frame fit no place: hidden from other cameras, or a pose is wrong" in plain.stdout
    at = ",".join(f"{x:g}" for x in TRIANGLE[0])
    assert located(path, "subject.jsonl", "--subject", at).exit_code == 0
    rows = [rows_of(path.with_name(name))[1] for name in ("lights.jsonl", "subject.jsonl")]
    light = [sum(light["irradiance"][1] for light in row["lights"]) for row in rows]
    assert light[1] > 1.1 * light[0]


def test_frames_of_two_moments_are_refused_and_nothing_is_written(tmp_path, moments):
    """Camera b lost its second frame: its third is beside the others' second."""
    recorded = write_rig(tmp_path / "rig", RIG, [*moments, moments[0]])
    (recorded.parent / "b" / "map_0001.exr").unlink()
    done = located(recorded)
    assert done.exit_code == 2
    assert "camera b: its frame 1 is of 0.08 s and that of a of 0.04 s; record all cameras together" in done.stderr
    assert not recorded.with_name("lights.jsonl").exists()
