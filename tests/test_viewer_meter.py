"""The viewer's meter: what it answers for maps that are known, once for all pages."""

import msgspec
import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.map_elements import elements_from_map
from vemlight.runtime import stamps, wire
from vemlight.runtime.reports import MapReport
from vemlight.viewer import meter
from vemlight.viewer.meter import BINS_PER_STOP, CELLS_HEAD, HIGHEST_CODE, MAX_STOPS, Look, Meter, clipped_elements, histogram
from vemlight.viewer.web import look_from_query

EYE = Look(90, 0)


def meter_of(radiance: np.ndarray, scale: float | None = None, saturated: int = 0, bright: BrightCells = NO_BRIGHT_CELLS) -> Meter:
    rows, cols, _ = radiance.shape
    report = MapReport(saturated_pixels=saturated)
    header = wire.MapMessage(stamp=stamps.stamp(7, 0.28), rows=rows, cols=cols, coverage="sphere", luminance_scale=scale, report=report)
    made = Meter()
    made.take_map(header, EnvironmentMap(radiance.astype(np.float32), "sphere", bright))
    return made


def read(made: Meter, look: Look = EYE) -> dict:
    content = made.readings(look)
    assert content
    return msgspec.json.decode(content)


def test_nothing_before_a_map():
    assert Meter().readings(EYE) is None
    assert Meter().cells() is None


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [None, 1e-30, 1e30])
@pytest.mark.parametrize("level", [float(np.finfo(np.float32).max), float(np.finfo(np.float32).smallest_subnormal)])
def test_readings_of_whatever_float32_holds_are_numbers(level, scale):
    bright = BrightCells(np.array([0, 0]), np.array([[0, 0, 1], [0.6, 0, 0.8]], np.float32), np.array([0.5, 0.5], np.float32))
    made = meter_of(np.full((6, 12, 3), level), scale, saturated=3, bright=bright)
    for look in (Look(0, 90), Look(90, -90, 1e12)):
        reading = read(made, look)
        assert reading["mean"] is not None
        assert reading["plane"]["illuminance"] is not None  # as JSON has nan and infinity
        assert None not in reading["histogram"]["light"]
    assert made.cells()


def test_a_calibrated_sphere():
    reading = read(meter_of(np.full((60, 120, 3), 2.0), scale=500.0))
    assert reading["plane"]["illuminance"] == pytest.approx(np.pi * 1000, rel=1e-3)
    assert reading["plane"]["temperature_k"] == pytest.approx(6504, rel=0.01)  # the white of Rec. 709
    assert reading["mean"] == pytest.approx(2.0, rel=1e-5)  # in the map's unit: the page has the scale
    assert (reading["scale"], reading["scale_from"], reading["sequence"]) == (500.0, "map", 7)
    assert reading["glare"] == {
        "dgp": pytest.approx(5.87e-5 * np.pi * 1000 + 0.16, rel=1e-3),
        "grade": "imperceptible",
        "sources": 0,
        "valid": True,
    }


def test_a_map_without_scale_is_relative_until_the_page_names_one():
    made = meter_of(np.ones((60, 120, 3)))
    assert (read(made)["scale"], read(made)["glare"]) == (None, None)
    assert read(made)["plane"]["illuminance"] == pytest.approx(np.pi, rel=1e-3)
    reading = read(made, Look(90, 0, 100.0))
    assert (reading["scale_from"], reading["glare"]["valid"]) == ("page", False)  # 314 lx: below the formula's range
    assert reading["plane"]["illuminance"] == pytest.approx(100 * np.pi, rel=1e-3)
    assert read(meter_of(np.ones((60, 120, 3)), scale=3.0), Look(90, 0, 100.0))["scale"] == 3.0  # what the camera knows goes first


def test_planes_see_their_half():
    radiance = np.zeros((60, 120, 3))
    radiance[:30] = 1.0  # the sky alone
    made = meter_of(radiance)
    above, wall, below = (read(made, look)["plane"]["illuminance"] for look in (Look(0, 90), Look(200, 0), Look(0, -90)))
    assert (above, wall) == (pytest.approx(np.pi, rel=1e-3), pytest.approx(np.pi / 2, rel=1e-2))
    assert below == pytest.approx(0, abs=1e-6)
    assert read(made)["black"] == pytest.approx(0.5, rel=1e-5)


def test_look_has_an_upright_head():
    for look in (Look(0, 0), Look(77, 33), Look(10, 90), Look(10, -90)):
        assert look.direction @ look.up == pytest.approx(0, abs=1e-12)
        assert look.up[2] >= -1e-12


def test_darkness():
    made = meter_of(np.zeros((8, 16, 3)), scale=1.0, saturated=4)
    reading = read(made)
    assert (reading["black"], reading["clipped"], reading["whole"]["temperature_k"]) == (1.0, 0.0, None)
    assert reading["histogram"]["area"] == []
    assert reading["glare"]["dgp"] == 0
    cells = made.cells()
    assert cells
    assert set(cells[CELLS_HEAD.size :]) == {0}


def test_the_histogram_sums_to_the_lit_sky_and_all_light():
    luminance, area = np.array([0.0, 1.0, 1.1, 8.0]), np.array([1.0, 1.0, 1.0, 1.0])
    made = histogram(luminance, area)
    assert (made["first"], made["step"], len(made["area"])) == (0.0, 1 / BINS_PER_STOP, 3 * BINS_PER_STOP + 1)
    assert sum(made["area"]) == pytest.approx(0.75)
    assert sum(made["light"]) == pytest.approx(1.0, abs=1e-5)
    assert made["area"][0] == pytest.approx(0.5)
    assert made["light"][-1] == pytest.approx(8 / 10.1, rel=1e-5)
    wide = histogram(np.array([1e-30, 1.0]), np.ones(2))
    assert len(wide["area"]) == MAX_STOPS * BINS_PER_STOP + 1
    assert wide["area"][0] == 0.5


def test_cells_are_codes_of_stops():
    radiance = np.ones((4, 8, 3))
    radiance[0, 0], radiance[1, 1], radiance[3, 3] = 0.0, 1024.0, 2.0
    cells = meter_of(radiance).cells()
    assert cells
    rows, cols, coverage, first, step = CELLS_HEAD.unpack_from(cells)
    codes = np.frombuffer(cells, np.uint8, offset=CELLS_HEAD.size).reshape(rows, cols)
    assert (rows, cols, coverage, first) == (4, 8, 1, 0.0)
    assert (codes[0, 0], codes[1, 1], codes[2, 2]) == (0, HIGHEST_CODE, 1)
    assert first + (int(codes[3, 3]) - 1) * step == pytest.approx(1.0, abs=step)
    assert codes[1, 1] == HIGHEST_CODE
    marked = meter_of(radiance, saturated=1).cells()
    assert marked
    assert marked[CELLS_HEAD.size + 9] == 255  # row 1, column 1


def test_clipped_are_the_highest_and_only_where_the_sensor_clipped():
    radiance = np.full((2, 4, 3), 1.0, np.float32)
    radiance[0, :2] = ((5.0, 0.5, 0.5), (1.0, 1.0, 4.95))
    elements = elements_from_map(EnvironmentMap(radiance, "sphere"))
    assert not clipped_elements(elements, 0).any()
    assert np.flatnonzero(clipped_elements(elements, 10)).tolist() == [0, 1]  # any channel, within two per cent of the highest


def test_lights_are_listed_by_strength():
    made = meter_of(np.ones((4, 8, 3)), scale=10.0)
    made.take_lights(np.array([4, 9, 2]), np.array([[1.0, 1, 1], [4, 4, 4], [0, 0, 0]], np.float32))
    lights = read(made)["lights"]
    assert [light["id"] for light in lights] == [9, 4, 2]
    assert lights[0]["illuminance"] == pytest.approx(40, rel=1e-5)
    assert lights[0]["temperature_k"] == pytest.approx(6504, rel=0.01)
    assert lights[2]["temperature_k"] is None


def test_a_map_is_read_once_for_all_pages(monkeypatch):
    asked = []
    monkeypatch.setattr(meter, "elements_from_map", lambda environment: asked.append(1) or elements_from_map(environment))
    made = meter_of(np.ones((8, 16, 3)))
    assert not asked  # nobody has asked yet
    for azimuth in range(200):  # more than are remembered
        made.readings(Look(azimuth, 0))
    made.cells()
    assert len(asked) == 1


@pytest.mark.parametrize(
    "query",
    ["azimuth north", "azimuth nan", "azimuth inf", "elevation 91", "elevation nan", "scale -1", "scale 1e13", "scale nan"],
)
def test_a_query_is_honoured_or_refused(query):
    with pytest.raises(ValueError, match="azimuth"):
        look_from_query(dict([query.split()]))


def test_queries():
    assert look_from_query({}) == Look(0, 0)
    assert look_from_query({"azimuth": "-90.2", "elevation": "12.6", "scale": "179"}) == Look(270, 13, 179.0)
