import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from vemlight.commands.cli import main
from vemlight.errors import UserError
from vemlight.light.images import write_exr

pytest.importorskip("matplotlib", reason="charts need the bench extra")

from vemlight.capture.source import open_source
from vemlight.commands.chart import EVENT_FRAMES, FPS, METHODS, _moment, _turning, chart, machine, measured
from vemlight.light.sphere import cell_from_direction
from vemlight.settings import Capture

NAMES = ("error", "flicker", "motion", "events", "required_lights")


@pytest.fixture(autouse=True)
def small_measurements(monkeypatch):
    """Maps of 30 x 120 cells and fewer numbers; a test sets those that it is about."""
    for name, value in {"ROWS": 30, "COLS": 120, "COUNTS": (8,), "ERROR_LIMITS": (8.0,), "FRAMES": 2, "MOVING_COUNT": 16}.items():
        monkeypatch.setattr(f"vemlight.commands.chart.{name}", value)


def test_the_charts_of_a_map_distinguish_the_methods(tmp_path, monkeypatch):
    for name, value in {"COUNTS": (4, 32), "FRAMES": 18, "ERROR_LIMITS": (40.0, 20.0, 10.0)}.items():
        monkeypatch.setattr(f"vemlight.commands.chart.{name}", value)
    image = np.random.default_rng(0).lognormal(0, 1, (16, 32, 3)).astype(np.float32)
    image[5, 20] = 500
    write_exr(tmp_path / "sky.exr", image)
    tables = measured([tmp_path / "sky.exr"])
    assert len(tables["error"]) == 2 * len(METHODS)
    errors = {(row["method"], row["lights"]): row["error"] for row in tables["error"]}
    assert errors["tracked", 32] < errors["tracked", 4]
    assert errors["tracked", 32] < errors["havran-azimuth", 32]
    required = {(row["method"], row["limit"]): row["lights"] for row in tables["required_lights"]}
    assert all(required[method, 0.4] <= required[method, 0.2] <= required[method, 0.1] for method in METHODS)
    assert all(row["measured"] < 1.3 * row["limit"] for row in tables["required_lights"] if row["method"] == "tracked")
    assert len(tables["events"]) == 18 * len(EVENT_FRAMES) * (len(METHODS) + 1)
    for event in EVENT_FRAMES:
        worst = {
            method: max(row["error"] for row in tables["events"] if (row["event"], row["method"]) == (event, method))
            for method in ("tracked", "havran-azimuth")
        }
        assert worst["tracked"] < worst["havran-azimuth"]


@pytest.mark.filterwarnings("error::UserWarning")
def test_charts_are_written_as_pictures_and_tables_even_of_a_black_map(tmp_path):
    write_exr(tmp_path / "night.exr", np.zeros((16, 32, 3), np.float32))
    done = CliRunner().invoke(main, ["chart", str(tmp_path / "night.exr"), "--out", str(tmp_path / "charts"), "--json"])
    assert done.exit_code == 0, done.output
    assert set(json.loads(done.stdout)["files"]) == {path.name for path in (tmp_path / "charts").iterdir()}
    assert {path.name for path in (tmp_path / "charts").iterdir()} == {f"{n}{s}" for n in NAMES for s in (".png", ".svg", ".csv")}
    rows = list(csv.DictReader((tmp_path / "charts" / "error.csv").open()))
    assert [row["method"] for row in rows] == list(METHODS)
    assert {row["error"] for row in rows} == {"0"}
    caption = (tmp_path / "charts" / "required_lights.svg").read_text()
    assert "vemlight chart night.exr" in caption
    assert machine() in caption


def test_maps_of_the_same_name_get_names_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr("vemlight.commands.chart.EVENT_FRAMES", {})
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        write_exr(tmp_path / folder / "sky.exr", np.ones((16, 32, 3), np.float32))
    tables = measured([tmp_path / folder / "sky.exr" for folder in ("one", "other")])
    assert len({row["map"] for row in tables["error"]}) == 2


def test_a_turned_map_takes_its_bright_cells_along(tmp_path, monkeypatch):
    monkeypatch.setattr("vemlight.commands.chart.FRAMES", 24)
    image = np.ones((64, 128, 3), np.float32)
    image[20, 60], image[11, 3] = 4000, 900
    write_exr(tmp_path / "sky.exr", image)
    first, *_, last = _turning(_moment(open_source(Capture(source=str(tmp_path / "sky.exr"))).frame(0)))
    rows, cols, _ = first.truth.shape
    for moment in (first, last):
        cells = moment.bright_cells.cells
        row, col = cell_from_direction(moment.bright_cells.directions, rows, cols, "hemisphere")
        assert (row.astype(int) * cols + col.astype(int) == cells).all()
        assert (np.diff(cells) >= 0).all()
        assert moment.truth.reshape(-1, 3)[cells].min() > 100
    assert last.time_s == pytest.approx(23 / FPS)


def test_a_sequence_is_judged_by_its_own_frames(tmp_path, monkeypatch):
    monkeypatch.setattr("vemlight.commands.chart.EVENT_FRAMES", {})
    monkeypatch.setattr("vemlight.commands.chart.FRAMES", 24)
    for k in range(3):
        write_exr(tmp_path / f"f{k}.exr", np.full((16, 32, 3), 1 + k, np.float32))
    rows = {row["method"]: row for row in measured([tmp_path])["moving"]}
    assert rows["standard"]["power_error"] > 0.1  # the filter's delay: a map that only turned would have none


def test_what_is_no_map_is_named(tmp_path):
    (tmp_path / "sky.exr").write_bytes(b"no image")
    with pytest.raises(UserError, match=r"sky\.exr"):
        chart([tmp_path / "sky.exr"], tmp_path / "charts")
    assert not (tmp_path / "charts").exists()
