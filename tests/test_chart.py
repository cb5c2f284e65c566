import csv

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.light.images import write_exr

pytest.importorskip("matplotlib", reason="charts need the bench extra")

from vemlight.capture.source import open_source
from vemlight.commands.chart import EVENTS, FPS, METHODS, _moment, _rotating_moments, chart, machine
from vemlight.light.sphere import cell_from_direction
from vemlight.settings import Capture

PAIR = ("tracked", "havran-azimuth")


def test_a_map_of_ones_own_is_charted(tmp_path, monkeypatch):
    monkeypatch.setattr("vemlight.commands.chart.COUNTS", (4, 32))
    monkeypatch.setattr("vemlight.commands.chart.FRAMES", 18)
    monkeypatch.setattr("vemlight.commands.chart.MOVING_COUNT", 16)
    image = np.random.default_rng(0).lognormal(0, 1, (16, 32, 3)).astype(np.float32)
    image[5, 20] = 500
    write_exr(tmp_path / "sky.exr", image)
    chart([tmp_path / "sky.exr"], tmp_path / "charts")
    names = ("error", "flicker", "motion", "events", "required_lights")
    files = {f"{name}{suffix}" for name in names for suffix in (".png", ".svg", ".csv")}
    assert {p.name for p in (tmp_path / "charts").iterdir()} == files
    rows = list(csv.DictReader((tmp_path / "charts" / "error.csv").open()))
    assert len(rows) == 2 * len(METHODS)
    by = {(row["method"], row["lights"]): float(row["error"]) for row in rows}
    assert by["tracked", "32"] < by["tracked", "4"]
    assert by["tracked", "32"] < by["havran-azimuth", "32"]
    required = list(csv.DictReader((tmp_path / "charts" / "required_lights.csv").open()))
    lights = {(row["method"], row["limit"]): int(row["lights"]) for row in required}
    assert all(lights[method, "0.4"] <= lights[method, "0.2"] <= lights[method, "0.1"] for method in METHODS)
    assert all(float(row["measured"]) < 1.3 * float(row["limit"]) for row in required if row["method"] == "tracked")
    events = list(csv.DictReader((tmp_path / "charts" / "events.csv").open()))
    assert len(events) == 18 * len(EVENTS) * (len(METHODS) + 1)
    worst = {(e, m): max(float(row["error"]) for row in events if (row["event"], row["method"]) == (e, m)) for e in EVENTS for m in PAIR}
    assert all(worst[event, "tracked"] < worst[event, "havran-azimuth"] for event in EVENTS)
    caption = (tmp_path / "charts" / "required_lights.svg").read_text()
    assert "vemlight chart sky.exr" in caption
    assert machine() in caption


def test_maps_of_one_name_are_told_apart(tmp_path, monkeypatch):
    for name in ("COUNTS", "ERROR_LIMITS"):
        monkeypatch.setattr(f"vemlight.commands.chart.{name}", (8,))
    monkeypatch.setattr("vemlight.commands.chart.FRAMES", 2)
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        write_exr(tmp_path / folder / "sky.exr", np.ones((16, 32, 3), np.float32))
    chart([tmp_path / folder / "sky.exr" for folder in ("one", "other")], tmp_path / "charts")
    assert len({row["map"] for row in csv.DictReader((tmp_path / "charts" / "error.csv").open())}) == 2


def test_a_turned_map_takes_its_bright_cells_along(tmp_path):
    image = np.ones((64, 128, 3), np.float32)
    image[20, 60], image[11, 3] = 4000, 900
    write_exr(tmp_path / "sky.exr", image)
    first, *_, last = _rotating_moments(_moment(open_source(Capture(source=str(tmp_path / "sky.exr"))).frame(0)))
    rows, cols, _ = first.radiance.shape
    for moment in (first, last):
        cells = moment.bright_cells.cells
        row, col = cell_from_direction(moment.bright_cells.directions, rows, cols, "hemisphere")
        assert (row.astype(int) * cols + col.astype(int) == cells).all()
        assert (np.diff(cells) >= 0).all()
        assert moment.radiance.reshape(-1, 3)[cells].min() > 100
    assert last.time_s == pytest.approx(23 / FPS)


def test_a_sequence_is_judged_by_its_own_frames(tmp_path, monkeypatch):
    for name in ("COUNTS", "ERROR_LIMITS"):
        monkeypatch.setattr(f"vemlight.commands.chart.{name}", (8,))
    monkeypatch.setattr("vemlight.commands.chart.EVENTS", {"lamp off and on": 8})
    folder = tmp_path / "film"
    folder.mkdir()
    for k in range(3):
        write_exr(folder / f"f{k}.exr", np.full((16, 32, 3), 1 + k, np.float32))
    chart([folder], tmp_path / "charts")
    rows = {row["method"]: row for row in csv.DictReader((tmp_path / "charts" / "flicker.csv").open())}
    assert float(rows["standard"]["power_error"]) > 0.1  # the filter's delay: a map that only turned would have none


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_black_map_is_charted_without_a_word(tmp_path, monkeypatch):
    for name in ("COUNTS", "ERROR_LIMITS"):
        monkeypatch.setattr(f"vemlight.commands.chart.{name}", (8,))
    monkeypatch.setattr("vemlight.commands.chart.FRAMES", 2)
    write_exr(tmp_path / "night.exr", np.zeros((16, 32, 3), np.float32))
    chart([tmp_path / "night.exr"], tmp_path / "charts")
    assert {row["error"] for row in csv.DictReader((tmp_path / "charts" / "error.csv").open())} == {"0"}


def test_what_is_no_map_is_named(tmp_path):
    (tmp_path / "sky.exr").write_bytes(b"no image")
    with pytest.raises(UserError, match=r"sky\.exr"):
        chart([tmp_path / "sky.exr"], tmp_path / "charts")
