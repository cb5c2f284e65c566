import csv

import numpy as np
import pytest

from services.files import BadInput
from services.images import write_exr

pytest.importorskip("matplotlib", reason="charts need the bench extra")

from services.accuracy import METHODS, chart, machine


def test_a_map_of_ones_own_is_charted(tmp_path, monkeypatch):
    monkeypatch.setattr("services.accuracy.COUNTS", (4, 32))
    monkeypatch.setattr("services.accuracy.FRAMES", 4)
    image = np.random.default_rng(0).lognormal(0, 1, (16, 32, 3)).astype(np.float32)
    image[5, 20] = 500
    write_exr(tmp_path / "sky.exr", image)
    chart([tmp_path / "sky.exr"], tmp_path / "charts")
    files = {f"{name}{suffix}" for name in ("error", "flicker", "need") for suffix in (".png", ".svg", ".csv")}
    assert {p.name for p in (tmp_path / "charts").iterdir()} == files
    rows = list(csv.DictReader((tmp_path / "charts" / "error.csv").open()))
    assert len(rows) == 2 * len(METHODS)
    by = {(row["method"], row["lights"]): float(row["error"]) for row in rows}
    assert by["tracked", "32"] < by["tracked", "4"]
    assert by["tracked", "32"] < by["havran-azimuth", "32"]
    needs = list(csv.DictReader((tmp_path / "charts" / "need.csv").open()))
    lights = {(row["method"], row["promised"]): int(row["lights"]) for row in needs}
    assert all(lights[method, "0.4"] <= lights[method, "0.2"] <= lights[method, "0.1"] for method in METHODS)
    assert all(float(row["had"]) < 1.3 * float(row["promised"]) for row in needs if row["method"] == "tracked")
    caption = (tmp_path / "charts" / "need.svg").read_text()
    assert "vemlight chart sky.exr" in caption
    assert machine() in caption


def test_maps_of_one_name_are_told_apart(tmp_path, monkeypatch):
    for name in ("COUNTS", "PROMISES"):
        monkeypatch.setattr(f"services.accuracy.{name}", (8,))
    monkeypatch.setattr("services.accuracy.FRAMES", 2)
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        write_exr(tmp_path / folder / "sky.exr", np.ones((16, 32, 3), np.float32))
    chart([tmp_path / folder / "sky.exr" for folder in ("one", "other")], tmp_path / "charts")
    assert len({row["map"] for row in csv.DictReader((tmp_path / "charts" / "error.csv").open())}) == 2


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_black_map_is_charted_without_a_word(tmp_path, monkeypatch):
    for name in ("COUNTS", "PROMISES"):
        monkeypatch.setattr(f"services.accuracy.{name}", (8,))
    monkeypatch.setattr("services.accuracy.FRAMES", 2)
    write_exr(tmp_path / "night.exr", np.zeros((16, 32, 3), np.float32))
    chart([tmp_path / "night.exr"], tmp_path / "charts")
    assert {row["error"] for row in csv.DictReader((tmp_path / "charts" / "error.csv").open())} == {"0"}


def test_what_is_no_map_is_named(tmp_path):
    (tmp_path / "sky.exr").write_bytes(b"no image")
    with pytest.raises(BadInput, match=r"sky\.exr"):
        chart([tmp_path / "sky.exr"], tmp_path / "charts")
