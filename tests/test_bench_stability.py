"""The benchmark of stability: what it measures of lights whose faults are known, and that its frames are the same everywhere."""

import csv

import numpy as np
import pytest

from bench.evaluation import points_of
from bench.sequences import world_from_latlong
from bench.stability.__main__ import NAMES, SHOWN, caption, complete, table, with_earlier
from bench.stability.measures import COMPACT, measured, truth_of
from bench.stability.moving import MOVING, STOPS
from bench.stability.progress import PAGE, Unfinished
from bench.stability.recipes import HEIGHT, RECIPES
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet


@pytest.fixture(scope="module")
def seam():
    """Frames of a sun over a clear sky, their truths, and one light for the sun and one for the rest of each."""
    frames = [*MOVING["seam"](world_from_latlong(RECIPES["overcast"]()))][:6]
    truths = [truth_of(points_of(frame.source)) for frame in frames]
    lights = []
    for frame in frames:
        (place, sun), whole = frame.added[0], points_of(frame.source).irradiance.sum(axis=0)
        strength = sun.irradiance.sum(axis=0)
        lights.append(LightSet.of(np.arange(2), np.array([place, [0.0, 0.0, 1.0]]), np.array([strength, whole - strength])))
    return frames, truths, lights


@pytest.mark.parametrize("name", RECIPES)
def test_maps_are_made_alike_each_time_and_are_dark_below(name):
    first, second = RECIPES[name](), RECIPES[name]()
    np.testing.assert_array_equal(first, second)
    assert np.isfinite(first).all()
    assert first.min() > 0
    assert first[HEIGHT // 2 :].max() < first[: HEIGHT // 2].mean()


def test_the_sun_of_a_clear_sky_has_most_of_the_light():
    world = world_from_latlong(RECIPES["clear sky"]())
    above = world.brightest.directions[:, 2] > 0
    fraction = luminance_from_rgb(world.brightest.irradiance[above].sum(axis=0)) / luminance_from_rgb(world.power)
    assert 0.6 < fraction < 0.9


def test_lights_that_keep_their_ids_score_so(seam):
    found = measured(*seam, settling=0)
    assert found["born"] == found["torn"] == found["id_changes"] == 0
    assert found["carried"] == pytest.approx(1, abs=1e-5)
    assert found["wobble"] < 1e-5
    assert found["place_wobble"] < 1e-4
    assert found["lights"] == 2


def test_another_id_in_each_frame_is_newborn_and_a_change(seam):
    frames, truths, lights = seam
    renamed = [light._replace(ids=light.ids + 2 * k) for k, light in enumerate(lights)]
    found = measured(frames, truths, renamed, settling=0)
    assert found["born"] == found["torn"] == pytest.approx(1)
    assert found["id_changes"] == pytest.approx(100 * 5 / 6)
    assert found["error"] == pytest.approx(measured(*seam, settling=0)["error"])


def test_an_old_id_given_to_other_light_is_torn_and_not_born(seam):
    frames, truths, lights = seam
    swapped = [light if k % 2 else light._replace(ids=light.ids[::-1].copy()) for k, light in enumerate(lights)]
    found = measured(frames, truths, swapped, settling=0)
    assert found["born"] == 0
    assert found["torn"] == pytest.approx(1)


def test_a_source_that_is_cut_carries_less_and_wobbles(seam):
    frames, truths, lights = seam
    cut = []
    for k, light in enumerate(lights):
        part = np.array([0.5, 1.0])[k % 2]
        directions = np.concatenate([light.directions[:1], light.directions])
        irradiance = np.concatenate([(1 - part) * light.irradiance[:1], part * light.irradiance[:1], light.irradiance[1:]])
        cut.append(LightSet.of(np.array([7, 0, 1]), directions, irradiance))
    found = measured(frames, truths, cut, settling=0)
    assert found["carried"] == pytest.approx(0.75, abs=1e-3)
    assert found["wobble"] == pytest.approx(0.5, abs=1e-3)


def test_a_source_below_the_least_fraction_is_not_followed(seam):
    frames, truths, lights = seam
    weaker = lambda sun: sun._replace(irradiance=COMPACT / 2 * sun.irradiance)  # noqa: E731
    weak = [frame._replace(added=tuple((place, weaker(sun)) for place, sun in frame.added)) for frame in frames]
    assert np.isnan(measured(weak, truths, lights, settling=0)["carried"])


def test_an_exposure_is_all_light_times_a_constant():
    frames = [*MOVING["exposure"](world_from_latlong(RECIPES["room"]()))]
    ratios = [float(frame.seen.sum() / frames[0].seen.sum()) for frame in frames[::12]]
    np.testing.assert_allclose(ratios, 2.0 ** np.array(STOPS), rtol=1e-4)


def test_rows_of_a_part_replace_their_own_and_keep_the_others(tmp_path):
    rows: list[dict[str, object]] = [{"method": NAMES[k], "map": "room", "sequence": "seam", "error": 0.1 * k} for k in (1, 2)]
    path = tmp_path / "stability.csv"
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    merged = with_earlier([rows[0] | {"error": 5.0}], path)
    assert [float(str(row["error"])) for row in merged] == [5.0, pytest.approx(0.2)]
    assert [row["method"] for row in merged] == [NAMES[1], NAMES[2]]


def test_the_table_has_a_line_for_each_method():
    measures = dict.fromkeys(SHOWN, 0.25)
    rows: list[dict[str, object]] = [
        {"method": name, "map": "room", "sequence": sequence, **measures} for name in NAMES[:2] for sequence in ("seam", "strobe")
    ]
    lines = table(rows).splitlines()
    assert len(lines) == 4
    assert lines[2].count("0.25") == 12


def test_a_run_that_was_cut_off_goes_on_and_another_begins_anew(tmp_path):
    parts, path = [("night", "lamp"), ("night", "day"), ("room", "day")], tmp_path / "unfinished.json"
    first = Unfinished(path, [64, ["tracked"], parts])
    assert first.left(parts) == parts
    first.add(parts[1])
    assert Unfinished(path, [64, ["tracked"], parts]).left(parts) == [parts[0], parts[2]]
    assert Unfinished(path, [32, ["tracked"], parts]).left(parts) == parts
    first.finish()
    assert Unfinished(path, [64, ["tracked"], parts]).left(parts) == parts


def test_the_page_has_a_place_for_both_tables_and_says_what_was_measured():
    assert PAGE.read_text().count("<!-- stability -->") == PAGE.read_text().count("<!-- pictures -->") == 1
    pairs = [{"map": "night", "sequence": "lamp"}, {"map": "room", "sequence": "strobe"}]
    rows: list[dict[str, object]] = [{"method": name, **pair} for name in ("a", "b") for pair in pairs]
    assert caption(rows).startswith("Maps: night, room. Means over 1 sequences without faults, and over 1 with")
    assert complete(rows) == rows
    assert complete(rows[:3]) == rows[:2]  # a mean over other maps cannot be compared
    assert caption(rows[:3]).endswith("left out: b:")
