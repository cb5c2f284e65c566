"""Headers of EXR files, written and read."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vemlight.capture.exr_header import bright_cells_from_attributes, bright_cells_text, count_from_attributes, scale_from_attributes
from vemlight.errors import UserError
from vemlight.light.bright_cells import BrightCells


@given(st.integers(0, 2**32), st.integers(0, 40))
def test_bright_cells_survive_to_the_bit(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    towards = rng.normal(size=(count, 3))
    centres = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
    cells, weights = np.sort(rng.integers(0, 32400, count)), (1 - rng.random(count) ** 9).astype(np.float32)
    bright = BrightCells(cells, centres, weights)
    again = bright_cells_from_attributes("f", {"vemlight:bright_cells": bright_cells_text(bright)}, 32400)
    for a, b in zip(bright, again, strict=True):
        assert (a.shape, a.dtype, a.tobytes()) == (b.shape, b.dtype, b.tobytes())


def test_a_header_without_bright_cells_has_none() -> None:
    assert not len(bright_cells_from_attributes("f", {}, 100).cells)


GOOD = [[3, 0.0, 0.0, 1.0, 0.5], [3, 1.0, 0.0, 0.0, 0.5]]


@pytest.mark.parametrize(
    "text",
    [
        "", "[", "null", 7, b"\xff", json.dumps([GOOD[0][:4]]), json.dumps([[100, 0.0, 0.0, 1.0, 1.0]]),
        json.dumps([[-1, 0.0, 0.0, 1.0, 1.0]]), json.dumps([[3, 0.0, 0.0, 2.0, 1.0]]), json.dumps([[3, 0.0, 0.0, 1.0, 0.0]]),
        json.dumps([[3, 0.0, 0.0, 1.0, 1.5]]), json.dumps([[3, 1e300, 1e300, 0.0, 1.0]]), '[[3, NaN, 0.0, 1.0, 1.0]]',
        json.dumps([[5, 0.0, 0.0, 1.0, 1.0], [3, 0.0, 0.0, 1.0, 1.0]]), json.dumps(GOOD * 3000), json.dumps([[2**70, 0.0, 0.0, 1.0, 1.0]]),
    ],
)  # fmt: skip
def test_hostile_bright_cells_are_one_line(text: object) -> None:
    with pytest.raises(UserError, match=r"^f: vemlight:bright_cells.*record again$"):
        bright_cells_from_attributes("f", {"vemlight:bright_cells": text}, 100)


@pytest.mark.parametrize(("attributes", "count"), [({}, 0), ({"n": 5}, 5), ({"n": -1}, 0), ({"n": "5"}, 0), ({"n": 2.5}, 0)])
def test_counts(attributes: dict, count: int) -> None:
    assert count_from_attributes(attributes, "n") == count


@pytest.mark.parametrize(
    ("attributes", "scale"),
    [
        ({}, None),
        ({"whiteLuminance": 179.0}, 179.0),
        ({"whiteLuminance": 179.0, "vemlight:luminance_scale": "179.123"}, 179.123),
        ({"whiteLuminance": 179.0, "vemlight:luminance_scale": "many"}, 179.0),
        ({"whiteLuminance": -1.0}, None),
        ({"whiteLuminance": 1e31}, None),
        ({"whiteLuminance": 1e29}, 1e29),
        ({"whiteLuminance": "nan"}, None),
        ({"whiteLuminance": (1.0, 2.0)}, None),
    ],
)
def test_scale(attributes: dict, scale: float | None) -> None:
    assert scale_from_attributes(attributes) == scale


def test_as_many_samples_as_a_message_takes() -> None:
    text = json.dumps(GOOD * 2048)
    assert len(bright_cells_from_attributes("f", {"vemlight:bright_cells": text}, 100).cells) == 4096
    with pytest.raises(UserError, match="4096"):
        bright_cells_from_attributes("f", {"vemlight:bright_cells": json.dumps(GOOD * 2048 + GOOD[:1])}, 100)


def test_recordings_of_version_1_keep_their_samples() -> None:
    cells, directions, weights = bright_cells_from_attributes("f", {"vemlight:strong": json.dumps(GOOD)}, 100)
    assert (cells.tolist(), directions.tolist(), weights.tolist()) == ([3, 3], [[0, 0, 1], [1, 0, 0]], [0.5, 0.5])
