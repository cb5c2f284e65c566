import os
from pathlib import Path

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.light.far_field import FarField, intensity, total_flux_lm
from vemlight.light.photometry import read_photometry
from vemlight.light.sphere import direction_from_angles

GAMMA = np.arange(0, 181, 5.0)


def lobe(c_deg, gamma_deg):
    """An intensity with no symmetry."""
    c, g = np.radians(c_deg)[:, None], np.radians(gamma_deg)
    return 100 * (1 + np.cos(g)) * (1.2 + 0.5 * np.sin(g) * np.cos(c - 1) + 0.2 * np.sin(g) * np.cos(2 * c))


def symmetric(symmetry, c_deg):
    """`lobe` made to have an EULUMDAT symmetry."""
    total = [c_deg]
    if symmetry in (2, 4):
        total += [-c for c in total]
    if symmetry in (3, 4):
        total += [180 - c for c in total]
    return np.mean([lobe(c, GAMMA) for c in total], axis=0)


def eulumdat(symmetry, table, planes=24, flux=2000.0):
    lines = ["maker", 2, symmetry, planes, 360 / planes, len(GAMMA), 5, "report", "a lamp", "no", "file", "date", 300, 200, 50, 250, 0]
    lines += [40, 30, 30, 30, 100, 100, 1.0, 0, 1, 1, "LED", flux, 4000, 80, 20, *[0.5] * 10, *np.arange(planes) * 360 / planes, *GAMMA]
    return "\r\n".join(str(value) for value in [*lines, *np.round(table * 1000 / flux, 6).reshape(-1)])


def stored(symmetry, planes=24):
    c = np.arange(planes) * 360 / planes
    from_270_by_0_to_90 = np.roll(c, planes // 4)[: planes // 2 + 1]  # Mc1 = 3 Mc / 4 + 1, Mc2 = Mc1 + Mc / 2
    return {0: c, 1: c[:1], 2: c[: planes // 2 + 1], 3: from_270_by_0_to_90, 4: c[: planes // 4 + 1]}[symmetry]


@pytest.mark.parametrize("symmetry", [0, 2, 3, 4])
def test_eulumdat_symmetries_unfold_to_the_whole_turn(tmp_path, symmetry):
    (tmp_path / "a.ldt").write_text(eulumdat(symmetry, symmetric(symmetry, stored(symmetry))))
    far = read_photometry(tmp_path / "a.ldt")
    assert far.c_deg == pytest.approx(np.arange(25) * 15.0)
    assert far.candela == pytest.approx(symmetric(symmetry, far.c_deg), rel=1e-4)
    assert far.size_m == (0.25, 0.25, 0.04)  # a width of 0: round
    assert far.valid_from_m == 1.25
    assert far.name == "a lamp"


def test_an_asymmetric_eulumdat_lamp_shines_to_the_plane_that_is_stored_last(tmp_path):
    table = np.repeat(np.linspace(10, 90, 13)[:, None], len(GAMMA), axis=1)  # from C270, behind, to C90, in front
    (tmp_path / "a.ldt").write_text(eulumdat(3, table))
    far = read_photometry(tmp_path / "a.ldt")
    towards = np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]]) / np.sqrt(2)  # C90, C270
    assert intensity(far, towards) == pytest.approx([90, 10])


@pytest.mark.parametrize(("symmetry", "planes"), [(2, 5), (3, 6), (4, 6)])
def test_eulumdat_planes_that_leave_out_the_plane_of_symmetry_are_refused(tmp_path, symmetry, planes):
    count = {2: planes // 2 + 1, 3: planes // 2 + 1, 4: planes // 4 + 1}[symmetry]
    (tmp_path / "a.ldt").write_text(eulumdat(symmetry, np.full((count, len(GAMMA)), 100.0), planes))
    with pytest.raises(UserError, match=f"symmetry {symmetry} and are stored from"):
        read_photometry(tmp_path / "a.ldt")


@pytest.mark.parametrize(("last", "count"), [(90, 7), (180, 13), (360, 25), (0, 1)])
def test_lm63_symmetries_unfold_to_the_whole_turn(tmp_path, last, count):
    c = np.linspace(0, last, count)
    symmetry = {90: 4, 180: 2, 360: 0, 0: 4}[last]
    table = symmetric(symmetry, c)
    numbers = [1, 2000, 2.0, len(GAMMA), count, 1, 1, 0.5, 1.0, 0.1, 0.5, 1.0, 20, *GAMMA, *c, *table.reshape(-1)]
    text = "IESNA:LM-63-2002\n[LUMCAT] a lamp\nTILT=NONE\n" + "\n".join(f"{n:.6g}" for n in numbers)
    (tmp_path / "a.ies").write_text(text)
    far = read_photometry(tmp_path / "a.ies")
    assert far.c_deg[[0, -1]].tolist() == [0.0, 360.0]
    assert np.all(np.diff(far.c_deg) == (360 if count == 1 else 15))
    expected = np.repeat(table, 2, axis=0) if count == 1 else symmetric(symmetry, far.c_deg)
    assert far.candela == pytest.approx(expected, rel=1e-4)
    assert far.size_m == pytest.approx((0.3048, 0.1524, 0.03048))
    assert far.lamp_flux_lm == 2000


def test_even_intensity_has_4_pi_times_its_flux():
    far = FarField(np.full((2, 37), 10.0), np.array([0.0, 360.0]), GAMMA, (0.1, 0.1, 0.1), np.nan, "even")
    assert total_flux_lm(far) == pytest.approx(40 * np.pi, rel=1e-12)
    rng = np.random.default_rng(1)
    d = rng.normal(size=(100, 3))
    assert intensity(far, d / np.linalg.norm(d, axis=1, keepdims=True)) == pytest.approx(np.full(100, 10.0))


def test_flux_is_the_mean_intensity_times_4_pi():
    c = np.arange(0, 361, 15.0)
    far = FarField(lobe(c, GAMMA), c, GAMMA, (0.1, 0.1, 0.1), np.nan, "lobe")
    n = 20_000
    z, phi = 1 - 2 * (np.arange(n) + 0.5) / n, np.arange(n) * np.pi * (3 - np.sqrt(5))
    mean = intensity(far, direction_from_angles(np.arccos(z), phi)).mean()
    assert total_flux_lm(far) == pytest.approx(4 * np.pi * mean, rel=1e-3)


def test_intensity_is_the_table_at_its_angles():
    c = np.arange(0, 361, 15.0)
    far = FarField(lobe(c, GAMMA), c, GAMMA, (0.1, 0.1, 0.1), np.nan, "lobe")
    for k, j in [(0, 3), (7, 20), (23, 30)]:
        d = direction_from_angles(np.radians(GAMMA[j]), np.radians(c[k]))
        assert intensity(far, d) == pytest.approx(far.candela[k, j], rel=1e-9)


@pytest.mark.parametrize("text", ["", "TILT=NONE", "TILT=NONE\n1 2 3", "TILT=lamp.tlt\n1", "TILT=NONE\n" + "nan " * 300])
def test_a_broken_lm63_is_refused(tmp_path, text):
    (tmp_path / "bad.ies").write_text(text)
    with pytest.raises(UserError, match=r"bad\.ies") as caught:
        read_photometry(tmp_path / "bad.ies")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda t: t[: len(t) // 2],
        lambda t: t.replace("\r\n24\r\n", "\r\n-4\r\n", 1),
        lambda t: "maker\r\n" * 9,
        lambda t: t.replace("2000.0", "1e400"),
    ],
)
def test_a_broken_eulumdat_is_refused(tmp_path, spoil):
    (tmp_path / "bad.ldt").write_text(spoil(eulumdat(0, symmetric(0, stored(0)))))
    with pytest.raises(UserError, match=r"bad\.ldt"):
        read_photometry(tmp_path / "bad.ldt")


@pytest.mark.skipif("VEMLIGHT_DATA" not in os.environ, reason="VEMLIGHT_DATA names no folder with real data")
def test_real_files_carry_the_flux_they_state():
    folder = Path(os.environ["VEMLIGHT_DATA"]) / "luminaire"
    for path in sorted(folder.glob("*.ldt")):
        far = read_photometry(path)
        assert total_flux_lm(far) == pytest.approx(far.lamp_flux_lm, rel=1e-3), path  # all of these state a light output ratio of 100 %
    far = read_photometry(folder / "examp1.ies")
    assert total_flux_lm(far) / far.lamp_flux_lm == pytest.approx(0.913, abs=1e-3)  # a T8 luminaire of 91 % efficiency


@pytest.mark.parametrize(("planes", "said"), [(2000, "cut off"), (2001, "C planes")])
def test_an_eulumdat_has_up_to_2000_planes(tmp_path, planes, said):
    text = eulumdat(0, symmetric(0, stored(0))).split("\r\n")
    (tmp_path / "bad.ldt").write_text("\r\n".join([*text[:3], str(planes), *text[4:]]))
    with pytest.raises(UserError, match=said):
        read_photometry(tmp_path / "bad.ldt")


@pytest.mark.parametrize(
    ("line", "value", "said"),
    [
        (25, 20, "cut off"),
        (25, 21, "sets of lamps"),
        (28, 0.9e9, ""),
        (28, 1.1e9, "a flux of"),
    ],
)
def test_limits_of_an_eulumdat(tmp_path, line, value, said):
    text = eulumdat(0, symmetric(0, stored(0))).split("\r\n")
    text[line] = str(value)
    (tmp_path / "a.ldt").write_text("\r\n".join(text))
    if said:
        with pytest.raises(UserError, match=said):
            read_photometry(tmp_path / "a.ldt")
    else:
        assert read_photometry(tmp_path / "a.ldt").lamp_flux_lm == value


def test_a_byte_order_mark_is_passed_over(tmp_path):
    text = eulumdat(0, symmetric(0, stored(0))).encode()
    (tmp_path / "plain.ldt").write_bytes(text)
    (tmp_path / "marked.ldt").write_bytes(b"\xef\xbb\xbf" + text)
    plain, marked = (read_photometry(tmp_path / f"{name}.ldt") for name in ("plain", "marked"))
    assert marked.candela.tobytes() == plain.candela.tobytes()


LM63 = "IESNA:LM-63-2002\n[LUMCAT] a\nTILT=NONE\n1 1000 1 7 1 1 2 0 0 0\n1 1 10\n0 15 30 45 60 75 90\n0\n{}\n"
LM63_CANDELA = "1000.5 966.4 866.5 707.6 500.5 259.3 0.5"
LM63 = LM63.format(LM63_CANDELA)


@pytest.mark.parametrize("change", [
    lambda t: t, lambda t: t.replace("[LUMCAT] a", "[LUMINAIRE] with TILT=NONE of course"),
    lambda t: t.replace("TILT=", "  tilt = "),
    lambda t: t.replace("\n", "\r"), lambda t: t.replace("\n", "\r\r\n"), lambda t: t + "\x1a\0\0",
    lambda t: t.replace("=NONE", "=INCLUDE\n1\n2\n0 90\n1 1"),
    lambda t: t.replace(LM63_CANDELA, LM63_CANDELA.replace(".", ",")), lambda t: t.replace(LM63_CANDELA, LM63_CANDELA.replace(" ", ",")),
    lambda t: t.replace(LM63_CANDELA, LM63_CANDELA.replace(" ", ", ")), lambda t: t.replace("IESNA:LM-63-2002\n", ""),
    lambda t: t.replace("IESNA:LM-63-2002", "IES:LM-63-2019").replace("1 1 10\n", "1 1.10000 10\n"),
    lambda t: "\n" + t.replace("1 1 10\n", "1 7 10\n"), lambda t: "  " + t.replace("1 1 10\n", "1 7 10\n"),
    lambda t: t.replace("1 1 10\n", "1 7 10\n"), lambda t: t.replace("IESNA:LM-63-2002", "IESNA91").replace("1 1 10\n", "0.5 2 10\n"),
    lambda t: t.replace("259.3 0.5", "259.3 -0.1"),
])  # fmt: skip
def test_ways_to_write_one_lm63(tmp_path, change):
    (tmp_path / "plain.ies").write_text(LM63)
    (tmp_path / "odd.ies").write_text(change(LM63), newline="")
    plain, odd = (read_photometry(tmp_path / f"{name}.ies") for name in ("plain", "odd"))
    assert odd.candela[:, :-1] == pytest.approx(plain.candela[:, :-1], rel=1e-12)
    assert odd.candela.min() >= 0
    assert total_flux_lm(odd) == pytest.approx(3126.6, rel=1e-3)


@pytest.mark.parametrize(("change", "said"), [
    (lambda t: t + "1 2 3", "31 are there"), (lambda t: t.replace(" 0.5", ""), "27 are there"),
    (lambda t: t.replace("1000.5", "1_000.5"), "no number"),
    (lambda t: t.replace("TILT=NONE", "TILT=lamp.tlt"), "another file"), (lambda t: t.replace("1 1000 1 7", "1 1000 0 7"), "no light"),
    (lambda t: t.replace("\n1 1 10\n", "\n0 1 10\n"), "no light"), (lambda t: t.replace("7 1 1 2", "7 1 2 2"), "type A or B"),
    (lambda t: t.replace("7 1 1 2", "7 1 1 3"), "unit 3"), (lambda t: t.replace("0 15 30", "0 30 15"), "do not rise"),
    (lambda t: t.replace("75 90", "75 190"), "outside 0 to 180"), (lambda t: t.replace("259.3 0.5", "259.3 -20"), "negative"),
    (lambda t: t.replace(LM63_CANDELA, "0 0 0 0 0 0 0"), "above 0 cd"),
    (lambda t: t.replace("7 1 1 2", "7 2 1 2").replace("\n0\n", "\n0 45\n") + LM63_CANDELA, "close no circle"),
])  # fmt: skip
def test_an_lm63_that_contradicts_itself_is_refused(tmp_path, change, said):
    (tmp_path / "bad.ies").write_text(change(LM63))
    with pytest.raises(UserError, match=said):
        read_photometry(tmp_path / "bad.ies")


def test_a_factor_of_1986_multiplies(tmp_path):
    (tmp_path / "old.ies").write_text(LM63.replace("IESNA:LM-63-2002\n", "").replace("\n1 1 10\n", "\n1 0.9 10\n"))
    assert total_flux_lm(read_photometry(tmp_path / "old.ies")) == pytest.approx(0.9 * 3126.6, rel=1e-3)


def test_a_tilt_table_that_is_not_applied_is_said(tmp_path, capsys):
    (tmp_path / "tilted.ies").write_text(LM63.replace("=NONE", "=INCLUDE\n1\n2\n0 90\n1 0.8"))
    read_photometry(tmp_path / "tilted.ies")
    assert "tilt, which is not applied" in capsys.readouterr().err


@pytest.mark.parametrize(("last", "is_said"), [(10.05, False), (11.0, True)])
def test_planes_of_0_and_360_degrees_that_differ_are_said(tmp_path, capsys, last, is_said):
    text = f"IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 2 3 1 2 0 0 0\n1 1 0\n0 90\n0 180 360\n10 10\n10 10\n{last} {last}\n"
    (tmp_path / "lamp.ies").write_text(text)
    assert read_photometry(tmp_path / "lamp.ies").candela[-1].tolist() == [10, 10]
    assert ("at 0 and 360 degrees" in capsys.readouterr().err) == is_said


def changed_line(text, changes):
    lines = text.split("\r\n")
    for number, value in changes.items():
        lines[number - 1] = value
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({24: "0"}, "line 24"),
        ({24: "-1"}, "line 24"),
        ({29: ""}, "line 29"),
        ({30: "4000\n9"}, "follow what its header promises"),
        ({4: "24 "}, ""),
        ({13: "", 14: "", 15: "", 18: "", 24: ""}, ""),
        ({24: "1,0"}, ""),
        ({26: ""}, ""),
    ],
)
def test_blank_and_odd_lines_of_an_eulumdat(tmp_path, changes, said):
    text = eulumdat(1, symmetric(1, stored(1)))
    (tmp_path / "a.ldt").write_text(text)
    (tmp_path / "b.ldt").write_text(changed_line(text, changes))
    if said:
        with pytest.raises(UserError, match=said):
            read_photometry(tmp_path / "b.ldt")
    else:
        assert read_photometry(tmp_path / "b.ldt").candela.tobytes() == read_photometry(tmp_path / "a.ldt").candela.tobytes()


def test_lamp_sets_are_alternatives(tmp_path, capsys):
    first = eulumdat(1, symmetric(1, stored(1)), flux=1000.0)
    two = changed_line(first, {26: "2", 32: "20\n1\nLED\n3000\n4000\n80\n40"})
    (tmp_path / "one.ldt").write_text(first)
    (tmp_path / "two.ldt").write_text(two)
    flux = total_flux_lm(read_photometry(tmp_path / "one.ldt"))
    assert total_flux_lm(read_photometry(tmp_path / "two.ldt")) == pytest.approx(flux)
    assert "2 alternative lamp sets (1000, 3000 lm)" in capsys.readouterr().err
    assert total_flux_lm(read_photometry(tmp_path / "two.ldt", 2)) == pytest.approx(3 * flux)
    assert capsys.readouterr().err == ""
    with pytest.raises(UserError, match="has 2 lamp sets"):
        read_photometry(tmp_path / "two.ldt", 3)


@pytest.mark.parametrize("symmetry", [0, 1, 2, 3, 4])
def test_one_plane_is_symmetric_about_the_axis(tmp_path, symmetry):
    (tmp_path / "a.ldt").write_text(eulumdat(symmetry, lobe(np.zeros(1), GAMMA), planes=1))
    assert read_photometry(tmp_path / "a.ldt").candela == pytest.approx(np.repeat(lobe(np.zeros(1), GAMMA), 2, axis=0), rel=1e-4)


def test_a_flat_area_has_no_height(tmp_path):
    flat = {18: "0", 19: "0", 20: "0", 21: "0"}
    (tmp_path / "a.ldt").write_text(changed_line(eulumdat(1, symmetric(1, stored(1))), flat))
    assert read_photometry(tmp_path / "a.ldt").size_m == (0.25, 0.25, 0.0)
    (tmp_path / "b.ldt").write_text(changed_line(eulumdat(1, symmetric(1, stored(1))), {16: "0", **flat}))
    assert read_photometry(tmp_path / "b.ldt").size_m == (0.3, 0.2, 0.05)  # no area: the housing
