"""Radiance pictures: every way to code one picture gives that picture, and what the header says of the values is taken out."""

import contextlib

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.light.image_limits import ImageLimits
from vemlight.light.primaries import REC709, rec709_from_xyz, xyz_from_primaries
from vemlight.light.radiance_hdr import MAX_HEADER_BYTES
from vemlight.light.radiance_hdr import read_radiance_hdr as read_with_header

HEIGHT, WIDTH = 6, 16


@pytest.fixture
def rng():
    return np.random.default_rng(1)


@pytest.fixture
def codes(rng):
    """(height, width, 4) uint8: dim and bright pixels of all exponents that occur, runs of equal ones, and black."""
    picture = rng.integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)
    picture[..., 0] |= 128  # normalised, so no pixel looks like a run
    picture[..., 3] = rng.integers(100, 150, (HEIGHT, WIDTH))
    picture[1] = picture[1, :1]
    picture[2, 4:12] = picture[2, 4]
    picture[3, 5] = 0
    return picture


def radiance(codes):
    """Ward's definition, a pixel at a time."""
    out = np.zeros((*codes.shape[:2], 3))
    for y, x in np.ndindex(codes.shape[:2]):
        *mantissas, exponent = codes[y, x].tolist()
        if exponent:
            out[y, x] = [(mantissa + 0.5) * 2.0 ** (exponent - 136) for mantissa in mantissas]
    return out.astype(np.float32)


def read_radiance_hdr(path, *limits):
    return read_with_header(path, *limits)[0]


def flat(row):
    return row.tobytes()


def by_channel(row):
    """The newer codes: each channel of a scanline apart, in runs (128 + n, value) and in stretches (n, values)."""
    out = bytes([2, 2, row.shape[0] >> 8, row.shape[0] & 255])
    for channel in row.T.tolist():
        at = 0
        while at < len(channel):
            run = 1
            while at + run < len(channel) and run < 127 and channel[at + run] == channel[at]:
                run += 1
            out += bytes([128 + run, channel[at]]) if run > 2 else bytes([1, channel[at]])
            at += run if run > 2 else 1
    return out


def by_pixel(row):
    """The older codes: (1, 1, 1, n) repeats the pixel before it n times; a second one counts 256 times as much."""
    out, at = b"", 0
    while at < len(row):
        run = 1
        while at + run < len(row) and (row[at + run] == row[at]).all():
            run += 1
        out += row[at].tobytes() + (bytes([1, 1, 1, run - 1]) if run > 1 else b"")
        at += run
    return out


def write(path, codes, coding=flat, lines=("FORMAT=32-bit_rle_rgbe",), resolution=None, magic=b"#?RADIANCE\n", end=b"\n"):
    resolution = resolution or f"-Y {codes.shape[0]} +X {codes.shape[1]}"
    head = magic + b"".join(line.encode() + end for line in lines) + end + resolution.encode() + end
    path.write_bytes(head + b"".join(coding(row) for row in codes))
    return path


@pytest.mark.parametrize("coding", [flat, by_channel, by_pixel])
def test_each_coding_gives_the_same_picture(tmp_path, codes, coding):
    np.testing.assert_array_equal(read_radiance_hdr(write(tmp_path / "a.hdr", codes, coding)), radiance(codes))


def test_codings_may_change_from_scanline_to_scanline(tmp_path, codes):
    turn = iter([flat, by_channel, by_pixel] * 2)
    path = write(tmp_path / "a.hdr", codes, lambda row: next(turn)(row))
    np.testing.assert_array_equal(read_radiance_hdr(path), radiance(codes))


def test_a_run_of_more_than_255_pixels(tmp_path):
    row = np.tile(np.array([200, 100, 50, 130], np.uint8), (1, 600, 1))
    coded = row[0, 0].tobytes() + bytes([1, 1, 1, 599 & 255]) + bytes([1, 1, 1, 599 >> 8])
    np.testing.assert_array_equal(read_radiance_hdr(write(tmp_path / "a.hdr", row, lambda _: coded)), radiance(row))


@pytest.mark.parametrize("y", "-+")
@pytest.mark.parametrize("x", "+-")
@pytest.mark.parametrize("columns", [False, True])
def test_all_eight_orientations_are_the_same_picture(tmp_path, codes, y, x, columns):
    stored = codes[:: 1 if y == "-" else -1, :: 1 if x == "+" else -1]
    sides = [f"{y}Y {HEIGHT}", f"{x}X {WIDTH}"]
    if columns:
        stored, sides = stored.transpose(1, 0, 2), sides[::-1]
    path = write(tmp_path / "a.hdr", np.ascontiguousarray(stored), resolution=" ".join(sides))
    np.testing.assert_array_equal(read_radiance_hdr(path), radiance(codes))


@pytest.mark.parametrize("lines", [
    ("FORMAT=32-bit_rle_rgbe", "EXPOSURE=4", "EXPOSURE= 0.5"),
    ("EXPOSURE=2.0", "FORMAT=32-bit_rle_rgbe"),
])  # fmt: skip
def test_exposures_multiply_and_are_taken_out(tmp_path, codes, lines):
    np.testing.assert_allclose(read_radiance_hdr(write(tmp_path / "a.hdr", codes, lines=lines)), radiance(codes) / 2, rtol=1e-6)


@pytest.mark.parametrize(("line", "stated"), [
    ("FORMAT=32-bit_rle_rgbe", False), ("FORMAT=32-bit_rle_xyze", True), ("PRIMARIES=0 0 0 0 0 0 0 0", False),
    ("PRIMARIES=0.64 0.33 0.3 0.6 0.15 0.06 0.3127 0.329", True),
])  # fmt: skip
def test_whether_primaries_are_stated_is_handed_on(tmp_path, codes, line, stated):
    assert ("chromaticities" in read_with_header(write(tmp_path / "a.hdr", codes, lines=(line,)))[1]) == stated


def test_a_gamma_that_the_format_does_not_know_is_said(tmp_path, codes, capsys):
    for gamma in ("1", "1.0", "2.2"):
        read_radiance_hdr(write(tmp_path / "a.hdr", codes, lines=("FORMAT=32-bit_rle_rgbe", f"GAMMA={gamma}")))
        assert ("GAMMA=2.2" in capsys.readouterr().err) == (gamma == "2.2")


def test_colour_corrections_are_taken_out(tmp_path, codes):
    path = write(tmp_path / "a.hdr", codes, lines=("FORMAT=32-bit_rle_rgbe", "COLORCORR=1 2 4", "COLORCORR=1 1 0.5"))
    np.testing.assert_allclose(read_radiance_hdr(path), radiance(codes) / [1, 2, 2], rtol=1e-6)


def test_xyz_becomes_rec709(tmp_path, codes):
    path = write(tmp_path / "a.hdr", codes, lines=("FORMAT=32-bit_rle_xyze",))
    np.testing.assert_allclose(read_radiance_hdr(path), radiance(codes) @ rec709_from_xyz().T, rtol=1e-4, atol=1e-7)


def test_stated_primaries_are_honoured_and_zeros_are_none(tmp_path, codes):
    stated = "PRIMARIES=0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.3290"
    matrix = np.linalg.solve(xyz_from_primaries(REC709), xyz_from_primaries([float(word) for word in stated[10:].split()]))
    path = write(tmp_path / "a.hdr", codes, lines=("FORMAT=32-bit_rle_rgbe", stated))
    np.testing.assert_allclose(read_radiance_hdr(path), radiance(codes) @ matrix.T, rtol=1e-4, atol=1e-6)
    path = write(tmp_path / "b.hdr", codes, lines=("FORMAT=32-bit_rle_rgbe", "PRIMARIES=0 0 0 0 0 0 0 0"))
    np.testing.assert_array_equal(read_radiance_hdr(path), radiance(codes))


@pytest.mark.parametrize("options", [
    {"lines": ()},
    {"magic": b""},
    {"magic": b"#?RGBE\n"},
    {"end": b"\r\n"},
    {"lines": ("FORMAT = 32-bit_rle_rgbe",)},
    {"lines": ("x" * 127, "y" * 254, "FORMAT=32-bit_rle_rgbe", "z" * 381)},
    {"lines": ("pfilt -x 64 EXPOSURE of old", "FORMAT=32-bit_rle_rgbe")},
    {"lines": ("FORMAT=32-bit_rle_rgbe", "old.hdr:", "\tpfilt -e 4", "\tEXPOSURE=4", " COLORCORR=1 2 4", "pcomb old.hdr")},
])  # fmt: skip
def test_headers_that_differ_from_the_usual(tmp_path, codes, options):
    np.testing.assert_array_equal(read_radiance_hdr(write(tmp_path / "a.hdr", codes, **options)), radiance(codes))


@pytest.mark.parametrize(("options", "cause"), [
    ({"lines": ("FORMAT=32-bit_rle_luv",)}, "is neither"),
    ({"lines": ("EXPOSURE=0",)}, "EXPOSURE"),
    ({"lines": ("EXPOSURE=-1",)}, "EXPOSURE"),
    ({"lines": ("EXPOSURE=nan",)}, "EXPOSURE"),
    ({"lines": ("EXPOSURE=two",)}, "needs 1 number"),
    ({"lines": ("COLORCORR=1 2",)}, "needs 3 numbers"),
    ({"lines": ("PRIMARIES=1 2 3",)}, "needs 8 numbers"),
    ({"lines": ("PRIMARIES=1 1 1 1 1 1 1 1",)}, "no primaries"),
    ({"resolution": "-Y 6 +Y 16"}, "no resolution"),
    ({"resolution": "6 x 16"}, "no resolution"),
    ({"resolution": "-Y 0 +X 16"}, "16 x 0"),
    ({"resolution": "-Y 32768 +X 32768"}, "scale it down"),
    ({"resolution": "-Y 8192 +X 16384"}, "which no picture has"),
    ({"resolution": "-Y 999999999999 +X 1"}, "scale it down"),
    ({"lines": ("x" * MAX_HEADER_BYTES,)}, "no end to its header"),
])  # fmt: skip
def test_what_cannot_be_read_is_refused_by_its_cause(tmp_path, codes, options, cause):
    path = write(tmp_path / "a.hdr", codes, **options)
    with pytest.raises(UserError, match=cause) as refused:
        read_radiance_hdr(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("coding", [flat, by_channel, by_pixel])
def test_a_picture_cut_anywhere_is_refused(tmp_path, codes, coding):
    whole = write(tmp_path / "a.hdr", codes, coding).read_bytes()
    for length in range(len(whole) - 1, 0, -7):
        (tmp_path / "b.hdr").write_bytes(whole[:length])
        with pytest.raises(UserError):
            read_radiance_hdr(tmp_path / "b.hdr")


def test_other_files_are_refused_as_such(tmp_path):
    png, mesh = b"\x89PNG\r\n\x1a\n" + bytes(100), b"v 1 2 3\n"
    for content, cause in ((b"", "is empty"), (png, "is a PNG picture and is named .hdr"), (mesh, "no Radiance picture")):
        (tmp_path / "a.hdr").write_bytes(content)
        with pytest.raises(UserError, match=cause):
            read_radiance_hdr(tmp_path / "a.hdr")


def test_damage_anywhere_is_a_picture_or_one_refusal(tmp_path, codes, rng):
    whole = np.frombuffer(write(tmp_path / "a.hdr", codes, by_channel).read_bytes(), np.uint8)
    for _ in range(500):
        damaged = whole.copy()
        damaged[rng.integers(0, whole.size, 3)] = rng.integers(0, 256, 3)
        (tmp_path / "b.hdr").write_bytes(damaged.tobytes())
        with contextlib.suppress(UserError):
            assert np.isfinite(read_radiance_hdr(tmp_path / "b.hdr")).all()


def test_the_limit_on_pixels_is_the_callers(tmp_path, codes):
    path = write(tmp_path / "a.hdr", codes)
    assert read_radiance_hdr(path, ImageLimits(pixels=HEIGHT * WIDTH)).shape == (HEIGHT, WIDTH, 3)
    with pytest.raises(UserError, match="scale it down"):
        read_radiance_hdr(path, ImageLimits(pixels=HEIGHT * WIDTH - 1))
