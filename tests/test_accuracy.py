import csv

import numpy as np
import pytest

from services.files import BadInput
from services.images import write_exr

pytest.importorskip("matplotlib", reason="charts need the bench extra")

from services.accuracy import METHODS, chart


def test_a_map_of_ones_own_is_charted(tmp_path, monkeypatch):
    monkeypatch.setattr("services.accuracy.COUNTS", (4, 32))
    monkeypatch.setattr("services.accuracy.FRAMES", 4)
    image = np.random.default_rng(0).lognormal(0, 1, (16, 32, 3)).astype(np.float32)
    image[5, 20] = 500
    write_exr(tmp_path / "sky.exr", image)
    chart([tmp_path / "sky.exr"], tmp_path / "charts")
    assert {p.name for p in (tmp_path / "charts").iterdir()} == {f"{n}{s}" for n in ("error", "flicker") for s in (".png", ".svg", ".csv")}
    rows = list(csv.DictReader((tmp_path / "charts" / "error.csv").open()))
    assert len(rows) == 2 * len(METHODS)
    by = {(row["method"], row["lights"]): float(row["error"]) for row in rows}
    assert by["tracked", "32"] < by["tracked", "4"]
    assert by["tracked", "32"] < by["havran-azimuth", "32"]


def test_what_is_no_map_is_named(tmp_path):
    (tmp_path / "sky.exr").write_bytes(b"no image")
    with pytest.raises(BadInput, match=r"sky\.exr"):
        chart([tmp_path / "sky.exr"], tmp_path / "charts")
