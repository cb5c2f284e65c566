"""Radiance to code values and back."""

from pathlib import Path

import numpy as np
import pytest

from vemlight.capture.response import (
    Companding,
    Linear,
    Log,
    Response,
    Srgb,
    code_from_radiance,
    radiance_table,
    read_response,
    write_response,
)
from vemlight.errors import UserError

B = 4095 / np.log(1e8)  # 12 bits over eight decades
LOG = Log(bits=12, a=float(-B * np.log(1e-3)), b=float(B), c=1e-3)
LINEAR = Linear(bits=12, a=64.0, b=40.0)
COMPANDING = Companding(bits=12, knees=((0.0, 64.0), (10.0, 2064.0), (1000.0, 4000.0)))
ALL = [LOG, LINEAR, COMPANDING, Srgb(bits=10)]


def test_log_comes_back_to_half_a_code() -> None:
    radiance = np.logspace(-1, 4.9, 5000)
    back = radiance_table(LOG)[code_from_radiance(radiance, LOG)]
    # half a code is a factor exp(0.5 / b); c = 1e-3 adds a hundredth of that at 0.1
    assert np.abs(back / radiance - 1).max() < (np.exp(0.5 / LOG.b) - 1) * 1.02


def test_linear_comes_back_to_half_a_code() -> None:
    radiance = np.linspace(0, 100, 999)
    back = radiance_table(LINEAR)[code_from_radiance(radiance, LINEAR)]
    assert np.abs(back - radiance).max() <= 0.5 / LINEAR.b * (1 + 1e-6)


@pytest.mark.parametrize("response", ALL)
def test_codes_come_back_exactly(response: Response) -> None:
    table = radiance_table(response)
    assert table.shape == (2**response.bits,)
    assert np.all(np.diff(table) >= 0)
    seen = np.flatnonzero(table > 0)
    assert np.array_equal(code_from_radiance(table[seen], response), seen)


@pytest.mark.parametrize("response", ALL)
def test_what_exceeds_the_codes_is_clipped(response: Response) -> None:
    assert code_from_radiance(np.array([1e12]), response)[0] == response.top


def test_dark_is_no_negative_radiance() -> None:
    assert radiance_table(LINEAR)[[0, 10, 63, 64]].tolist() == [0, 0, 0, 0]


def test_steep_log_table_stays_finite() -> None:
    assert np.all(np.isfinite(radiance_table(Log(bits=16, a=0.0, b=1.0, c=1.0))))


def test_srgb_is_the_standard_curve() -> None:
    # IEC 61966-2-1: code 188 of 8 bits is half of white; its two pieces meet at 0.0031308
    assert code_from_radiance(np.array([0.0, 0.5, 1.0]), Srgb(bits=8)).tolist() == [0, 188, 255]
    below, above = Srgb(bits=8).signal(np.array([0.0031308, 0.0031309]))
    assert above - below == pytest.approx(12.92 * 255e-7, rel=0.05)


def test_companding_bends_at_its_knees() -> None:
    expected = [64, 1064, 2064, 2064 + 495 * 1936 / 990, 4000 + 1000 * 1936 / 990]
    assert COMPANDING.signal(np.array([0.0, 5.0, 10.0, 505.0, 2000.0])) == pytest.approx(expected)


@pytest.mark.parametrize("response", [*ALL, Log(bits=8, a=30.0, b=22.0, c=1.5, luminance_scale=179.0)])
def test_response_file_round_trip(tmp_path: Path, response: Response) -> None:
    write_response(tmp_path / "response.toml", response)
    assert read_response(tmp_path / "response.toml") == response


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('kind = "log"\nbits = 12\na = 0.0\nb = 1.0\nc = 0.0\n', "c = 0"),
        ('kind = "log"\nbits = 12\na = 0.0\nb = 1.0\n', "no c;"),
        ('bits = 12\na = 0.0\nb = 1.0\n', "kind"),
        ('kind = "companding"\nbits = 12\nknees = [[0.0, 0.0], [1.0, 0.0]]\n', "knees"),
        ('kind = "companding"\nbits = 12\nknees = [[0.0, 0.0]]\n', "knees"),
        ('kind = "srgb"\nbits = 8\na = 1.0\n', "a: there is no such key"),
        ('kind = "linear"\nbits = 12\na = 0.0\nb = -1.0\n', "b = -1"),
        ('kind = "linear"\nbits = 17\na = 0.0\nb = 1.0\n', "bits"),
        ('kind = "gamma"\nbits = 12\na = 0.0\nb = 1.0\n', "gamma.: choose from log"),
        ('kind = "linear"\nbits = 12\na = nan\nb = 1.0\n', "nan"),
        ('kind = "linear"\nbits = 12\nb = 1.0\n', "no a;"),
        ('kind = "linear"\nbits = 12\na = 0.0\nb = 1.0\nluminance_scale = 0.0\n', "luminance_scale"),
    ],
)
def test_no_response_at_all_is_refused(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "response.toml").write_text(text)
    with pytest.raises(UserError, match=word):
        read_response(tmp_path / "response.toml")
