"""Compact sources keep one light and one id: what enters, what stays, what waits, and what is no source."""

import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_directions, cell_solid_angles, direction_from_angles
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.tracking.sources import NO_SOURCES, Sources, narrowed, peaks_of, source_lights, sources_after, steady_extents
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.sampler.tracking.tracked import initial_tracked, tracked_step
from vemlight.settings import Sampler

ROWS, COLS = 90, 360
DIRECTIONS = cell_directions(ROWS, COLS, "hemisphere")
SOLID_ANGLES = cell_solid_angles(ROWS, COLS, "hemisphere")[:, None]
MAX_COUNT = 8


def place(theta, phi):
    return direction_from_angles(np.radians(theta), np.radians(phi))


def lit(*lamps, sky=1.0):
    """A sky of power 2 pi with lamps: (theta, phi, diameter in degrees, fraction of the whole power)."""
    gray, whole = np.full((ROWS, COLS), sky), 2 * np.pi * sky / (1 - sum(lamp[3] for lamp in lamps))
    for theta, phi, diameter, fraction in lamps:
        inside = np.cos(np.radians(diameter / 2)) <= DIRECTIONS @ place(theta, phi)
        gray = gray + inside * fraction * whole / (inside * SOLID_ANGLES).sum()
    return np.repeat(gray[..., None], 3, axis=-1).astype(np.float32)


def peaks(radiance, count=128):
    return peaks_of(tiles_from_map(radiance, "hemisphere", count, NO_BRIGHT_CELLS))


def test_a_lamp_is_found_with_its_place_and_power():
    found = peaks(lit((40, 120, 4, 0.3), (60, 300, 2, 0.1)))
    assert len(found.power) == 2
    order = np.argsort(-found.power)
    np.testing.assert_allclose(found.power[order], [0.3, 0.1], rtol=0.02)
    for direction, at in zip(found.directions[order], (place(40, 120), place(60, 300)), strict=True):
        assert direction @ at > np.cos(np.radians(0.3))


def test_a_suns_halo_is_left_to_the_sky():
    halo = np.degrees(np.arccos(np.clip(DIRECTIONS @ place(40.5, 120.5), -1, 1))) < 2.5
    radiance = lit((40.5, 120.5, 1.0, 0.6)) + np.where(halo, 200.0, 0.0)[..., None].astype(np.float32)
    tiles = tiles_from_map(radiance, "hemisphere", 128, NO_BRIGHT_CELLS)
    found = peaks_of(tiles)
    _, flux, _ = source_lights(tiles, found, np.arange(1))
    whole, sun = tiles.flux.sum(), radiance.max() * 3 * SOLID_ANGLES[40, 0]
    assert found.power[0] * whole > 1.05 * sun  # the halo tells that something is there
    np.testing.assert_allclose(flux.sum(), sun, rtol=0.05)  # but for the cells beside it, in which a sun may lie in part


@pytest.mark.parametrize(("fraction", "found"), [(0.008, 0), (0.012, 1), (0.025, 1)])
def test_what_holds_one_per_cent_of_the_power_can_stay(fraction, found):
    assert len(peaks(lit((40, 120, 3, fraction))).power) == found


@pytest.mark.parametrize(("fraction", "enters"), [(0.02, 0), (0.028, 0), (0.032, 1), (0.2, 1)])
def test_what_holds_three_per_cent_of_the_power_enters(fraction, enters):
    sources, now = sources_after(NO_SOURCES, peaks(lit((40, 120, 3, fraction))), 0.0, 5, MAX_COUNT)
    assert len(now) == len(sources.ids) == enters
    assert set(sources.ids) <= {5}


@pytest.mark.parametrize("diameter", [6.0, 7.0, 8.0])
def test_what_a_source_leaves_around_it_is_no_other_source(diameter):
    assert len(peaks(lit((40, 120, diameter, 0.5))).power) == 1


@pytest.mark.parametrize("diameter", [9.0, 12.0, 30.0])
def test_a_wide_light_is_no_source(diameter):
    assert len(peaks(lit((40, 120, diameter, 0.5))).power) == 0


def test_an_even_sky_and_a_ramp_have_no_source():
    assert len(peaks(lit()).power) == 0
    assert len(peaks((DIRECTIONS[..., [2]] ** 4 + np.zeros(3)).astype(np.float32)).power) == 0


def known(direction, seen_s=0.0, source=7):
    directions, whole = np.asarray(direction, float)[None], np.zeros(1, bool)
    return Sources(np.array([source]), directions, np.zeros((1, 3)), np.array([seen_s]), np.full(1, 1e-4), whole)


@pytest.mark.parametrize(("degrees", "same"), [(0.5, True), (11.0, True), (13.5, False)])
def test_a_source_that_moved_by_twelve_degrees_keeps_its_id(degrees, same):
    sources, _ = sources_after(known(place(40 + degrees, 120)), peaks(lit((40, 120, 3, 0.2))), 0.04, 50, MAX_COUNT)
    assert (sources.ids[0] == 7) == same
    assert same or sources.ids[0] == 50


@pytest.mark.parametrize(("gap_s", "same"), [(0.5, True), (0.99, True), (1.5, False)])
def test_an_id_waits_a_second_for_its_source(gap_s, same):
    places = np.stack([place(40, 120), place(70, 300)])
    before = Sources(np.array([7, 8]), places, np.zeros((2, 3)), np.array([0.0, gap_s - 0.04]), np.full(2, 1e-4), np.zeros(2, bool))
    sources, now = sources_after(before, peaks(lit((40, 120, 3, 0.2))), gap_s, 50, MAX_COUNT)
    assert len(now) == 1
    assert (sources.ids[0] == 7) == same


def test_a_source_of_the_frame_before_keeps_its_id_over_a_gap_of_any_length():
    sources, _ = sources_after(known(place(41, 120)), peaks(lit((40, 120, 3, 0.2))), 60.0, 50, MAX_COUNT)
    assert sources.ids[0] == 7


def test_each_of_two_sources_keeps_its_own_id_when_they_come_close():
    places = np.stack([place(40, 120), place(40, 140)])
    before = Sources(np.array([7, 8]), places, np.zeros((2, 3)), np.zeros(2), np.full(2, 1e-4), np.zeros(2, bool))
    sources, _ = sources_after(before, peaks(lit((40, 124, 2, 0.2), (40, 136, 2, 0.2))), 0.04, 50, MAX_COUNT)
    nearer_to_first = sources.directions @ (place(40, 124) - place(40, 136)) > 0
    assert dict(zip(sources.ids.tolist(), nearer_to_first.tolist(), strict=True)) == {7: True, 8: False}


def test_no_more_sources_than_the_limit_and_the_brightest_first():
    found = peaks(lit((40, 0, 3, 0.1), (40, 120, 3, 0.3), (40, 240, 3, 0.2)))
    _, now = sources_after(NO_SOURCES, found, 0.0, 0, 2)
    np.testing.assert_allclose(np.sort(found.power[now]), [0.2, 0.3], rtol=0.03)


def test_a_sources_light_and_the_rest_are_the_whole():
    tiles = tiles_from_map(lit((40, 120, 4, 0.3)), "hemisphere", 64, NO_BRIGHT_CELLS)
    found = peaks_of(tiles)
    sources, flux, rest = source_lights(tiles, found, np.arange(1))
    np.testing.assert_allclose(flux.sum(axis=0) + rest.flux.sum(axis=1), tiles.flux.sum(axis=1), rtol=1e-12)
    assert rest.power.sum() / tiles.power.sum() == pytest.approx(0.7, rel=0.01)
    # What is left where the lamp was is the sky behind it.
    behind = sources.part > 0
    np.testing.assert_allclose(rest.power[behind] / rest.area[behind], 1.0, rtol=0.02)


@pytest.mark.parametrize("count", [8, 64])
def test_a_sun_that_moves_and_hides_is_one_light_with_one_id(count):
    state, names, fractions = initial_tracked(), [], []
    for k in range(40):
        hidden = 10 <= k < 25  # 0.6 s
        radiance = lit((40.5, 100.5 + k, 1.0, 0.002 if hidden else 0.6))
        state, lights, _ = tracked_step(count, state, SamplerInput(radiance, "hemisphere", k / 25, NO_BRIGHT_CELLS), soft=True)
        near = lights.directions @ place(40.5, 100.5 + k) > np.cos(np.radians(2))
        if not hidden:
            brightest = np.flatnonzero(near)[lights.irradiance[near, 1].argmax()]
            names.append(int(lights.ids[brightest]))
            fractions.append(lights.irradiance[brightest, 1] / lights.irradiance[:, 1].sum(dtype=float))
    assert len(set(names)) == 1
    np.testing.assert_allclose(fractions, 0.6, rtol=0.03)


@pytest.mark.parametrize("soft", [False, True])
def test_two_sources_that_pass_each_other_keep_their_ids(soft):
    """One stands, the other comes by at half a degree in steps of eight: in the middle it is nearer to where the other was."""
    state, standing, moving = initial_tracked(), [], []
    for k in range(9):
        places = place(40, 120), place(40.5, 120 + (k - 4) * 12.5)
        lamps = [(40, 120, 1.5, 0.2), (40.5, 120 + (k - 4) * 12.5, 1.5, 0.5)]
        if k == 4:  # one behind the other: a single source
            continue
        state, lights, _ = tracked_step(48, state, SamplerInput(lit(*lamps), "hemisphere", k / 25), False, soft)
        power = lights.irradiance.sum(axis=1)
        for at, ids in zip(places, (standing, moving), strict=True):
            near = lights.directions @ at > np.cos(np.radians(3))
            ids.append(int(lights.ids[np.where(near, power, -1).argmax()]))
    assert len(set(standing)) == len(set(moving)) == 1


def test_of_points_at_a_source_the_strongest_has_its_id():
    """A sun is several points; the strongest of them is always the same light, and no two lights have one id."""
    state, strongest = initial_tracked(), []
    for k in range(40):
        open_ = 1e-3 if 20 <= k < 30 else 0.6
        state, lights, _ = tracked_step(48, state, SamplerInput(lit((40 + 0.3 * k, 120 + k, 4, open_)), "hemisphere", k / 25), False)
        assert len(set(lights.ids.tolist())) == len(lights.ids)
        near = lights.directions @ place(40 + 0.3 * k, 120 + k) > np.cos(np.radians(3))
        if open_ > 0.1:
            strongest.append(int(lights.ids[np.where(near, lights.irradiance.sum(axis=1), -1).argmax()]))
    assert len(set(strongest)) == 1


def test_many_soft_lights_divide_a_lamp_and_its_id_stays_through_the_change():
    state, seen = initial_tracked(), []
    for k, count in enumerate([96, 96, 160, 160, 96, 127, 128]):
        state, lights, _ = tracked_step(count, state, SamplerInput(lit((40, 120, 4, 0.45)), "hemisphere", k / 25), False, soft=True)
        assert len(set(lights.ids.tolist())) == len(lights.ids)
        near = lights.directions @ place(40, 120) > np.cos(np.radians(3))
        power = lights.irradiance.sum(axis=1)
        part = power[near].max() / power.sum()
        assert part > 0.4 if count < 128 else part < 0.25
        if part > 0.4 or k == 2:
            seen.append(int(lights.ids[np.where(near, power, -1).argmax()]))
    assert len(set(seen[:2] + seen[3:])) == 1


@pytest.mark.parametrize(("diameter", "fraction", "count", "divided"), [
    (5, 0.7, 64, True), (5, 0.7, 63, False), (5, 0.3, 64, False), (4, 0.9, 64, False), (1.5, 0.9, 100, False), (1.5, 0.9, 128, True),
])  # fmt: skip
def test_a_wide_strong_lamp_is_divided_from_64_lights_on_and_a_sun_from_128(diameter, fraction, count, divided):
    state, strongest = initial_tracked(), []
    for k in range(12):
        radiance = lit((40.5, 120 + 0.5 * k, diameter, fraction))
        state, lights, _ = tracked_step(count, state, SamplerInput(radiance, "hemisphere", k / 25, NO_BRIGHT_CELLS), soft=True)
        power = lights.irradiance.sum(axis=1)
        assert (power.max() / power.sum() < 0.6 * fraction) == divided
        strongest.append(int(lights.ids[power.argmax()]))
        assert len(set(lights.ids.tolist())) == len(lights.ids)
    assert divided or len(set(strongest)) == 1


def test_the_parts_of_a_divided_lamp_move_with_it():
    state, known, born, strongest = initial_tracked(), set(), [], []
    for k in range(20):
        frame = SamplerInput(lit((40.5, 120 + 2 * k, 5, 0.7)), "hemisphere", k / 25, NO_BRIGHT_CELLS)
        state, lights, _ = tracked_step(64, state, frame, soft=True)
        power = lights.irradiance.sum(axis=1)
        born.append(power[~np.isin(lights.ids, list(known))].sum() / power.sum())
        known |= set(lights.ids.tolist())
        strongest.append(int(lights.ids[power.argmax()]))
    assert np.mean(born[1:]) < 0.01
    assert len(set(strongest)) == 1


def test_whether_a_source_is_divided_is_decided_when_it_enters():
    """A lamp that grows stays one light; one that fades stays several."""
    for fractions in ([0.2, 0.5, 0.8], [0.8, 0.5, 0.2]):
        state, whole = initial_tracked(), []
        for k, fraction in enumerate(np.repeat(fractions, 3)):
            frame = SamplerInput(lit((40.5, 120, 5, fraction)), "hemisphere", k / 25, NO_BRIGHT_CELLS)
            state, lights, _ = tracked_step(64, state, frame, soft=True)
            power = lights.irradiance.sum(axis=1)
            whole.append(bool(power.max() > 0.8 * fraction * power.sum()))
        assert set(whole) == {fractions[0] < 0.5}


def test_light_is_judged_as_narrow_as_its_source_was_seen():
    radiance = lit()
    for row, column in ((40, 120), (40, 121), (41, 120), (41, 121)):
        radiance[row, column] += 2 * np.pi / 4 / np.broadcast_to(SOLID_ANGLES, (ROWS, COLS))[row, column]
    tiles = tiles_from_map(radiance, "hemisphere", 128, NO_BRIGHT_CELLS)
    source_tiles, _, _ = source_lights(tiles, peaks_of(tiles), np.arange(1))
    drawn = narrowed(tiles, source_tiles, np.array([0.25]))
    own = source_tiles.part > 0.5
    np.testing.assert_array_equal(drawn.direction[:, ~own], tiles.direction[:, ~own])
    np.testing.assert_allclose(drawn.radius[own], 0.5 * tiles.radius[own])
    before, after = (np.linalg.norm(each.direction[:, own].T - source_tiles.directions[0], axis=1) for each in (tiles, drawn))
    np.testing.assert_allclose(after, 0.5 * before)
    assert narrowed(tiles, source_tiles, np.ones(1)) is tiles


@pytest.mark.parametrize("soft", [False, True])
def test_the_lights_of_a_dark_frame_have_one_id_each(soft):
    state, lights, _ = tracked_step(48, initial_tracked(), SamplerInput(lit((40, 120, 4, 0.6)), "hemisphere", 0.0), False, soft)
    _, dark, _ = tracked_step(48, state, SamplerInput(0 * lit(), "hemisphere", 0.04), False, soft)
    assert sorted(dark.ids.tolist()) == sorted(lights.ids.tolist())


@pytest.mark.parametrize(("after_s", "widest"), [(0.04, 1.04), (1.0, 2.0)])
def test_a_source_is_no_wider_than_it_was_seen_but_widens_in_time(after_s, widest):
    found = peaks(lit((40, 120, 3, 0.3)))
    first, now = sources_after(NO_SOURCES, found, 0.0, 5, MAX_COUNT)
    assert np.isinf(first.variances[: len(now)]).all()  # a new one is as wide as it looks

    def fitted(spread_rad: float) -> LightSet:
        square = spread_rad**2
        return LightSet.of(first.ids[:1], found.directions[now[:1]], np.ones((1, 3)), np.array([[square, 0, 0, square, 0, 0]]))

    lights, first, _ = steady_extents(fitted(0.004), first, np.arange(1))
    assert lights.covariances is not None
    assert lights.covariances[0, 0] == pytest.approx(0.004**2)
    second, now = sources_after(first, found, after_s, 9, MAX_COUNT)
    lights, second, _ = steady_extents(fitted(0.02), second, np.arange(1))
    assert lights.covariances is not None
    assert lights.covariances[0, 0] == pytest.approx(widest * 0.004**2)
    lights, _, _ = steady_extents(fitted(0.003), second, np.arange(1))
    assert lights.covariances is not None
    assert lights.covariances[0, 0] == pytest.approx(0.003**2)  # narrower at once


def test_a_sun_between_four_cells_is_one_source():
    """Most of its light in one of 2 x 2 cells of a degree: all of it is the source's."""
    radiance = lit()
    for (row, column), part in {(40, 120): 0.7, (40, 121): 0.15, (41, 120): 0.1, (41, 121): 0.05}.items():
        radiance[row, column] += part * 2 * np.pi / np.broadcast_to(SOLID_ANGLES, (ROWS, COLS))[row, column]
    found = peaks(radiance)
    _, lit_peaks = sources_after(NO_SOURCES, found, 0.0, 0, MAX_COUNT)
    assert len(lit_peaks) == 1
    assert np.count_nonzero(found.owner >= 0) >= 4
    assert found.power[lit_peaks[0]] == pytest.approx(0.5, rel=0.02)


def test_a_sun_that_falls_between_cells_takes_no_more_lights_and_gets_no_wider():
    """The limit is judged by the extent that each frame shows, and the light has the narrowest of late."""
    widths, counts, state = [], [], initial_state()
    for k, parts in enumerate(([1.0, 0, 0, 0], [1.0, 0, 0, 0], [0.4, 0.3, 0.2, 0.1], [0.25] * 4, [1.0, 0, 0, 0])):
        radiance = lit()
        for (row, column), part in zip(((40, 120), (40, 121), (41, 120), (41, 121)), parts, strict=True):
            radiance[row, column] += part * 2 * np.pi / np.broadcast_to(SOLID_ANGLES, (ROWS, COLS))[row, column]
        state, lights, _ = step(Sampler(filter="none"), state, SamplerInput(radiance, "hemisphere", k / 25, NO_BRIGHT_CELLS))
        assert lights.covariances is not None
        sun = lights.irradiance[:, 1].argmax()
        assert lights.irradiance[sun, 1] / lights.irradiance[:, 1].sum() > 0.48
        widths.append(float(np.sqrt(lights.covariances[sun, [0, 3, 5]].sum() / 2)))
        counts.append(len(lights.ids))
    assert max(widths) < np.radians(0.07)  # the least extent, widened for two frames, where 0.4 degrees are seen
    assert max(counts) <= 1.5 * min(counts)
