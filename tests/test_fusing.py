"""Near lights of several cameras: located where they are, never where nothing is, and no light lost or counted twice."""

import msgspec
import numpy as np
import pytest

from tests.support.analytic_rooms import PAIR, SQUARE, TRIANGLE, Room, maps_of, noisy, rig_of, room_map, sphere_lamp
from tests.support.lamp_maps import Bulb, far, lamp_map, lamp_maps
from vemlight.fuse import compact_sources
from vemlight.fuse.fusing import FuseState, fuse_step, fuse_still
from vemlight.fuse.gains import gains_by_walls, initial_gains
from vemlight.fuse.set_packing import best_disjoint
from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.near_lights import NearLightSet
from vemlight.light.sphere import cell_directions, map_irradiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler

BULBS = (
    Bulb((1.6, 1.2, 2.3), (1.0, 0.8, 0.6)),
    Bulb((-1.9, 0.7, 1.9), (0.6, 0.7, 0.9), 0.08),
    Bulb((0.4, -2.1, 2.6), (0.9, 0.9, 0.9), 0.03),
)
SUN = far((0.3, -0.5, 0.8), 0.4)


def fused(rig, moments, rng=None, saturated=()):
    """The results of frames in order, with noise where there is a generator."""
    state, results = FuseState.start(rig), []
    for maps in moments:
        seen = [each if each is None or rng is None else noisy(each, rng) for each in maps]
        state, *result = fuse_step(state, seen, saturated)
        results.append(tuple(result))
    return results


def errors(points: NearLightSet, bulbs) -> np.ndarray:
    """The distance of each bulb's nearest point, m."""
    return np.array([np.linalg.norm(points.at - bulb.at, axis=1).min(initial=np.inf) for bulb in bulbs])


@pytest.mark.parametrize("places", [PAIR, TRIANGLE, SQUARE], ids=len)
def test_lamps_are_found_where_they_are_and_a_sun_stays_far(places):
    rng = np.random.default_rng(1)
    rig = rig_of(places)
    _, points, report = fused(rig, [lamp_maps((*BULBS, SUN), rig, rng)] * 3, rng)[-1]
    assert len(points.ids) == report.located == len(BULBS)
    away = np.array([np.linalg.norm(np.subtract(bulb.at, rig.centre)) for bulb in BULBS])
    assert (errors(points, BULBS) < 0.02 * away).all()
    assert (errors(points, BULBS) < 3 * points.sigma.max()).all()
    nearest = [int(np.argmin(np.linalg.norm(points.at - bulb.at, axis=1))) for bulb in BULBS]
    np.testing.assert_allclose(points.intensity[nearest], [bulb.intensity for bulb in BULBS], rtol=0.05)
    np.testing.assert_allclose(points.radius[nearest], [bulb.radius for bulb in BULBS], rtol=0.15)
    assert report.believed
    assert report.unexplained == 0


def test_points_and_lights_have_all_the_light_at_the_centre():
    """Directional lights, and intensity over squared distance, add up to the integral of the fused light, in each channel."""
    rng = np.random.default_rng(2)
    rig = rig_of(TRIANGLE)
    maps = lamp_maps((*BULBS, SUN), rig, rng, error=0.0)
    rest, points, report = fused(rig, [maps] * 2)[-1]
    _, lights, _ = step(Sampler(), initial_state(), SamplerInput(rest.radiance, rest.coverage, 0.0, rest.bright_cells))
    total = lights.irradiance.sum(axis=0, dtype=np.float64) + points.irradiance_at(rig.centre).sum(axis=0)
    np.testing.assert_allclose(total, report.irradiance, rtol=1e-3)
    # And that is what a map at the centre has.
    truth = lamp_map((*BULBS, SUN), rig.centre, np.eye(3))
    np.testing.assert_allclose(total, map_irradiance(truth.radiance, truth.coverage), rtol=0.01)
    # Where a lamp was, the rest has its background.
    lit = cell_directions(90, 360, "hemisphere") @ (np.subtract(BULBS[0].at, TRIANGLE[0]) / np.linalg.norm(BULBS[0].at - TRIANGLE[0]))
    assert rest.radiance[lit > np.cos(0.03)].max() < 0.1 < maps[0].radiance[lit > np.cos(0.03)].max()


def test_far_lights_are_never_near():
    rng = np.random.default_rng(3)
    for trial in range(12):
        rig = rig_of((PAIR, TRIANGLE, SQUARE)[trial % 3])
        sky = [far((*rng.normal(size=2), rng.uniform(0.1, 1.5)), 10 ** rng.uniform(-2, 0), rng.uniform(0.004, 0.05)) for _ in range(10)]
        for _, points, _ in fused(rig, [lamp_maps(sky, rig, rng)] * 12, rng):
            assert len(points.ids) == 0


def test_a_lamp_that_one_camera_sees_stays_a_direction():
    rng = np.random.default_rng(4)
    rig = rig_of(TRIANGLE)
    whole, hidden = lamp_maps(BULBS[:2], rig, rng), lamp_maps(BULBS[:1], rig, rng)
    rest, points, report = fused(rig, [[whole[0], *hidden[1:]]] * 3, rng)[-1]
    assert len(points.ids) == 1
    assert errors(points, BULBS[:1])[0] < 0.05
    assert report.unexplained == 1
    # Its light is a third of the mean map.
    lamp = np.array(BULBS[1].intensity) / np.sum((np.array(BULBS[1].at) - TRIANGLE[0]) ** 2)
    without, *_ = fused(rig, [hidden] * 3)[-1]
    more = map_irradiance(rest.radiance, rest.coverage) - map_irradiance(without.radiance, without.coverage)
    np.testing.assert_allclose(more, lamp / 3, rtol=0.05)


def test_two_equal_lamps_in_a_plane_with_two_cameras_are_no_ghosts():
    """Directions fit four places; flux and distance tell which two."""
    rng = np.random.default_rng(5)
    rig = rig_of(PAIR)
    bulbs = (Bulb((-0.9, 1.5, 2.4)), Bulb((1.4, 1.5, 2.4)))
    _, points, _ = fused(rig, [lamp_maps(bulbs, rig, rng)] * 3, rng)[-1]
    assert len(points.ids) == 2
    assert errors(points, bulbs).max() < 0.06


@pytest.mark.parametrize("places", [PAIR, TRIANGLE], ids=len)
def test_four_lamps_in_a_plane_with_two_cameras_give_no_place_that_is_none(places):
    rng = np.random.default_rng(6)
    rig = rig_of(places)
    bulbs = [Bulb((x, 1.8, 2.5)) for x in (-2.2, -0.8, 0.6, 2.0)]
    _, points, _ = fused(rig, [lamp_maps(bulbs, rig, rng)] * 3, rng)[-1]
    for at in points.at:
        assert min(np.linalg.norm(at - bulb.at) for bulb in bulbs) < 0.15
    assert len(points.ids) >= (3 if len(places) == 2 else 4)


def test_a_lamp_on_the_line_through_both_cameras_has_its_distance_by_flux():
    """There is no parallax. That lamps shine alike to 12 % leaves 3 % of the distance at 1.5 m, 12 % at 3 m."""
    rng = np.random.default_rng(7)
    rig = rig_of(PAIR)
    for distance in (1.5, 3.0):
        bulb = Bulb((distance, 0.0, 1.25))
        first, *results = fused(rig, [lamp_maps((bulb,), rig, rng, background=0.01)] * 3, rng)
        assert len(first[1].ids) == 0
        for _, points, _ in results:
            assert len(points.ids) == 1
            assert errors(points, (bulb,))[0] < 3 * points.sigma[0] < 0.65 * distance


def test_poses_that_are_more_wrong_than_declared_publish_nothing():
    """Two cameras have few checks, and a wrong rig passes them by chance: 2, 0 and 0 of 40 with 2, 3 and 4 cameras were measured."""
    rng = np.random.default_rng(8)
    for places, most in ((PAIR, 2), (TRIANGLE, 0), (SQUARE, 0)):
        rig, published = rig_of(places), 0
        for maps in (lamp_maps(BULBS, rig, rng, error=8.0) for _ in range(6)):
            _, points, report = fused(rig, [maps] * 3, rng)[-1]
            published += len(points.ids) > 0
            assert len(points.ids) > 0 or (report.unexplained >= 2 and report.located == 0)
        assert published <= most


def test_lamps_that_some_cameras_see_otherwise_or_not_at_all_silence_no_other():
    """Cameras metres apart: each sees two lamps of its own, and a panel sends each another flux. Poses are right: the rest is sure."""
    rng = np.random.default_rng(34)
    rig = rig_of(TRIANGLE * (3, 3, 1))
    own = [[far((*rng.normal(size=2), rng.uniform(0.3, 1.0)), 0.3, 0.02) for _ in range(2)] for _ in TRIANGLE]
    panel = Bulb((-0.5, 2.2, 2.4))
    maps = [
        lamp_maps((*BULBS, *alone, panel._replace(intensity=(power,) * 3)), rig, np.random.default_rng(35))[k]
        for k, (alone, power) in enumerate(zip(own, (0.25, 1.0, 2.0), strict=True))
    ]
    for _, points, report in fused(rig, [maps] * 3, rng)[1:]:
        assert report.believed
        assert report.unexplained >= 5
        away = np.array([np.linalg.norm(np.subtract(bulb.at, rig.centre)) for bulb in BULBS])
        assert (errors(points, BULBS) < 0.02 * away).all()


def test_glow_on_a_wall_turns_no_bearing():
    """A lamp 12 cm from a wall lights it to one side; its direction is right to a tenth of a cell, of 1 and of 2 degrees."""
    lamp, place = sphere_lamp((1.2, 2.38, 2.0), 1.0), np.array([0.3, -0.4, 1.1])
    room = Room(np.array([6.0, 5.0, 3.0]), np.full((6, 3), 0.7), (lamp,), ambient=0.01)
    to = (lamp.at - place) / np.linalg.norm(lamp.at - place)
    for rows in (90, 45):
        found = compact_sources.compact_sources(room_map(room, place, rows=rows))
        assert np.degrees(np.linalg.norm(found.directions - to, axis=1).min()) < 0.1 * 90 / rows


def test_a_lamp_in_a_mirror_is_where_it_seems_to_be():
    rng = np.random.default_rng(9)
    lamp = sphere_lamp((-1.2, 0.8, 2.2), 1.0)
    room = Room(np.array([5.0, 5.0, 3.0]), np.full((6, 3), 0.4), (lamp,), mirror=(-2.0, 0.3, 2.0, 2.9, 0.9))
    rig = rig_of(TRIANGLE)
    _, points, _ = fused(rig, [maps_of(room, rig, rng)] * 3, rng)[-1]
    seems = (Bulb((-1.2, 0.8, 2.2)), Bulb((5.0 + 1.2, 0.8, 2.2)))
    assert len(points.ids) == 2
    assert (errors(points, seems) < (0.04, 0.4)).all()


def test_a_lamp_that_goes_is_gone_at_once_and_comes_back_with_its_id():
    rng = np.random.default_rng(10)
    rig = rig_of(TRIANGLE)
    on, off = lamp_maps(BULBS, rig, rng), None
    rng = np.random.default_rng(10)
    off = lamp_maps(BULBS[:2], rig, rng)  # of the same poses
    results = fused(rig, [on, on, on, off, off, on, on], rng)
    ids = [set(points.ids.tolist()) for _, points, _ in results]
    assert [len(each) for each in ids] == [0, 3, 3, 2, 2, 3, 3]
    assert ids[5] == ids[6] == ids[2]


def test_a_lamp_that_jumps_keeps_its_id():
    rng = np.random.default_rng(11)
    rig = rig_of(TRIANGLE)
    moments = [lamp_maps((bulb, BULBS[1]), rig, np.random.default_rng(12)) for bulb in
               [BULBS[0]] * 3 + [BULBS[0]._replace(at=(1.2, 1.4, 2.3))] * 2]  # fmt: skip
    results = fused(rig, moments, rng)
    assert set(results[2][1].ids.tolist()) == set(results[4][1].ids.tolist())
    assert len(results[3][1].ids) == 2
    assert errors(results[4][1], (Bulb((1.2, 1.4, 2.3)),))[0] < 0.05


def test_a_walking_lamp_is_followed():
    rig = rig_of(TRIANGLE)
    bulbs = [Bulb((1.6 - 0.05 * k, 1.2, 2.0)) for k in range(10)]
    results = fused(rig, [lamp_maps((bulb,), rig, np.random.default_rng(13)) for bulb in bulbs], np.random.default_rng(14))
    for (_, points, _), bulb in list(zip(results, bulbs, strict=True))[1:]:
        assert points.ids.tolist() == [0]
        assert errors(points, (bulb,))[0] < 0.05


def test_a_hidden_lamp_stays_and_its_light_is_not_counted_twice():
    rng = np.random.default_rng(15)
    rig = rig_of(PAIR)
    both, one = lamp_maps(BULBS[:2], rig, np.random.default_rng(16)), lamp_maps(BULBS[:1], rig, np.random.default_rng(16))
    results = fused(rig, [both] * 3 + [[both[0], one[1]]] * 12, rng)
    counts = [len(points.ids) for _, points, _ in results]
    assert counts == [0] + [2] * 10 + [1] * 4  # eight frames of patience
    assert results[5][2].hidden == 1
    rest, *_ = results[5]
    lamp = np.subtract(BULBS[1].at, PAIR[0])
    lit = cell_directions(90, 360, "hemisphere") @ (lamp / np.linalg.norm(lamp)) > np.cos(0.02)
    assert rest.radiance[lit].max() < 0.15


def test_saturated_lamps_are_placed_by_direction():
    """What a clipped pixel holds is unknown: that its flux is a third too small speaks against no place."""
    rig = rig_of(TRIANGLE)
    maps = lamp_maps(BULBS[:1], rig, np.random.default_rng(17))
    level = 0.35 * maps[0].radiance.max()
    cut = [maps[0]._replace(radiance=np.minimum(maps[0].radiance, level)), *maps[1:]]
    without, with_ = (fused(rig, [cut] * 3, np.random.default_rng(18), saturated)[-1] for saturated in ((), (True, False, False)))
    assert errors(with_[1], BULBS[:1])[0] < 0.05
    assert (without[2].unexplained, with_[2].unexplained) == (1, 0)
    np.testing.assert_allclose(with_[1].intensity[0], BULBS[0].intensity, rtol=0.05)


def test_a_silent_camera_is_left_out_and_returns():
    rng = np.random.default_rng(18)
    rig = rig_of(TRIANGLE)
    maps = lamp_maps(BULBS, rig, rng)
    results = fused(rig, [maps, maps, [None, *maps[1:]], [None, *maps[1:]], maps], rng)
    assert [report.silent for *_, report in results] == [(), (), ("a",), ("a",), ()]
    ids = [set(points.ids.tolist()) for _, points, _ in results[1:]]
    assert all(len(each) == 3 and each == ids[0] for each in ids)
    with pytest.raises(ValueError, match="silent"):
        fuse_step(FuseState.start(rig), [None] * 3)


def test_a_covered_camera_counts_as_silent():
    """A black map beside others would lessen their mean, and speak against every lamp that it should show."""
    rng = np.random.default_rng(31)
    rig = rig_of(TRIANGLE)
    maps = lamp_maps(BULBS, rig, rng)
    black = maps[1]._replace(radiance=np.zeros_like(maps[1].radiance), bright_cells=NO_BRIGHT_CELLS)
    without, with_ = (fused(rig, [[maps[0], each, maps[2]]] * 2)[-1] for each in (None, black))
    assert without[2].silent == with_[2].silent == ("b",)
    assert (len(with_[1].ids), with_[2].unexplained) == (3, 0)
    np.testing.assert_array_equal(with_[2].irradiance, without[2].irradiance)


def test_a_source_that_another_camera_may_have_left_out_speaks_against_no_pose():
    """Sources end at 0.2 % of a map's light: what one camera sees just above that, the next may have just below."""
    rng = np.random.default_rng(32)
    rig = rig_of(TRIANGLE)
    maps = lamp_maps(BULBS, rig, rng)
    power = float(luminance_from_rgb(map_irradiance(maps[0].radiance, maps[0].coverage)))
    for times, unexplained in ((1.25, 0), (2.5, 1)):
        faint = far((-0.5, -0.5, 1.0), times * compact_sources.MIN_SHARE * power, 0.02)
        first = lamp_map((*BULBS, faint), TRIANGLE[0], np.eye(3))
        report = fused(rig, [[first, *maps[1:]]] * 2, rng)[-1][2]
        assert (report.sources, report.unexplained) == (10, unexplained)


def test_a_step_leaves_the_state_before_it_as_it_was():
    rng = np.random.default_rng(19)
    rig = rig_of(PAIR)
    maps = lamp_maps(BULBS, rig, rng)
    state, *_ = fuse_step(FuseState.start(rig), maps)
    first, again = fuse_step(state, maps), fuse_step(state, maps)
    np.testing.assert_array_equal(first[1].radiance, again[1].radiance)
    for one, other in zip(first[2].arrays(), again[2].arrays(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_damaged_cells_are_dark():
    rng = np.random.default_rng(20)
    rig = rig_of(PAIR)
    maps = lamp_maps(BULBS, rig, rng)
    for each in maps:
        each.radiance[60, 100:110] = (np.nan, np.inf, -1.0)
    rest, points, _ = fused(rig, [maps] * 3)[-1]
    assert np.isfinite(rest.radiance).all()
    assert (rest.radiance >= 0).all()
    assert len(points.ids) == 3


def test_darkness_and_even_light_have_no_lamps():
    rig = rig_of(PAIR)
    for level in (0.0, 1.0):
        maps = [lamp_map((), place, np.eye(3), level) for place in PAIR]
        rest, points, report = fused(rig, [maps] * 2)[-1]
        assert (len(points.ids), report.sources, report.unexplained) == (0, 0, 0)
        np.testing.assert_allclose(rest.radiance, maps[0].radiance, rtol=1e-6)


def test_a_camera_in_another_unit_is_brought_to_the_first_ones():
    rng = np.random.default_rng(21)
    rig = rig_of(TRIANGLE)
    maps = lamp_maps(BULBS, rig, rng)
    other = maps[2]._replace(radiance=maps[2].radiance * np.array([0.3, 0.4, 0.5], np.float32))
    results = fused(rig, [[*maps[:2], other]] * 6, rng)
    np.testing.assert_allclose(results[-1][2].gains[2] * (0.3, 0.4, 0.5), 1, rtol=0.05)
    assert len(results[-1][1].ids) == 3
    plain = fused(rig, [maps] * 6, rng)[-1]
    np.testing.assert_array_equal(plain[2].gains, 1)  # what is alike is left alone


def test_walls_of_other_colours_are_no_gain():
    """Cameras four metres apart look at other parts of a room with coloured walls: only what is alike in all of them is a gain."""
    rng = np.random.default_rng(33)
    wide = np.array([[-2.0, 0.3, 1.2], [2.0, -0.3, 1.2]])
    for _ in range(6):
        room = Room(np.array([9.0, 7.0, 3.0]), rng.uniform(0.1, 0.9, (6, 3)), (sphere_lamp((rng.uniform(-3, 3), 1.5, 2.2), 2.0),))
        alike, other = ([room_map(room, place) for place in places] for places in (wide, wide / 16 + (0, 0, 1.1)))
        np.testing.assert_array_equal(gains_by_walls(initial_gains(rig_of(wide)), rig_of(wide), alike).ln, 0)
        changed = other[1]._replace(radiance=other[1].radiance * np.array([0.2, 0.25, 0.3], np.float32))
        found = gains_by_walls(initial_gains(rig_of(wide)), rig_of(wide), [other[0], changed])
        np.testing.assert_allclose(np.exp(found.ln[1]) * (0.2, 0.25, 0.3), 1, rtol=0.15)


def test_a_still_is_known_as_well_as_one_frame_and_no_better():
    """Noise counts once, though two passes are made: exact poses, so that noise is most of what sigma says."""
    rng = np.random.default_rng(22)
    rig = msgspec.structs.replace(rig_of(TRIANGLE), pose_deg=0.0, pose_m=0.0)
    maps = [noisy(each, rng) for each in lamp_maps(BULBS, rig, rng)]
    _, points, report = fuse_still(FuseState.start(rig), maps)
    once, _, none, _ = fuse_step(FuseState.start(rig), maps)
    _, _, again, _ = fuse_step(once, maps)
    covariances = once.lights.tracks.place_covariances()
    assert (len(points.ids), len(none.ids), report.hidden) == (3, 0, 0)
    np.testing.assert_allclose(points.sigma, np.sqrt(np.trace(covariances, axis1=1, axis2=2)), rtol=1e-4)
    assert (again.sigma < points.sigma).all()
    assert report.misfit < 1


def test_limits_that_are_reached_are_said(monkeypatch):
    rng = np.random.default_rng(23)
    rig = rig_of(PAIR)
    maps = lamp_maps(BULBS, rig, rng)
    assert fused(rig, [maps])[0][2].limits == ()
    monkeypatch.setattr(compact_sources, "MAX_SOURCES", 2)
    *_, report = fused(rig, [maps] * 2)[-1]
    assert [text.partition(" compact")[0] for text in report.limits] == [f"camera {name} sees more than 48" for name in "ab"]


def test_a_set_that_was_not_sought_to_the_end_is_not_called_the_best():
    rng = np.random.default_rng(24)
    few = np.array([[0, 3, -1], [0, 4, -1], [1, 4, -1]])
    best, is_exact = best_disjoint(few, np.array([2.0, 3.0, 2.0]))
    assert (best.tolist(), is_exact) == ([0, 2], True)
    many = np.stack([20 * k + rng.integers(0, 20, 400) for k in range(3)], axis=1)
    best, is_exact = best_disjoint(many, rng.uniform(9, 10, 400))
    assert not is_exact
    assert len(np.unique(many[best])) == many[best].size > 30
