import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="charts need the bench extra")

from matplotlib import pyplot as plt

from bench.accuracy.drawing import COMMAND, SHADES, few_shades, save

XLINK = "{http://www.w3.org/1999/xlink}href"


def test_a_chart_has_its_numbers_its_caption_and_each_picture_once(tmp_path):
    picture = few_shades(np.random.default_rng(0).random((30, 40, 3)), 40)
    figure, axes = plt.subplots(1, 3)
    for axis in axes:
        axis.imshow(picture, interpolation="none")
        axis.plot([0.123456, 20.7654321], [1, 2])
    save(figure, [{"method": "one", "error": 1 / 3}], tmp_path, "still_ms", "What it shows.")
    assert {path.name for path in tmp_path.iterdir()} == {f"accuracy_still_ms{suffix}" for suffix in (".png", ".svg", ".csv")}
    assert (tmp_path / "accuracy_still_ms.csv").read_text().split() == ["method,error", "one,0.33333"]
    svg = (tmp_path / "accuracy_still_ms.svg").read_text()
    assert f"What it shows.   {COMMAND} still" in svg
    assert svg.count("data:image") == 1
    assert not re.search(r"\d\.\d{3}", re.sub(r"data:[^\"]*", "", svg.split("<defs>", 1)[1]))
    root = ElementTree.fromstring(svg)
    names = {element.get("id") for element in root.iter()}
    uses = [element for element in root.iter() if element.tag.endswith("use")]
    assert all(element.get(XLINK, "")[1:] in names for element in uses)
    assert sum(element.get(XLINK, "").startswith("#picture") for element in uses) == 3


def test_pictures_get_few_colours_and_the_width_asked_for():
    picture = few_shades(np.random.default_rng(1).random((60, 80, 3)), 40)
    assert picture.shape == (30, 40, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) <= SHADES
    small = few_shades(np.full((6, 8, 3), 0.5), 40)
    assert small.shape == (6, 8, 3)
