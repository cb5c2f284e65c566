"""Virtual lamps: their light, their ids, that pictures have them: live, in a pause and in gloss."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.light_sets import uniform_lights
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.extent import Extents, points_of_extents, received
from vemlight.light.light_set import LightSet, are_covariances
from vemlight.light.mask import MAX_POINTS
from vemlight.light.reflected_light import reflected_light
from vemlight.light.sphere import direction_from_angles, map_irradiance
from vemlight.light.virtual_lamp import MAX_LAMP_ID, VIRTUAL_IDS_FROM, VirtualLamp, check_lamps, is_virtual, lights_of_lamps, with_lamps
from vemlight.renderer.accumulation import PASSES, MapLights
from vemlight.runtime import wire
from vemlight.runtime.poses import MAX_POSES, Pose
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.stage import SamplerStage
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler, Settings

LAMP = VirtualLamp(id=3, azimuth_deg=90.0, elevation_deg=30.0, irradiance=(3.0, 2.0, 1.0), size_deg=40.0)


@given(st.floats(0.5, 110), st.floats(-90, 90), st.floats(-360, 360))
def test_a_lamp_has_the_mean_and_the_covariance_of_its_disc(size_deg, elevation_deg, azimuth_deg):
    lamp = VirtualLamp(id=1, azimuth_deg=azimuth_deg, elevation_deg=elevation_deg, irradiance=(1.0, 1.0, 1.0), size_deg=size_deg)
    lights = lights_of_lamps([lamp])
    # the disc itself: z even in [cos a, 1], any azimuth
    z = 1 - (1 - np.cos(np.radians(size_deg / 2))) * (np.arange(400)[:, None] + 0.5) / 400
    phi = 2 * np.pi * np.arange(32) / 32
    local = np.stack(np.broadcast_arrays(np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z), axis=-1).reshape(-1, 3)
    axis = direction_from_angles(np.radians(90 - elevation_deg), np.radians(azimuth_deg))
    across = np.linalg.svd(axis[None])[2][1:]
    directions = local @ np.stack([*across, axis])
    mean = directions.mean(axis=0)
    covariance = np.cov(directions.T, bias=True)[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    assert lights.covariances is not None
    assert are_covariances(lights.covariances)
    assert lights.covariances[0] == pytest.approx(covariance, abs=2e-6)
    assert lights.directions[0] * Extents.of(lights).concentrations[0] == pytest.approx(mean, abs=1e-5)
    # a plane that faces it gets its irradiance
    assert lights.irradiance[0] * received(np.ones(1), Extents.of(lights))[0] == pytest.approx(1.0, rel=1e-4)


def test_lamps_come_last_and_keep_their_ids():
    lights = uniform_lights(5, 0.0)
    both = with_lamps(lights, [LAMP])
    assert both.ids[:5].tolist() == lights.ids.tolist()
    assert both.ids[5] == VIRTUAL_IDS_FROM + 3
    assert is_virtual(both).tolist() == 5 * [False] + [True]
    assert is_virtual(points_of_extents(both)).sum() == 4
    assert 4 * (VIRTUAL_IDS_FROM + MAX_LAMP_ID) + 3 < 2**53  # exact in JSON
    assert with_lamps(lights, []) is lights
    points = with_lamps(lights, [VirtualLamp(id=1, azimuth_deg=0, elevation_deg=0, irradiance=(1, 1, 1), size_deg=0.0)])
    assert (points.covariances is None) == (lights.covariances is None)
    with pytest.raises(ValueError, match="give each its own"):
        check_lamps([LAMP, LAMP])


@pytest.mark.parametrize("method", ["tracked", "havran-azimuth"])
def test_the_sampler_adds_them_to_the_maps_light(method):
    radiance = np.random.default_rng(0).lognormal(0, 1, (18, 72, 3)).astype(np.float32)
    frame = SamplerInput(radiance, "hemisphere", 0.0, light_budget=20)
    _, plain, _ = step(Sampler(method=method, count=30, filter="none"), initial_state(), frame)
    _, lights, _ = step(Sampler(method=method, count=30, filter="none", lamp=(LAMP,)), initial_state(), frame)
    own = ~is_virtual(lights)
    assert np.allclose(lights.irradiance[own].sum(axis=0), map_irradiance(radiance, "hemisphere"), rtol=1e-5)
    assert lights.irradiance[~own].sum(axis=0) == pytest.approx(lights_of_lamps([LAMP]).irradiance[0])
    if method == "tracked":
        assert (len(plain.ids), len(lights.ids)) == (20, 20)  # what the renderer can draw


def test_a_control_replaces_the_settings_lamps():
    stage = SamplerStage(Settings(sampler=Sampler(lamp=(LAMP,))))
    state = stage.start_at(0)[0]
    assert state.settings.lamp == (LAMP,)
    assert stage.on_message(state, (wire.ControlMessage(lamps=()), ())).settings.lamp == ()
    assert stage.on_message(state, (wire.ControlMessage(), ())).settings.lamp == (LAMP,)


def test_a_pause_has_them_in_each_pass_as_wide_as_they_are():
    radiance = np.full((9, 36, 3), 0.5, np.float32)
    lights = with_lamps(uniform_lights(5, 0.0), [LAMP])
    with_them, without = MapLights(radiance, "hemisphere", lights), MapLights(radiance, "hemisphere")
    passes = [with_them.of_pass(k) for k in range(PASSES)]
    own = [without.of_pass(k) for k in range(PASSES)]
    added = lights_of_lamps([LAMP])
    for a, b in zip(passes, own, strict=True):
        assert len(a.ids) == len(b.ids) + 1 == len(set(a.ids.tolist()))
        assert is_virtual(a).sum() == 1  # so that gloss reflects the map as it is
        assert a.irradiance.sum(axis=0) - b.irradiance.sum(axis=0) == pytest.approx(added.irradiance[0], rel=1e-4)
    directions = np.array([each.directions[-1] for each in passes], np.float64)
    spread = np.cov(directions.T, bias=True)
    assert added.covariances is not None
    assert spread[0, 0] == pytest.approx(float(added.covariances[0, 0]), rel=0.15)  # along x, across the lamp
    assert not with_them.same_as(without)
    assert with_them.same_as(MapLights(radiance, "hemisphere", lights))
    assert with_them.cells().irradiance.sum() == pytest.approx(without.cells().irradiance.sum() + added.irradiance.sum(), rel=1e-5)


@pytest.mark.parametrize("as_points", [False, True])
def test_gloss_shows_them_as_lights_and_the_map_as_it_is(as_points):
    environment = EnvironmentMap(np.full((18, 72, 3), 0.5, np.float32), "hemisphere")
    lights = uniform_lights(40, 0.0)
    total = map_irradiance(environment.radiance, "hemisphere")
    lights = LightSet.of(lights.ids, lights.directions, np.broadcast_to(total / 40, (40, 3)), np.zeros((40, 6)))
    both = with_lamps(lights, [LAMP])
    if as_points:
        lights, both = points_of_extents(lights), points_of_extents(both)
    plain, light = reflected_light(lights, environment), reflected_light(both, environment)
    virtual = is_virtual(both)
    assert light.scale == pytest.approx(plain.scale)
    assert light.radiance is not None
    assert plain.radiance is not None
    assert np.array_equal(light.radiance, plain.radiance)
    assert light.direct[virtual].tolist() == [1.0] * int(virtual.sum())
    assert light.spread[virtual] == pytest.approx(Extents.of(lights_of_lamps([LAMP])).spreads[0] ** 2, rel=0.15)
    assert np.array_equal(np.sort(light.direct[~virtual]), np.sort(plain.direct))


def test_the_largest_control_fits_into_a_header():
    name = "\U0001f4a1" * 61
    poses = tuple(
        Pose(name=f"{name}{k:03d}", position=(0.1, 0.2, 0.3), rotation=(0.5, 0.5, 0.5, 0.5), power=1.5) for k in range(MAX_POSES)
    )
    points = tuple((k + 0.123, 10.1) for k in range(MAX_POINTS // 16))
    masks = tuple({"points": points, "width_deg": 1.5, "mode": "dark"} for _ in range(16))
    lamps = tuple(
        VirtualLamp(id=k + 2**19, azimuth_deg=0.1, elevation_deg=0.1, irradiance=(0.1, 0.1, 0.1), size_deg=1.1) for k in range(16)
    )
    control = wire.ControlMessage(poses=poses, lamps=lamps)
    control = msgspec.structs.replace(control, masks=msgspec.convert(masks, tuple[wire.Mask, ...]))
    parts = wire.pack(control)
    assert len(parts[1]) <= wire.MAX_HEADER
    assert wire.unpack(parts)[0] == control
