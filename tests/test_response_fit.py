"""The sensor's response found from patches."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from vemlight.capture.calibration.colorchecker import chart_from_corners
from vemlight.capture.calibration.patches import Patch, read_patches
from vemlight.capture.calibration.response_fit import Kind, calibrate_response, gray_patches, response_summary
from vemlight.capture.response import Companding, Linear, Log, Response, Srgb, read_response
from vemlight.errors import UserError

LOG = Log(bits=8, a=30.0, b=22.0, c=1.5, luminance_scale=1.0)
FIT, CHECK = [0.5, 4.0, 60.0, 500.0, 5e3, 3e4], [20.0, 2e3]


def patches(response: Response, noise: float = 0.0, seed: int = 0, fit: list[float] = FIT) -> list[Patch]:
    rng = np.random.default_rng(seed)
    scale = response.luminance_scale or 1.0

    def code(level: float) -> float:
        return float(response.signal(np.array(level / scale)) + rng.normal(0, noise))

    return [Patch(code(level), level, False) for level in fit] + [Patch(code(level), level, True) for level in CHECK]


def test_exact_log_patches_give_the_exact_response(tmp_path: Path) -> None:
    report = calibrate_response(patches(LOG), tmp_path / "response.toml", picture=tmp_path / "fit.png")
    assert isinstance(report.response, Log)
    np.testing.assert_allclose([report.response.a, report.response.b, report.response.c], [30, 22, 1.5], rtol=1e-4)
    assert report.worst < 1e-4
    assert "20 cd/m2" in response_summary(report)
    assert read_response(tmp_path / "response.toml") == report.response
    picture = cv2.imread(str(tmp_path / "fit.png"))
    assert picture is not None
    assert picture.shape == (480, 640, 3)


def test_noise_of_half_a_code_stays_within_what_it_must_cost(tmp_path: Path) -> None:
    worst = [calibrate_response(patches(LOG, 0.5, seed), tmp_path / "r.toml", accept=True).worst for seed in range(20)]
    # one code is 4.6 %: half a code at the patch and the fit's own error make 2 to 3 % at one sigma, worse of two
    assert np.median(worst) < 0.045


def test_one_outlier_does_not_bias_the_fit(tmp_path: Path) -> None:
    rows = patches(LOG, fit=[0.5, 2.0, 8.0, 60.0, 200.0, 500.0, 5e3, 3e4])
    rows[3] = rows[3]._replace(code=rows[3].code + 18)
    assert calibrate_response(rows, tmp_path / "r.toml").worst < 0.05


@pytest.mark.parametrize(
    ("kind", "response", "fit"),
    [
        ("linear", Linear(bits=16, a=200.0, b=1.9, luminance_scale=1.0), FIT[1:]),
        ("companding", Companding(bits=12, knees=((0, 10.0), (100.0, 1500.0), (5e4, 4000.0)), luminance_scale=1.0), [1, 100, 3e4]),
        ("srgb", Srgb(bits=12, luminance_scale=4e4), FIT),
    ],
)
def test_other_kinds(tmp_path: Path, kind: Kind, response: Response, fit: list[float]) -> None:
    report = calibrate_response(patches(response, fit=fit), tmp_path / "r.toml", kind=kind, bits=response.bits)
    assert type(report.response) is type(response)
    assert report.worst < 1e-3


def test_wrong_kind_is_refused_unless_accepted(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="check patch of"):
        calibrate_response(patches(LOG), tmp_path / "r.toml", kind="linear")
    assert not (tmp_path / "r.toml").exists()
    assert calibrate_response(patches(LOG), tmp_path / "r.toml", kind="linear", accept=True).worst > 0.05


@pytest.mark.parametrize(("error", "accepted"), [(0.04, True), (-0.04, True), (0.06, False), (-0.06, False)])
def test_check_patches_may_be_five_per_cent_off(tmp_path: Path, error: float, accepted: bool) -> None:
    rows = [row._replace(luminance=row.luminance * (1 + error)) if row.check else row for row in patches(LOG)]
    if accepted:
        assert calibrate_response(rows, tmp_path / "r.toml").worst < 0.05
    else:
        with pytest.raises(UserError, match="beyond 5%"):
            calibrate_response(rows, tmp_path / "r.toml")


@pytest.mark.parametrize(("bits", "code"), [(8, 254.0), (10, 256.0), (12, 1024.0), (14, 4096.0), (16, 16384.0)])
def test_bits_are_the_fewest_that_hold_the_codes(tmp_path: Path, bits: int, code: float) -> None:
    linear = Linear(bits=16, a=0.0, b=code / 3e4, luminance_scale=1.0)
    report = calibrate_response(patches(linear, fit=FIT[1:]), tmp_path / "r.toml", kind="linear", accept=True)
    assert report.response.bits == bits


def test_clipped_patches_are_left_out(tmp_path: Path) -> None:
    rows = [*patches(LOG), Patch(255.0, 1e7, False), Patch(0.0, 1e-9, False)]
    assert calibrate_response(rows, tmp_path / "r.toml", bits=8).worst < 1e-3


def test_patches_must_rise(tmp_path: Path) -> None:
    rows = patches(LOG)
    rows[2], rows[3] = rows[2]._replace(code=rows[3].code), rows[3]._replace(code=rows[2].code)
    with pytest.raises(UserError, match="do not rise with luminance: 500 cd/m2"):
        calibrate_response(rows, tmp_path / "r.toml")


@pytest.mark.parametrize(("rows", "word"), [(patches(LOG)[:6], "none|no patch"), (patches(LOG)[3:], "3 patches to fit"), ([], "0 patches")])
def test_too_few_patches(tmp_path: Path, rows: list[Patch], word: str) -> None:
    with pytest.raises(UserError, match=word):
        calibrate_response(rows, tmp_path / "r.toml")


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("code, luminance, use, weight\n10, 0.5, fit, 2\n20.5, 5, check,\n")
    assert read_patches(path) == [Patch(10.0, 0.5, False, 2.0), Patch(20.5, 5.0, True, 1.0)]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("code,use\n1,fit\n", "no column 'luminance'"),
        ("code,luminance,use\nx,1,fit\n", "line 2: code"),
        ("code,luminance,use\n1,1,fit\n1,1,both\n", "line 3: use = 'both'"),
        ("code,luminance,use\n1,-1,fit\n", "above 0"),
        ("code,luminance,use\n1,nan,fit\n", "above 0"),
        ("code,luminance,use\n1\n", "line 2"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(UserError, match=word):
        read_patches(tmp_path / "p.csv")


PLAIN = "code,luminance,use\n1412.4,0.5,fit\n2141.0,20,check\n"


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + PLAIN.encode(), PLAIN.encode("utf-16"), b"\xfe\xff" + PLAIN.encode("utf-16-be"),
        PLAIN.replace(",", ";").replace(".", ",").encode(), PLAIN.replace(",", "\t").encode(), PLAIN.replace(",", ";").encode(),
        PLAIN.replace(",", "\t").replace(".", ",").encode("utf-16"), PLAIN.upper().encode(), PLAIN.replace("\n", "\r").encode(),
        b"sep=;\r\n" + PLAIN.replace(",", ";").replace("\n", ";;\r\n").encode(), b"\n;;\n" + PLAIN.replace(",", " ; ").encode(),
        b'"Code";"Luminance (cd/m\xb2)";"Use"\n"1412,4";"0,5";"fit"\n"2141,0";"20";"check"\n',
        b'code,luminance,use\n"1412,4","0,5",fit\n"2141,0",20,check\n', b"use,name,luminance,code\nfit,a,0.5,1412.4\n\ncheck,b,20,2141\n",
    ],
)  # fmt: skip
def test_csv_of_any_country(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "p.csv").write_bytes(content)
    assert read_patches(tmp_path / "p.csv") == [Patch(1412.4, 0.5, False), Patch(2141.0, 20.0, True)]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("code,luminance,use\n1412,4,0,5,fit\n", "line 2: has 5 fields and the first line 3; put ; or a tab"),
        ("code;luminance;use\n1.412,4;0,5;fit\n", "same decimal sign"),
        ("code;luminance;use\n1,412,4;0,5;fit\n", "line 2: code, luminance and weight must be numbers"),
        ("code;luminance;use\n1412.5;0,5;fit\n", "same decimal sign"),
        ("code,code,luminance,use\n1,1,1,fit\n", "several columns 'code'"),
        ("code luminance use\n1 1 fit\n", "no column 'code'"),
    ],
)
def test_csv_that_can_be_read_in_two_ways_is_refused(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(UserError, match=word):
        read_patches(tmp_path / "p.csv")


LOG12 = Log(bits=12, a=1549.0, b=197.6, c=0.001, luminance_scale=1.0)
LINEAR12 = Linear(bits=12, a=64.0, b=1.6, luminance_scale=1.0)
SRGB12 = Srgb(bits=12, luminance_scale=3000.0)


@pytest.mark.parametrize(("kind", "response"), [("log", LOG12), ("linear", LINEAR12), ("srgb", SRGB12)])
@pytest.mark.parametrize("off", [300.0, -300.0, 60.0])
def test_one_wrong_patch_is_left_out_with_a_line_or_refused(
    tmp_path: Path, kind: Kind, response: Response, off: float, capsys: pytest.CaptureFixture[str]
) -> None:
    levels = np.linspace(50, 2400, 8) if kind == "linear" else np.geomspace(2, 2400, 8)
    probes = np.linspace(levels[0], levels[-1], 50)
    outcomes = []
    for wrong in range(8):
        codes = response.signal(levels / (response.luminance_scale or 1.0)) + off * (np.arange(8) == wrong)
        rows = [Patch(float(code), float(level), k in (2, 5)) for k, (code, level) in enumerate(zip(codes, levels, strict=True))]
        try:
            found = calibrate_response(rows, tmp_path / "r.toml", kind=kind, bits=12).response
        except UserError:
            outcomes.append("refused")
            continue
        outcomes.append("left out" if f"the patch of {levels[wrong]:g} cd/m2" in capsys.readouterr().err else "harmless")
        read = found.radiance(response.signal(probes / (response.luminance_scale or 1.0))) * (found.luminance_scale or 1.0)
        np.testing.assert_allclose(read, probes, rtol=0.01)
    assert outcomes.count("left out") >= 4
    assert outcomes.count("harmless") <= 3  # patches at the end of the codes, which are left out anyway, and one that only checks


def test_noise_alone_is_no_outlier(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in range(10):
        calibrate_response(patches(LOG, 0.5, seed), tmp_path / "r.toml", bits=8, accept=True)
    assert capsys.readouterr().err == ""


def test_a_companding_response_that_grows_steeper_is_refused(tmp_path: Path) -> None:
    companding = Companding(bits=12, knees=((0, 64.0), (100.0, 1500.0), (2400.0, 3500.0)), luminance_scale=1.0)
    rows = patches(companding, fit=[1.0, 10.0, 50.0, 100.0, 500.0, 1000.0, 1500.0])
    rows[4] = rows[4]._replace(code=rows[4].code - 200)
    with pytest.raises(UserError, match=r"grows steeper at 500 cd/m2|check patch"):
        calibrate_response(rows, tmp_path / "r.toml", kind="companding", bits=12)


def test_bits_that_nobody_stated_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibrate_response(patches(LOG12), tmp_path / "r.toml", accept=True)
    assert "taken to have 12 bits" in capsys.readouterr().err
    calibrate_response(patches(LOG12), tmp_path / "r.toml", bits=12, accept=True)
    assert "bits" not in capsys.readouterr().err


def test_gray_row_of_a_colorchecker() -> None:
    # a chart 240 x 160 with its corner at (30, 40), squares of 40 with gaps, its gray row below
    codes = np.full((240, 320), 50, np.uint16)
    for n in range(6):
        codes[163:197, 33 + 40 * n : 67 + 40 * n] = 1000 - 100 * n
    found = gray_patches(codes, chart_from_corners([(50, 60), (250, 60), (250, 180), (50, 180)]), white_luminance=900.0)
    assert [p.code for p in found] == [1000, 900, 800, 700, 600, 500]
    assert [p.check for p in found] == [False, True, False, False, True, False]
    # published reflectances of the row: 0.91, 0.59, 0.36, 0.19, 0.09, 0.03
    np.testing.assert_allclose([p.luminance / 900 * 0.913 for p in found], [0.913, 0.589, 0.363, 0.191, 0.088, 0.031], atol=2e-3)
    with pytest.raises(UserError, match="lies outside the frame"):
        gray_patches(codes, chart_from_corners([(50, 60), (350, 60), (350, 180), (50, 180)]), 900.0)
