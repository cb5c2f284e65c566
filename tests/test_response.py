"""Radiance to code values and back."""

from pathlib import Path

import numpy as np
import pytest

from services.capture.response import (
    Response,
    clipped_counts,
    code_from_radiance,
    radiance_from_code,
    radiance_table,
    read_response,
    write_response,
)
from services.files import BadInput

B = 4095 / np.log(1e8)  # 12 bits over eight decades
LOG = Response(kind="log", bits=12, a=float(-B * np.log(1e-3)), b=float(B), c=1e-3)
LINEAR = Response(kind="linear", bits=12, a=64.0, b=40.0)


def test_log_comes_back_to_half_a_code() -> None:
    radiance = np.logspace(-1, 4.9, 5000)
    back = radiance_from_code(code_from_radiance(radiance, LOG), LOG)
    # half a code is a factor exp(0.5 / b); c = 1e-3 adds a hundredth of that at 0.1
    assert np.abs(back / radiance - 1).max() < (np.exp(0.5 / LOG.b) - 1) * 1.02


def test_linear_comes_back_to_half_a_code() -> None:
    radiance = np.linspace(0, 100, 999)
    back = radiance_from_code(code_from_radiance(radiance, LINEAR), LINEAR)
    assert np.abs(back - radiance).max() <= 0.5 / LINEAR.b * (1 + 1e-6)


@pytest.mark.parametrize("response", [LOG, LINEAR])
def test_codes_come_back_exactly(response: Response) -> None:
    table = radiance_table(response)
    assert np.all(np.diff(table) >= 0)
    seen = np.flatnonzero(table > 0)
    assert np.array_equal(code_from_radiance(table[seen], response), seen)


@pytest.mark.parametrize("response", [LOG, LINEAR])
def test_clipping_is_counted(response: Response) -> None:
    code = code_from_radiance(np.array([[0.0, 1e9, 1.0], [1e12, 2.0, 3.0]]), response)
    black, saturated = clipped_counts(code, response)
    assert (black, saturated) == (int(np.count_nonzero(code == 0)), 2)


def test_dark_is_no_negative_radiance() -> None:
    assert radiance_from_code(np.array([0, 10, 63, 64]), LINEAR).tolist() == [0, 0, 0, 0]


def test_steep_log_table_stays_finite() -> None:
    assert np.all(np.isfinite(radiance_table(Response(kind="log", bits=16, a=0.0, b=1.0, c=1.0))))


@pytest.mark.parametrize("code", [-1, 4096])
def test_code_beyond_the_sensor_is_refused(code: int) -> None:
    with pytest.raises(BadInput, match="12 bits"):
        radiance_from_code(np.array([code]), LOG)


@pytest.mark.parametrize("response", [LOG, LINEAR, Response(kind="log", bits=8, a=30.0, b=22.0, c=1.5, luminance_scale=179.0)])
def test_response_file_round_trip(tmp_path: Path, response: Response) -> None:
    write_response(tmp_path / "response.toml", response)
    assert read_response(tmp_path / "response.toml") == response


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('kind = "log"\nbits = 12\na = 0.0\nb = 1.0\n', "c = 0"),
        ('kind = "linear"\nbits = 12\na = 0.0\nb = -1.0\n', "b = -1"),
        ('kind = "linear"\nbits = 17\na = 0.0\nb = 1.0\n', "bits"),
        ('kind = "gamma"\nbits = 12\na = 0.0\nb = 1.0\n', "gamma"),
        ('kind = "linear"\nbits = 12\na = nan\nb = 1.0\n', "nan"),
        ('kind = "linear"\nbits = 12\nb = 1.0\n', "`a`"),
        ('kind = "linear"\nbits = 12\na = 0.0\nb = 1.0\nluminance_scale = 0.0\n', "luminance_scale"),
    ],
)
def test_no_response_at_all_is_refused(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "response.toml").write_text(text)
    with pytest.raises(BadInput, match=word):
        read_response(tmp_path / "response.toml")
