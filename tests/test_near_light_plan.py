"""Which near lights are traced, and into which layers: values, without GL."""

import numpy as np
import pytest

from vemlight.kernels import kernel
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import MAX_INTENSITY, NearLightSet
from vemlight.renderer.frame_budget import MIN_LIGHTS
from vemlight.renderer.gl.constants import NEAR_BATCH
from vemlight.renderer.passes.near_lights.near_light_plan import (
    NearInTime,
    NearLayers,
    mean_irradiance,
    mean_squares,
    near_in_time,
    near_of,
    near_within,
    strongest_first,
    with_joined,
)
from vemlight.renderer.passes.near_lights.near_light_views import MAX_RESOLUTION, face_windows, map_resolution
from vemlight.renderer.passes.shadow_maps.casters import PlacedCasters
from vemlight.renderer.rays.bounce import Light, _near
from vemlight.renderer.rays.soft_pattern import STRATA, ball_pattern

PLACED = PlacedCasters((), (), np.zeros(3), np.zeros(3), np.ones(3), np.zeros((0, 4, 4)))


def lamps(count: int) -> NearLightSet:
    rng = np.random.default_rng(3)
    return NearLightSet.of(np.arange(count), rng.uniform(-3, 3, (count, 3)), np.ones((count, 3)), np.full(count, 0.1), np.zeros(count))


def planned(layers: NearLayers | None, lights: NearLightSet, affordable: int = 256) -> NearInTime:
    return near_in_time(layers, lights, np.zeros(len(lights.ids), bool), PLACED, 256, lambda stale: min(stale, affordable))


def test_a_light_that_comes_or_goes_leaves_the_others_as_they_are():
    """Laid out for nine there is room for two more."""
    whole, layers, traced = lamps(12), None, []
    for count in (9, 10, 11, 8, 11, 12):
        made = planned(layers, near_of(whole, np.arange(count)))
        layers = made.layers
        traced.append(len(made.batch.traced))
    assert traced == [9, 1, 1, 0, 0, 12]


def test_a_few_lights_that_are_left_of_many_have_fine_maps_again():
    many = planned(None, lamps(NEAR_BATCH))
    few = planned(many.layers, lamps(3))
    assert map_resolution(many.batch.slots, None) == 128
    assert map_resolution(few.batch.slots, None) == MAX_RESOLUTION
    assert len(few.batch.traced) == 3


def test_no_layer_is_read_by_two_lights_and_each_holds_the_light_that_reads_it():
    """Over a minute of lamps that come, go and move, of which few are traced a frame."""
    rng, layers = np.random.default_rng(5), None
    for _ in range(200):
        chosen = np.flatnonzero(rng.random(40) < 0.5)
        lights = near_of(lamps(40), chosen)
        lights.at[:] += rng.normal(0, 0.02, lights.at.shape)
        made = planned(layers, lights, affordable=3)
        layers = made.layers
        assert len(set(made.batch.layers.tolist())) == len(chosen)
        assert np.array_equal(layers.ids[made.batch.layers], lights.ids)
        assert np.array_equal(layers.at[made.batch.layers[made.batch.traced]], lights.at[made.batch.traced])


def ring(count: int, noise: float = 0.0, seed: int = 0) -> NearLightSet:
    """Like lamps about the middle, whose places and intensities are known to so much."""
    rng, turn = np.random.default_rng(seed), np.arange(count) * 2 * np.pi / count
    at = np.stack([2 * np.cos(turn), 2 * np.sin(turn), np.full(count, 2.0)], axis=-1) + rng.normal(0, noise, (count, 3))
    intensity = np.array([3.0, 2.0, 1.0]) * rng.normal(1, noise, (count, 1))
    return NearLightSet.of(np.arange(count), at, intensity, np.full(count, 0.1), np.zeros(count))


def test_lights_that_there_is_no_time_for_shine_from_the_nearest_that_are_drawn():
    """In each channel the scene gets as much of all, whatever the number, and what is drawn stays where it is."""
    rng = np.random.default_rng(7)
    whole = lamps(60)
    coloured = rng.uniform(0, 3, (60, 3)).astype(np.float32)
    whole = strongest_first(NearLightSet(whole.ids, whole.at, coloured, whole.radius, whole.sigma), PLACED)
    given = (whole.intensity / mean_squares(whole, PLACED)[:, None]).sum(axis=0)
    for count in (1, 8, 59, 60):
        few = with_joined(whole, count, PLACED)
        assert (few.intensity / mean_squares(few, PLACED)[:, None]).sum(axis=0) == pytest.approx(given, rel=1e-5)
        assert np.array_equal(few.at, whole.at[:count])
        assert np.array_equal(few.ids, whole.ids[:count])
    pair = NearLightSet.of(np.arange(3), np.array([[2, 0, 0], [-2, 0, 0], [-2, 0.1, 0]]), np.ones((3, 3)), np.zeros(3), np.zeros(3))
    assert with_joined(pair, 2, PLACED).intensity[:, 0] == pytest.approx([1, 2], rel=1e-2)
    strong = NearLightSet.of(np.arange(2), np.array([[0, 0, 0], [1e6, 0, 0]]), np.full((2, 3), MAX_INTENSITY), np.zeros(2), np.zeros(2))
    assert np.isfinite(with_joined(strong, 1, PLACED).intensity).all()
    assert np.isfinite(with_joined(near_of(strong, np.array([1, 0])), 1, PLACED).intensity).all()


def test_noise_does_not_change_which_of_like_lights_are_drawn():
    """A rig's: millimetres and one percent from frame to frame; one that is twice as strong comes first."""
    assert {tuple(strongest_first(ring(40, 0.01, seed), PLACED).ids[:8].tolist()) for seed in range(50)} == {tuple(range(8))}
    lights = ring(40, 0.01)
    lights.intensity[30] *= 2
    assert strongest_first(lights, PLACED).ids[:3].tolist() == [30, 0, 1]


@kernel
def received_upwards(light):
    return _near(light, np.int64(0), np.zeros(3, np.float32), np.float32(0), np.float32(0), np.float32(0), np.float32(1))[0]


@pytest.mark.parametrize("distance", [2e-4, 0.05, 0.3, 2.0])
@pytest.mark.parametrize("radius", [0.0, 0.2])
def test_the_bounce_lights_its_hits_as_near_lights_light_surfaces(distance, radius):
    """Irradiance over intensity on a plane that faces the light, also within its radius and nearer than a millimetre."""
    near = NearLightSet.of(np.zeros(1), np.array([[0.0, 0.0, distance]]), np.ones((1, 3)), np.full(1, radius), np.zeros(1))
    light = Light.of(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), near)
    assert received_upwards(light) == pytest.approx(near.irradiance_at((0.0, 0.0, 0.0))[0, 0], rel=1e-5)


def test_samples_of_one_ray_each_fill_a_ball_evenly():
    """As 64 passes of a pause have them: each 16 of a pixel, and each 16 pixels, lie in all rings of like area, and no two in one place."""
    offsets = np.concatenate([ball_pattern(sample, 64) for sample in range(64)])  # (64, 2, 16)
    ring = (STRATA * (offsets.astype(np.float64) ** 2).sum(axis=1)).astype(int)
    for first in range(0, 64, STRATA):
        assert all(len(set(ring[first : first + STRATA, pixel].tolist())) == STRATA for pixel in range(16))
    assert all(len(set(own.tolist())) == STRATA for own in ring)
    assert all(len(np.unique(offsets[:, :, pixel].round(4), axis=0)) == 64 for pixel in range(16))
    assert np.abs(offsets.mean(axis=0)).max() < np.abs(ball_pattern(0, 1).mean(axis=0)).max()  # of a pixel: better than one pass of 16 rays


def test_the_strongest_of_near_and_directional_lights_are_drawn_and_some_of_either():
    """Ten strong and ten weak near lights beside twenty directional ones between them."""
    intensity = np.repeat([[4.0] * 3, [1e-3] * 3], 10, axis=0)
    near = NearLightSet.of(np.arange(20), np.tile([0.0, 0.0, 2.0], (20, 1)), intensity, np.zeros(20), np.zeros(20))
    directional = LightSet.of(np.arange(20), np.tile([0.0, 0.0, 1.0], (20, 1)), np.full((20, 3), 0.1))
    assert mean_irradiance(near, PLACED)[:10] == pytest.approx(4.0 / (4 + 1), rel=1e-6)
    drawn = {most: len(near_within(near, PLACED, directional, most, 256).ids) for most in (8, 17, 28, 33, 40)}
    assert drawn == {8: MIN_LIGHTS, 17: 9, 28: 10, 33: 13, 40: 20}


@pytest.mark.parametrize(("at", "faces"), [
    ((0.0, 0.0, 0.0), {0, 1, 2, 3, 4, 5}),
    ((0.0, 0.0, 9.0), {1}),
    ((9.0, 0.0, 0.0), {3}),
    ((4.0, 0.0, 4.0), {1, 3}),
])  # fmt: skip
def test_maps_look_where_receivers_are(at, faces):
    """A box of 2 m about the origin: the faces through which it is seen, and windows that hold its corners."""
    box = np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]])
    windows = face_windows(np.array(at), box)
    assert set(np.flatnonzero(np.all(windows[:, 2:] > windows[:, :2], axis=1)).tolist()) == faces
    if len(faces) == 1:
        assert windows[next(iter(faces))] == pytest.approx([-1 / 8, -1 / 8, 1 / 8, 1 / 8])
