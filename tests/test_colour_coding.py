"""From tags and settings to a coding of colours: who overrules whom, what is said in a line, and what is refused."""

import itertools

import numpy as np
import pytest

from vemlight.capture.colour_coding import ENTRIES, HIGHEST, LOWEST, STILL, VIDEO, colour_coding, signal_from_codes
from vemlight.capture.response import Srgb
from vemlight.errors import UserError
from vemlight.light.colour_tags import ColourTags, tags_from_numbers
from vemlight.light.primaries import PRIMARIES, rec709_from_primaries
from vemlight.light.transfers import TRANSFERS
from vemlight.settings import Capture

PQ = ColourTags("pq", "bt2020", "bt2020", "limited")
_names = map("film {}".format, itertools.count())  # a notice is printed once


def coding_of(tags, unsaid=VIDEO, response=None, **settings):
    return colour_coding(Capture(**settings), next(_names), tags, unsaid, response)


def light_of(coding, signal):
    return np.interp(signal, np.linspace(LOWEST, HIGHEST, ENTRIES), coding.table)


def test_numbers_of_a_film_become_names():
    assert tags_from_numbers(16, 9, 9, 1) == PQ
    assert tags_from_numbers(13, 1, 0, 2) == ColourTags("srgb", "bt709", "rgb", "full")
    assert tags_from_numbers(2, 2, 2, 0) == ColourTags()
    assert tags_from_numbers(0, 3, 3, 0) == ColourTags()  # reserved


def test_tags_are_obeyed_without_a_word(capsys):
    coding = coding_of(PQ)
    assert (coding.range, coding.matrix, coding.luminance_scale) == ("limited", "bt2020", 1.0)
    np.testing.assert_array_equal(coding.rec709_from_light, rec709_from_primaries(PRIMARIES["bt2020"]))
    assert light_of(coding, 0.751827) == pytest.approx(1000, rel=2e-3)
    assert not capsys.readouterr().err


def test_settings_overrule_tags(capsys):
    coding = coding_of(PQ, transfer="srgb", primaries="p3d65", matrix="bt709", range="full")
    assert (coding.range, coding.matrix, coding.luminance_scale) == ("full", "bt709", None)
    np.testing.assert_array_equal(coding.rec709_from_light, rec709_from_primaries(PRIMARIES["p3d65"]))
    assert light_of(coding, 0.5) == pytest.approx(0.21404, rel=1e-3)
    assert not capsys.readouterr().err


@pytest.mark.parametrize(("unsaid", "words"), [
    (VIDEO, "transfer (taken as bt709), primaries (taken as bt709), matrix (taken as bt709) and range (taken as limited)"),
    (STILL, "matrix (taken as bt601) and range (taken as full)"),
])  # fmt: skip
def test_what_nobody_says_is_one_line(unsaid, words, capsys):
    assert coding_of(ColourTags(), unsaid).range == unsaid.range
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert all(option in line for option in ("--transfer", "--primaries", "--matrix", "--range"))


def test_one_unsaid_thing_is_named_alone(capsys):
    coding_of(PQ._replace(range=None))
    assert "does not say its range (taken as limited); say it by" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "primaries"), [("logc3", "awg3"), ("logc4", "awg4"), ("slog3", "sgamut3"), ("vlog", "vgamut"), ("acescct", "ap1")]
)
def test_logs_imply_their_gamut_and_settings_overrule_it(name, primaries):
    np.testing.assert_array_equal(coding_of(PQ, transfer=name).rec709_from_light, rec709_from_primaries(PRIMARIES[primaries]))
    np.testing.assert_array_equal(
        coding_of(PQ, transfer=name, primaries="sgamut3cine").rec709_from_light, rec709_from_primaries(PRIMARIES["sgamut3cine"])
    )


@pytest.mark.parametrize(("name", "said"), [("slog3", True), ("vlog", True), ("logc4", False)])
def test_which_codes_a_log_counts_is_said(name, said, capsys):
    coding_of(PQ, transfer=name)
    assert ("--range full" in capsys.readouterr().err) is said
    coding_of(PQ, transfer=name, range="full")
    assert not capsys.readouterr().err


def test_light_of_scene_and_of_display():
    hlg = PQ._replace(transfer="hlg")
    assert coding_of(hlg).display_gain == 0
    assert coding_of(hlg).luminance_scale is None
    shown = coding_of(hlg, light="display")
    assert (shown.display_gain, shown.display_exponent, shown.luminance_scale) == (1000.0, pytest.approx(0.2), 1.0)
    assert coding_of(hlg, light="display", peak=2000.0).display_exponent == pytest.approx(0.326, abs=1e-3)
    assert light_of(coding_of(VIDEO, light="display"), 0.5) == pytest.approx(0.5**2.4, rel=1e-3)
    assert light_of(coding_of(VIDEO), 0.5) == pytest.approx(TRANSFERS["bt709"].light_from_signal(np.array(0.5)), rel=1e-3)


@pytest.mark.parametrize(("tags", "settings", "words"), [
    (PQ._replace(transfer="tag 4 (gamma 2.2)"), {}, ["transfer is tag 4 (gamma 2.2)", "--transfer"]),
    (PQ._replace(matrix="tag 14 (ICtCp)"), {}, ["matrix", "ICtCp", "--matrix"]),
    (PQ, {"transfer": "sRGB2"}, ["sRGB2", "srgb", "ocio:NAME"]),
    (PQ, {"light": "display"}, ["--light", "hlg and bt709"]),
    (PQ, {"peak": 1000.0}, ["--peak", "HLG"]),
    (PQ._replace(transfer="hlg"), {"peak": 600.0}, ["--peak", "--light display"]),
    (PQ, {"transfer": "ocio:ARRI LogC4", "primaries": "ap1"}, ["--primaries", "leave primaries out"]),
])  # fmt: skip
def test_what_is_refused(tags, settings, words):
    with pytest.raises(UserError) as error:
        coding_of(tags, **settings)
    assert all(word in str(error.value) for word in words)


def test_a_tag_that_is_not_read_may_be_overruled():
    assert coding_of(PQ._replace(transfer="tag 4 (gamma 2.2)"), transfer="srgb").luminance_scale is None


def test_a_response_replaces_the_curve():
    coding = coding_of(VIDEO, response=Srgb(bits=8, luminance_scale=3.0))
    assert light_of(coding, 0.5) == pytest.approx(0.21404, rel=1e-3)
    assert coding.luminance_scale == 3.0
    with pytest.raises(UserError, match="transfer and response"):
        coding_of(VIDEO, response=Srgb(bits=8), transfer="srgb")


@pytest.mark.parametrize("bits", [8, 10, 16])
@pytest.mark.parametrize(("range_", "black", "white", "chroma"), [("limited", 16, 235, 224), ("full", 0, None, None)])
def test_black_white_and_pure_colours(bits, range_, black, white, chroma):
    """ITU-R BT.709-6: codes of black, white and of the most blue and red of each matrix."""
    unit, top = 2 ** (bits - 8), 2**bits - 1
    black, white, chroma = black * unit, white * unit if white else top, chroma * unit if chroma else top
    middle = 2 ** (bits - 1)
    for matrix, (kr, kb) in {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)}.items():
        signals = signal_from_codes(coding_of(PQ, range=range_, matrix=matrix), bits, is_rgb=False)
        for luma, blue, red, wanted in [
            (0, 0, 0, (0, 0, 0)), (1, 0, 0, (1, 1, 1)), (kr, -kr / (2 - 2 * kb), 0.5, (1, 0, 0)), (kb, 0.5, -kb / (2 - 2 * kr), (0, 0, 1)),
        ]:  # fmt: skip
            codes = [black + luma * (white - black), middle + blue * chroma, middle + red * chroma, 1]
            np.testing.assert_allclose(signals @ codes, wanted, atol=1e-9)
    rgb = signal_from_codes(coding_of(PQ, range=range_), bits, is_rgb=True)
    np.testing.assert_allclose(rgb @ [white, black, black, 1], (1, 0, 0), atol=1e-9)
    gbr = signal_from_codes(coding_of(PQ, range=range_, matrix="rgb"), bits, is_rgb=False)
    np.testing.assert_allclose(gbr @ [white, black, black, 1], (0, 1, 0), atol=1e-9)


@pytest.mark.parametrize("name", sorted(TRANSFERS))
def test_the_table_is_as_good_as_the_curve(name):
    """At most a quarter of a 10-bit step from the curve, and 0.1 % where it is bright enough to matter."""
    signals = np.linspace(0, 1, 40_001)
    exact = TRANSFERS[name].light_from_signal(signals)
    error = np.abs(light_of(coding_of(PQ, transfer=name), signals) - exact)
    assert np.all(error < 1e-3 * np.abs(exact) + 1e-6 * exact[-1])


def test_ocio_curves_are_the_makers():
    pytest.importorskip("PyOpenColorIO", reason="OpenColorIO is not installed: pip install 'vemlight[ocio]'")
    for space, name in {"S-Log3 S-Gamut3": "slog3", "ARRI LogC3 (EI800)": "logc3", "V-Log V-Gamut": "vlog", "ACEScct": "acescct"}.items():
        ours, theirs = coding_of(PQ, transfer=name), coding_of(PQ, transfer=f"ocio:{space}")
        signals = np.linspace(0.1, 0.99, 50)
        np.testing.assert_allclose(light_of(theirs, signals), light_of(ours, signals), rtol=2e-3, atol=1e-4)
        np.testing.assert_allclose(theirs.rec709_from_light, ours.rec709_from_light, atol=0.01)  # they adapt by CAT02
    for space, words in {
        "ARRI LogC9": "did you mean",
        "Raw": "holds data",
        "Rec.2100-HLG - Display": "more than a curve and a matrix",
    }.items():
        with pytest.raises(UserError, match=words):
            coding_of(PQ, transfer=f"ocio:{space}")


def test_without_opencolorio_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "PyOpenColorIO", None)
    with pytest.raises(UserError, match=r"pip install 'vemlight\[ocio\]'"):
        coding_of(PQ, transfer="ocio:ACEScct")
