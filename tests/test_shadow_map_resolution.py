import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import MAX_HALVINGS, MAX_RESOLUTION, map_halvings, map_resolutions, packed

BY_POWER = map_resolutions(None)
POWERS = st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=60).map(np.array)


def apart(count: int) -> np.ndarray:
    """Directions farther from each other than 4 texels of 64, up to 60 of them."""
    k = np.arange(count) + 0.5
    return direction_from_angles(np.arccos(1 - k / count), k * 2.4)


@given(POWERS)
def test_resolutions_grow_with_power(power):
    halvings = map_halvings(BY_POWER, apart(len(power)), power)
    assert halvings.min() >= 0
    assert halvings.max() <= MAX_HALVINGS
    assert np.all(np.diff(halvings[np.argsort(power)]) <= 0)


@pytest.mark.parametrize(("share", "texels"), [(0.999, 1024), (0.4, 1024), (0.16, 512), (0.063, 256), (0.025, 128), (0.01, 64), (1e-4, 64)])
def test_a_resolution_grows_as_the_power_to_three_quarters(share, texels):
    power = np.array([share, *[(1 - share) / 59] * 59])
    assert MAX_RESOLUTION >> map_halvings(BY_POWER, apart(60), power)[0] == texels


def test_the_parts_of_one_sun_have_the_resolution_of_the_sun():
    sky, whole = apart(50), np.array([0.5, *[0.5 / 49] * 49])
    parts = np.concatenate([np.repeat(sky[:1], 8, axis=0), sky[1:]])
    cut = np.concatenate([np.full(8, 0.5 / 8), whole[1:]])
    one, many = map_halvings(BY_POWER, sky, whole), map_halvings(BY_POWER, parts, cut)
    assert np.all(many[:8] == one[0])
    assert np.array_equal(many[8:], one[1:])


@given(POWERS, st.integers(0, 2))
def test_a_given_resolution_is_for_all_lights_until_time_is_short(power, halved):
    given_ = map_resolutions(256)
    assert given_.choices == (256, 128, 64)
    halvings = map_halvings(given_, apart(len(power)), power, halved)
    share = power / power.sum()
    assert np.all(halvings[share < 0.01] == halved)  # none of these is near to a strong one
    assert np.all(halvings[share > 0.2] == max(halved - 1, 0))


@given(POWERS, st.integers(0, 1))
def test_strong_lights_are_coarsened_last(power, halved):
    for how in (BY_POWER, map_resolutions(512)):
        before, after = (map_halvings(how, apart(len(power)), power, n) for n in (halved, halved + 1))
        assert np.all((after >= before) & (after <= before + 1))
    if power.max() > 0.2 * power.sum() and halved == 0:
        assert after[np.argmax(power)] == before[np.argmax(power)]


@given(POWERS, st.lists(st.floats(0.9, 1.1), min_size=1, max_size=5), st.integers(0, 2))
def test_power_that_varies_a_little_changes_no_resolution(power, factors, halved):
    directions = apart(len(power))
    halvings = map_halvings(BY_POWER, directions, power, halved)
    for factor in factors:
        wavering = power * np.where(np.arange(len(power)) % 2, factor, 1.0)
        assert np.array_equal(map_halvings(BY_POWER, directions, wavering, halved, halvings), halvings)


def sun_of(fraction: float) -> np.ndarray:
    """Powers of 60 lights, of which the first has this fraction."""
    return np.array([fraction, *[(1 - fraction) / 59] * 59])


@pytest.mark.parametrize(("change", "halvings"), [(0.99, 0), (0.87, 0), (0.76, 1), (0.6, 1)])
def test_power_changes_a_resolution_when_it_changes_by_a_fifth(change, halvings):
    """From the middle between 1024 and 512 texels: a fifth of the power is 0.2 of a halving."""
    middle = 0.4 * 2 ** (-0.5 / 0.75)
    previous = np.array([0, *[MAX_HALVINGS] * 59])
    assert map_halvings(BY_POWER, apart(60), sun_of(middle * change), 0, previous)[0] == halvings


@pytest.mark.parametrize(("apart_texels", "texels"), [(3, 1024), (6, 512)])
def test_lights_within_four_texels_cast_the_same_shadow(apart_texels, texels):
    """Two halves of a sun: as one they deserve 1024 texels, as two 512 each; at 512 texels both are within four."""
    directions = apart(60)
    side = np.cross(directions[0], [0.3, 0.5, 0.8])
    angle = apart_texels / 1024
    directions[1] = np.cos(angle) * directions[0] + np.sin(angle) * side / np.linalg.norm(side)
    power = np.array([0.2, 0.2, *[0.6 / 58] * 58])
    assert np.all(MAX_RESOLUTION >> map_halvings(BY_POWER, directions, power)[:2] == texels)


@pytest.mark.parametrize(("fraction", "halvings"), [(0.13, 0), (0.125, 0), (0.05, 1), (0.03, 1)])
def test_from_an_eighth_of_the_power_on_a_map_skips_the_first_coarsening(fraction, halvings):
    assert map_halvings(map_resolutions(256), apart(60), sun_of(fraction), 1)[0] == halvings


@pytest.mark.parametrize(("given_", "choices"), [(256, (256, 128, 64)), (63, (63, 31)), (32, (32, 16)), (31, (31,)), (16, (16,))])
def test_a_given_resolution_is_halved_twice_but_not_below_16(given_, choices):
    """With 8 texels, of which 4 are the rim, a map shows no shadow."""
    assert map_resolutions(given_).choices == choices


def test_power_that_changes_changes_resolutions():
    directions, weak = apart(60), np.ones(60)
    halvings = map_halvings(BY_POWER, directions, weak)
    strong = weak.copy()
    strong[3] = 1000.0
    later = map_halvings(BY_POWER, directions, strong, 0, halvings)
    assert later[3] == 0
    assert np.all(later[np.arange(60) != 3] == MAX_HALVINGS)
    assert np.array_equal(map_halvings(BY_POWER, directions, weak, 0, np.full(60, -1)), halvings)


@given(st.lists(st.sampled_from([1024, 512, 256, 128, 64, 100, 25]), min_size=0, max_size=80).map(lambda sizes: np.array(sizes, np.int64)))
def test_tiles_lie_in_the_texture_and_on_no_other(sizes):
    packing = packed(sizes, 8192)
    if packing is None:
        assert np.sum(sizes**2) > 8192**2 / 2
        return
    taken = np.zeros((packing.height, packing.width), np.uint8)
    for (x, y), size in zip(packing.corners.tolist(), sizes.tolist(), strict=True):
        assert y + size <= packing.height
        assert x + size <= packing.width
        taken[y : y + size, x : x + size] += 1
    assert taken.max(initial=0) <= 1
    again = packed(sizes, 8192)
    assert again is not None
    assert np.array_equal(again.corners, packing.corners)


@pytest.mark.parametrize(("sizes", "fits"), [([64] * 4, True), ([64] * 5, False), ([128], True), ([64, 64, 128], False), ([129], False)])
def test_maps_that_do_not_fit_have_no_packing(sizes, fits):
    assert (packed(np.array(sizes), 128) is not None) == fits


def test_small_maps_leave_little_of_the_texture_empty():
    for sizes in ([256] * 72, [1024, *[64] * 71], [512] * 7 + [64] * 65):
        packing = packed(np.array(sizes), 8192)
        assert packing is not None
        assert packing.width * packing.height <= 2.6 * np.sum(np.square(sizes))  # one large map and little else: half beside it is empty
