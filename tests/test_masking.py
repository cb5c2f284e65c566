"""Masks: what they cover, how much light is left, what a fill is made of."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as limits
from hypothesis import strategies as st

from vemlight.capture import masking
from vemlight.capture.frames import Frame
from vemlight.capture.masking import MAX_FILLED_CELLS, MaskedSource, Masking, mask_weights, masked_map
from vemlight.capture.recording_attributes import map_attributes
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.mask import MAX_MASK_POINTS, MAX_POINTS, Mask
from vemlight.light.sphere import SPAN, Coverage, cell_directions, cell_solid_angles, direction_from_angles, map_irradiance
from vemlight.runtime import wire
from vemlight.settings import Capture

ROWS, COLS = 45, 180
AROUND_ZENITH = Mask(points=((0.0, 60.0), (90.0, 60.0), (180.0, 60.0), (270.0, 60.0)))


def a_map(seed: int = 0, coverage: Coverage = "hemisphere") -> np.ndarray:
    directions = cell_directions(ROWS, COLS, coverage)
    smooth = 1.5 + directions @ np.random.default_rng(seed).normal(0, 0.5, (3, 3))
    return np.maximum(smooth, 0.05).astype(np.float32)


def masked(radiance: np.ndarray, *masks: Mask, coverage: Coverage = "hemisphere", bright: BrightCells = NO_BRIGHT_CELLS):
    rows, cols, _ = radiance.shape
    return masked_map(radiance, bright, mask_weights(masks, rows, cols, coverage), coverage)


def cap_of(weights: np.ndarray, coverage: Coverage) -> float:
    """Solid angle of what is covered."""
    rows, cols = weights.shape
    return float((weights * cell_solid_angles(rows, cols, coverage)[:, None]).sum())


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 90.0), (359.0, 40.0), (120.0, 15.0)])
def test_a_stroke_of_one_point_is_a_disc_of_its_width(coverage, azimuth, elevation):
    weights = mask_weights([Mask(points=((azimuth, elevation),), width_deg=20.0, mode="dark")], 90, 360, coverage)
    theta, half = np.radians(90 - elevation), np.radians(10)
    # a disc of radius 10 degrees on the equidistant disc is wider across than along, by theta / sin(theta)
    wanted = np.pi * half**2 * (np.sin(theta) / theta if theta else 1.0)
    assert cap_of(weights.dark, coverage) == pytest.approx(wanted, rel=0.03)
    directions = cell_directions(90, 360, coverage)
    middle = direction_from_angles(theta, np.radians(azimuth))
    assert weights.dark[(directions @ middle) > np.cos(np.radians(5))].min() == 1


def test_a_polygon_covers_what_lies_between_its_points():
    weights = mask_weights([AROUND_ZENITH], 90, 360, "hemisphere")
    elevation, azimuth = (np.arange(90) + 0.5), (np.arange(360) + 0.5)
    # a square whose corners are 30 degrees from the middle: its sides are 30 / sqrt(2) away
    assert weights.filled[elevation < 30 / np.sqrt(2) - 1].min() == 1
    assert weights.filled[elevation > 31].max() == 0
    assert weights.filled[28, np.abs(azimuth - 90).argmin()] == 1
    assert weights.filled[28, np.abs(azimuth - 45).argmin()] == 0


def test_a_polygon_that_lies_over_itself_is_empty_there():
    twice = Mask(points=(*AROUND_ZENITH.points, *AROUND_ZENITH.points))
    assert cap_of(mask_weights([twice], 90, 360, "hemisphere").filled, "hemisphere") < 0.02


@given(st.integers(0, 1000), st.sampled_from(["hemisphere", "sphere"]))
@limits(max_examples=15)
def test_darkness_takes_just_what_it_covers(seed, coverage):
    rng, radiance = np.random.default_rng(seed), a_map(seed, coverage)
    points = tuple((float(a), float(e)) for a, e in zip(rng.uniform(0, 360, 5), rng.uniform(-80, 90, 5), strict=True))
    mask = Mask(points=points, mode="dark", width_deg=float(rng.choice([0.0, 9.0])))
    weights = mask_weights([mask], ROWS, COLS, coverage)
    left, _ = masked_map(radiance, NO_BRIGHT_CELLS, weights, coverage)
    taken = map_irradiance(radiance * weights.dark[..., None], coverage)
    assert np.allclose(map_irradiance(left, coverage) + taken, map_irradiance(radiance, coverage), rtol=1e-5)
    assert (left <= radiance).all()
    again, _ = masked_map(left * (weights.dark[..., None] == 0), NO_BRIGHT_CELLS, weights, coverage)
    assert (again[weights.dark > 0] == 0).all()


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("mask", [
    AROUND_ZENITH, Mask(points=((350.0, 5.0), (20.0, 5.0), (5.0, 60.0))), Mask(points=((10.0, 0.0), (200.0, 0.0)), width_deg=25.0),
])  # fmt: skip
def test_an_even_sky_stays_even(mask, coverage):
    filled, _ = masked(np.full((ROWS, COLS, 3), 0.7, np.float32), mask, coverage=coverage)
    assert np.abs(filled / 0.7 - 1).max() < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_a_fill_lies_within_the_rim_and_is_smooth_there(seed):
    mask = Mask(points=((80.0, 20.0), (160.0, 25.0), (120.0, 70.0)))
    radiance = a_map(seed)
    weights = mask_weights([mask], ROWS, COLS, "hemisphere")
    inside = weights.filled > 0
    spoilt = np.where(inside[..., None], np.float32(1e4), radiance)  # what a fill must not see
    spoilt[weights.filled < 1] = radiance[weights.filled < 1]
    filled, _ = masked_map(spoilt, NO_BRIGHT_CELLS, weights, "hemisphere")
    rim = np.zeros_like(inside)
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        rim |= np.roll(inside, (down, right), axis=(0, 1)) & ~inside
    whole = weights.filled == 1
    for channel in range(3):
        assert filled[..., channel][whole].min() >= radiance[..., channel][rim].min() * (1 - 1e-5)
        assert filled[..., channel][whole].max() <= radiance[..., channel][rim].max() * (1 + 1e-5)
    # a smooth sky is found again to some per cent, and no cell differs from its neighbour by more than the sky and a tenth
    assert np.abs(filled / radiance - 1)[inside].mean() < 0.1
    assert np.abs(np.diff(filled, axis=1)).max() < np.abs(np.diff(radiance, axis=1)).max() + 0.1
    assert np.array_equal(filled[~inside], radiance[~inside])


def test_a_dark_lamp_gives_a_fill_beside_it_no_light():
    lamp = Mask(points=((100.0, 40.0),), width_deg=12.0, mode="dark")
    around = Mask(points=((100.0, 40.0),), width_deg=40.0)
    radiance = np.ones((ROWS, COLS, 3), np.float32)
    weights = mask_weights([lamp, around], ROWS, COLS, "hemisphere")
    radiance[weights.dark > 0] = 1000.0
    made, _ = masked_map(radiance, NO_BRIGHT_CELLS, weights, "hemisphere")
    only = (weights.filled > 0) & (weights.dark == 0)
    assert np.abs(made[only] - 1).max() < 1e-4


@pytest.mark.parametrize("mode", ["fill", "dark"])
def test_no_map_makes_a_number_that_is_none(mode):
    whole = [Mask(points=((22.5 * k, 90.0), (22.5 * k, -90.0)), mode=mode, width_deg=90.0) for k in range(16)]
    radiance = a_map(coverage="sphere")
    radiance[3:20, 10:60] = [np.nan, np.inf, -1.0]
    made, _ = masked(radiance, *whole, coverage="sphere")
    assert (made == 0).all()  # there is no rim to fill from
    part = Mask(points=((20.0, 20.0), (150.0, 20.0), (90.0, 80.0)), mode=mode)
    made, _ = masked(radiance, part, coverage="sphere")
    weights = mask_weights([part], ROWS, COLS, "sphere")
    assert np.isfinite(made[(weights.filled == 1) | (weights.dark == 1)]).all()
    outside = (weights.filled == 0) & (weights.dark == 0)
    assert np.array_equal(made[outside], radiance[outside], equal_nan=True)


def test_a_sun_is_covered_where_it_is_and_not_where_its_cell_is():
    radiance = np.ones((ROWS, COLS, 3), np.float32)
    row, col = 22, 45
    radiance[row, col] = 5000.0
    theta = (row + np.array([0.2, 0.8])) * SPAN["hemisphere"] / ROWS
    samples = direction_from_angles(theta, (col + 0.5) * 2 * np.pi / COLS).astype(np.float32)
    bright = BrightCells(np.full(2, row * COLS + col), samples, np.array([0.25, 0.75], np.float32))
    edge = 90 - np.degrees(theta.mean())
    upper = Mask(points=((86.0, edge), (94.0, edge), (94.0, 85.0), (86.0, 85.0)), mode="dark")
    made, left = masked(radiance, upper, bright=bright)
    assert made[row, col, 0] == pytest.approx(0.75 * 5000)
    assert (left.weights.tolist(), left.cells.tolist()) == ([1.0], [row * COLS + col])
    made, left = masked(radiance, Mask(points=((91.0, 45.0),), width_deg=10.0), bright=bright)
    assert len(left.cells) == 0
    assert made[row, col] == pytest.approx(1.0, rel=1e-3)


def test_a_ground_is_lit_by_what_is_left():
    radiance = np.ones((ROWS, COLS, 3), np.float32)
    lit = np.concatenate([radiance, np.full_like(radiance, 0.3)])
    frame = Frame(lit, "sphere", 0.0, None, 0, 0)
    half = Mask(points=tuple((float(a), 0.0) for a in range(0, 181, 5)), mode="dark")
    made = Masking(Capture(ground=0.3)).masked(frame, (half,))
    assert made.radiance.shape == lit.shape
    assert made.radiance[-1].mean() == pytest.approx(0.15, rel=0.02)


def test_what_is_masked_is_in_the_header_and_in_the_report():
    class Sky:
        fps = 25.0

        def __len__(self) -> int:
            return 1

        def frame(self, k: int) -> Frame:
            return Frame(a_map(), "hemisphere", 0.0, None, 0, 0)

    settings = Capture(masks=(AROUND_ZENITH,), rows=ROWS, cols=COLS)
    frame = MaskedSource(Sky(), settings).frame(0)
    assert frame.masked_cells == np.count_nonzero(mask_weights([AROUND_ZENITH], ROWS, COLS, "hemisphere").filled)
    assert "[[0.0,60.0]" in map_attributes(frame, 25.0)["vemlight:masks"]
    assert "vemlight:masks" not in map_attributes(Sky().frame(0), 25.0)
    assert MaskedSource(Sky(), Capture()).frame(0).masked_cells == 0


def test_a_fill_that_is_too_large_is_dark_and_says_so(monkeypatch, capsys):
    monkeypatch.setattr(masking, "MAX_FILLED_CELLS", 100)
    made, _ = masked(a_map(), AROUND_ZENITH)
    assert made[0].max() == 0
    assert "at most 100 can be; they are dark" in capsys.readouterr().err
    assert 180 * 360 < MAX_FILLED_CELLS <= 200_000  # the sphere at a degree; factors of more take seconds and gigabytes


def test_masks_are_refused_beyond_their_limits():
    with pytest.raises(ValueError, match="3 points or more"):
        Mask(points=((0.0, 0.0), (1.0, 1.0)))
    many = Mask(points=tuple((float(k), 10.0) for k in range(MAX_MASK_POINTS)))
    count = MAX_POINTS // MAX_MASK_POINTS
    assert len(Capture(masks=(many,) * count).masks) == count
    for refused in (Capture, wire.ControlMessage):
        with pytest.raises(ValueError, match="draw them with fewer points"):
            refused(masks=(many,) * (count + 1))


def test_a_sun_beside_a_fill_does_not_shine_into_it():
    mask = Mask(points=((90.0, 30.0), (90.0, 60.0)), width_deg=20.0)
    weights = mask_weights([mask], ROWS, COLS, "hemisphere")
    radiance = np.ones((ROWS, COLS, 3), np.float32)
    row = 22
    beside = np.flatnonzero(weights.filled[row] > 0).min() - 1
    radiance[row, beside] = 50_000.0
    radiance[row - 1 : row + 2, beside - 1] = 10.0  # its aureole
    filled, _ = masked_map(radiance, NO_BRIGHT_CELLS, weights, "hemisphere")
    inside = weights.filled == 1
    assert filled[inside].max() < masking.RIM_PEAK
    assert filled[inside].mean() < 1.2


def test_a_window_behind_a_person_stays_one():
    """Half of the rim is a hundred times as bright as the rest: that is no peak."""
    radiance = np.ones((ROWS, COLS, 3), np.float32)
    radiance[:, 60:] = 100.0
    weights = mask_weights([Mask(points=((120.0, 20.0), (120.0, 60.0)), width_deg=20.0)], ROWS, COLS, "hemisphere")
    filled, _ = masked_map(radiance, NO_BRIGHT_CELLS, weights, "hemisphere")
    assert filled[20, 59 + 4, 0] > 65
    assert filled[20, 59 - 4, 0] < 35
