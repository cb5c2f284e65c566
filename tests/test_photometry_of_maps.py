"""Readings of maps against closed forms: illuminance, colour temperature and Duv, glare."""

import numpy as np
import pytest

from vemlight.light.bright_cells import BrightCells
from vemlight.light.colour_temperature import colour_temperature, planckian_uv
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.glare import GlareSources, glare_probability, glare_sources, grade_of, position_index
from vemlight.light.map_elements import MAX_ROWS, elements_from_map, plane_irradiance
from vemlight.light.primaries import rec709_from_xyz
from vemlight.light.sphere import cell_directions, direction_from_angles, map_irradiance

AHEAD, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def uniform(luminance: float, rows: int = 90, cols: int = 180) -> EnvironmentMap:
    return EnvironmentMap(np.full((rows, cols, 3), luminance, np.float32), "sphere")


def rgb_from_xy(x: float, y: float) -> np.ndarray:
    return rec709_from_xyz() @ np.array([x / y, 1, (1 - x - y) / y])


@pytest.mark.parametrize("normal", [AHEAD, UP, np.array([0.0, -0.6, -0.8])])
def test_a_uniform_sphere_gives_pi_on_every_plane(normal):
    assert plane_irradiance(elements_from_map(uniform(2.0)), normal) == pytest.approx(np.full(3, 2 * np.pi), rel=1e-3)


def test_a_hemisphere_gives_a_wall_half():
    upper = EnvironmentMap(np.ones((90, 360, 3), np.float32), "hemisphere")
    assert plane_irradiance(elements_from_map(upper), AHEAD) == pytest.approx(np.full(3, np.pi / 2), rel=1e-3)


def test_a_small_source_follows_the_cosine():
    radiance = np.zeros((90, 180, 3), np.float32)
    radiance[40, 50] = 7.0
    environment = EnvironmentMap(radiance, "sphere")
    towards = cell_directions(90, 180, "sphere")[40, 50]
    for normal in (AHEAD, UP, -UP, towards):
        expected = max(0.0, float(towards @ normal)) * map_irradiance(radiance, "sphere")
        assert plane_irradiance(elements_from_map(environment), normal) == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(("rows", "cols"), [(2 * MAX_ROWS, 800), (1000, 901)])
def test_fine_maps_keep_their_sums(rows, cols):
    random = np.random.default_rng(0)
    radiance = random.random((rows, cols, 3), np.float32) ** 8
    elements = elements_from_map(EnvironmentMap(radiance, "sphere"))
    assert elements.rows <= MAX_ROWS
    assert elements.solid_angles @ elements.radiance == pytest.approx(map_irradiance(radiance, "sphere"), rel=1e-4)
    assert elements.solid_angles.sum() == pytest.approx(4 * np.pi, rel=1e-4)


def test_bright_cells_are_summed_by_their_samples():
    radiance = np.ones((90, 360, 3), np.float32)
    radiance[30, 7] = 900.0
    cell = 30 * 360 + 7
    samples = direction_from_angles(np.radians([30.2, 30.5]), np.radians([7.2, 7.5])).astype(np.float32)
    bright = BrightCells(np.array([cell, cell]), samples, np.array([0.75, 0.25], np.float32))
    elements = elements_from_map(EnvironmentMap(radiance, "hemisphere", bright))
    assert np.count_nonzero(elements.cells == cell) == 2
    assert elements.solid_angles @ elements.radiance == pytest.approx(map_irradiance(radiance, "hemisphere"), rel=1e-4)
    brightest = elements.radiance[:, 0].argmax()
    assert elements.radiance[brightest, 0] == pytest.approx(900 * 0.75 * 9)  # on a ninth of the cell
    assert elements.directions[brightest] == pytest.approx(samples[0])


# CIE 15: illuminant A; the daylight locus from its polynomial in the nominal temperature, whose scale moved by 1.4388 / 1.4380.
def test_illuminant_a_and_the_daylight_locus():
    temperature, duv = colour_temperature(rgb_from_xy(0.44758, 0.40745))
    assert temperature == pytest.approx(2856, rel=2e-3)
    assert abs(duv) < 1e-4
    for nominal in (5000.0, 6500.0, 10_000.0, 20_000.0):
        t = nominal * 1.4388 / 1.4380
        low = (-4.6070e9, 2.9678e6, 0.09911e3, 0.244063)
        x = float(np.polyval(low if t <= 7000 else (-2.0064e9, 1.9018e6, 0.24748e3, 0.237040), 1 / t))
        temperature, duv = colour_temperature(rgb_from_xy(x, -3 * x**2 + 2.870 * x - 0.275))
        assert temperature == pytest.approx(t, rel=0.01)
        assert 0.001 < duv < 0.006  # daylight is greener than a black body


@pytest.mark.parametrize("kelvin", [1200.0, 2000.0, 3200.0, 5600.0, 12_000.0, 40_000.0])
@pytest.mark.parametrize("away", [-0.02, 0.0, 0.02])
def test_black_bodies_and_their_neighbours(kelvin, away):
    uv, beside = planckian_uv(kelvin), planckian_uv(kelvin * np.array([0.9999, 1.0001]))
    along = (beside[0] - beside[1]) / np.linalg.norm(beside[0] - beside[1])  # towards red, so that its left is green
    u, v = uv + away * np.array([-along[1], along[0]])
    whole = 2 * u - 8 * v + 4
    temperature, duv = colour_temperature(rgb_from_xy(float(3 * u / whole), float(2 * v / whole)))
    assert temperature == pytest.approx(kelvin, rel=0.01)
    assert duv == pytest.approx(away, abs=2e-5)


@pytest.mark.parametrize("rgb", [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.0, 0.0, 1.0)])
def test_saturated_colours_and_darkness_have_no_temperature(rgb):
    temperature, duv = colour_temperature(np.array(rgb))
    assert np.isnan(temperature)
    assert np.isnan(duv)


def test_temperatures_of_many_colours_at_once():
    colours = np.array([[[1.0, 1.0, 1.0], [1.0, 0.5, 0.2]], [[0.0, 0.0, 0.0], [0.6, 0.8, 1.0]]])
    temperature, duv = colour_temperature(colours)
    assert temperature.shape == duv.shape == (2, 2)
    assert temperature[0, 0] == pytest.approx(6504, rel=2e-3)
    assert [temperature[0, 1], temperature[1, 1]] == pytest.approx([float(colour_temperature(colours[k, 1])[0]) for k in (0, 1)])


def test_position_index():
    assert position_index(AHEAD, AHEAD, UP) == pytest.approx(1.0)
    # Guth: 30 degrees straight above is exp((35.2 - 1.22) / 1000 * 30 + 21e-5 * 900) = exp(1.0194 + 0.189)
    above = np.array([np.cos(np.pi / 6), 0, 0.5])
    assert position_index(above, AHEAD, UP) == pytest.approx(np.exp(1.2084), rel=1e-6)
    # below: beta = atan(tan 30 degrees * sqrt(1.3225)) = atan(0.57735 * 1.15) = 33.583 degrees
    below = above * np.array([1, 1, -1])
    assert position_index(below, AHEAD, UP) == pytest.approx(np.exp(6.49e-3 * 33.583 + 21e-5 * 33.583**2), rel=1e-4)
    aside = np.array([0.0, 1.0, 1e-9])
    assert position_index(aside, AHEAD, UP) == position_index(aside * np.array([1, -1, 1]), AHEAD, UP)
    assert position_index(UP * 0.9999 + AHEAD * 0.0141, AHEAD, UP) == 16.0


def test_glare_of_one_source_by_hand():
    one = GlareSources(np.array([20_000.0]), np.array([0.01]), AHEAD[None])
    by_hand = 5.87e-5 * 2000 + 9.18e-2 * np.log10(1 + 20_000.0**2 * 0.01 / 2000.0**1.87) + 0.16
    assert glare_probability(2000.0, one, AHEAD, UP) == pytest.approx(by_hand)
    nothing = GlareSources(np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    assert glare_probability(2000.0, nothing, AHEAD, UP) == pytest.approx(5.87e-5 * 2000 + 0.16)
    assert glare_probability(1e6, one, AHEAD, UP) == 1.0
    assert glare_probability(0.0, nothing, AHEAD, UP) == 0.0
    assert [grade_of(dgp) for dgp in (0.34, 0.39, 0.44, 0.46)] == ["imperceptible", "perceptible", "disturbing", "intolerable"]


def sources_of(discs: list[tuple[float, float, float, float]], rows: int = 180, cols: int = 720) -> GlareSources:
    """Discs of azimuth, elevation, radius (degrees) and luminance before 300 cd/m2, seen along AHEAD."""
    luminance = np.full((rows, cols), 300.0, np.float32)
    for azimuth, elevation, radius, level in discs:
        centre = direction_from_angles(np.radians(90 - elevation), np.radians(azimuth))
        luminance[cell_directions(rows, cols, "sphere") @ centre > np.cos(np.radians(radius))] = level
    elements = elements_from_map(EnvironmentMap(np.repeat(luminance[..., None], 3, axis=-1), "sphere"))
    return glare_sources(elements, elements.radiance[:, 1], AHEAD)


def test_a_disc_is_one_source_of_its_size_and_place():
    for azimuth in (0.0, -2.0, 30.0):  # across the map's seam, too
        found = sources_of([(azimuth, 20.0, 5.0, 30_000.0)])
        assert found.luminance == pytest.approx([30_000])
        assert found.solid_angle == pytest.approx([2 * np.pi * (1 - np.cos(np.radians(5)))], rel=0.04)  # of half-degree cells
        assert found.direction[0] == pytest.approx(direction_from_angles(np.radians(70), np.radians(azimuth)), abs=5e-3)


def test_sources_are_joined_split_and_left_out():
    near, far = (10.0, 0.0, 3.0, 5000.0), (-40.0, 0.0, 3.0, 5000.0)
    assert len(sources_of([near, (20.0, 0.0, 3.0, 5000.0)]).luminance) == 1  # 4 degrees apart: within 0.1 rad
    assert len(sources_of([near, far]).luminance) == 2
    assert len(sources_of([near, (11.0, 0.0, 1.0, 1e6)]).luminance) == 2  # a peak in a source is one of its own
    assert len(sources_of([(170.0, 0.0, 5.0, 1e5), (0.0, 30.0, 5.0, 1900.0)]).luminance) == 0  # behind; below the threshold


def test_a_disc_round_the_pole_is_one_source():
    rows, cols = 90, 360
    luminance = np.full((rows, cols, 3), 300.0, np.float32)
    luminance[:4] = 9000.0
    elements = elements_from_map(EnvironmentMap(luminance, "hemisphere"))
    assert len(glare_sources(elements, elements.radiance[:, 1], UP).luminance) == 1
