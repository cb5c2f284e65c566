"""The axes that everything else rests on, and ways there and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vemlight.light.sphere import (
    Coverage,
    angle_between,
    angles_from_direction,
    cell_directions,
    cell_from_direction,
    cell_solid_angles,
    direction_from_angles,
    latlong_directions,
    latlong_from_direction,
    latlong_solid_angles,
    map_irradiance,
    quaternion_xyz,
    rotation_xyz,
)

X, Y, Z = np.eye(3)
ANGLES = st.floats(-720, 720)


def test_axes():
    np.testing.assert_allclose(direction_from_angles(0.0, 1.0), Z, atol=1e-15)
    np.testing.assert_allclose(direction_from_angles(np.pi / 2, 0.0), X, atol=1e-15)
    np.testing.assert_allclose(direction_from_angles(np.pi / 2, np.pi / 2), Y, atol=1e-15)


def test_a_latlong_has_z_on_top_x_in_the_middle_and_y_a_quarter_from_the_left():
    places = latlong_directions(181, 360)
    pixel = np.pi / 180
    for (row, col), axis in {(0, 7): Z, (180, 7): -Z, (90, 180): X, (90, 90): Y, (90, 270): -Y, (90, 0): -X}.items():
        assert angle_between(places[row, col], axis) < pixel


def test_a_polar_map_goes_from_the_zenith_down_and_from_x_to_y():
    places = cell_directions(90, 360, "hemisphere")
    cell = np.pi / 180
    assert angle_between(places[0, 0], Z) < cell
    assert angle_between(places[89, 0], X) < cell
    assert angle_between(places[89, 90], Y) < cell
    assert angle_between(cell_directions(180, 360, "sphere")[179, 0], -Z) < cell


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
def test_each_cell_is_found_again(coverage: Coverage):
    row, col = cell_from_direction(cell_directions(7, 11, coverage), 7, 11, coverage)
    np.testing.assert_allclose(row, np.broadcast_to(np.arange(7)[:, None] + 0.5, (7, 11)))
    np.testing.assert_allclose(col, np.broadcast_to(np.arange(11) + 0.5, (7, 11)))


def test_each_pixel_is_found_again():
    row, col = latlong_from_direction(latlong_directions(7, 11), 7, 11)
    np.testing.assert_allclose(row, np.broadcast_to(np.arange(7)[:, None] + 0.5, (7, 11)))
    np.testing.assert_allclose(col, np.broadcast_to(np.arange(11) + 0.5, (7, 11)))


@given(st.floats(1e-6, np.pi - 1e-6), st.floats(0, 2 * np.pi, exclude_max=True), st.floats(1e-3, 1e3))
def test_angles_come_back(theta, phi, length):
    found = angles_from_direction(length * direction_from_angles(theta, phi))
    assert found[0] == pytest.approx(theta, abs=1e-9)
    assert abs((found[1] - phi + np.pi) % (2 * np.pi) - np.pi) * np.sin(theta) < 1e-9
    assert 0 <= found[1] < 2 * np.pi


def test_an_azimuth_just_below_0_is_not_a_whole_turn():
    assert angles_from_direction(np.array([1.0, -1e-17, 0.0]))[1] == 0
    assert latlong_from_direction(np.array([-1.0, 1e-17, 0.0]), 4, 8)[1] in (0.0, pytest.approx(0, abs=1e-9))


def test_small_angles_keep_their_digits():
    for angle in (1e-9, 1e-4, 1.0, np.pi - 1e-4):
        other = np.cos(angle) * X + np.sin(angle) * Y
        assert angle_between(X, other) == pytest.approx(angle, rel=1e-7)


@pytest.mark.parametrize(("coverage", "whole"), [("hemisphere", 2 * np.pi), ("sphere", 4 * np.pi)])
def test_solid_angles_fill_the_sky(coverage: Coverage, whole):
    assert cell_solid_angles(90, 360, coverage).sum() * 360 == pytest.approx(whole, rel=1e-12)
    assert latlong_solid_angles(64, 128).sum() * 128 == pytest.approx(4 * np.pi, rel=1e-12)
    np.testing.assert_allclose(map_irradiance(np.full((9, 36, 3), 2.0, np.float32), coverage), 2 * whole, rtol=1e-6)


def test_turns_are_about_x_then_y_then_z():
    np.testing.assert_allclose(rotation_xyz((90, 0, 0)) @ Y, Z, atol=1e-15)
    np.testing.assert_allclose(rotation_xyz((0, 90, 0)) @ Z, X, atol=1e-15)
    np.testing.assert_allclose(rotation_xyz((0, 0, 90)) @ X, Y, atol=1e-15)
    np.testing.assert_allclose(rotation_xyz((90, 0, 90)) @ Y, Z, atol=1e-15)  # first to Z, which a turn about z leaves


@given(st.tuples(ANGLES, ANGLES, ANGLES))
def test_the_quaternion_is_the_same_turn(degrees):
    np.testing.assert_allclose(Rotation.from_quat(quaternion_xyz(degrees)).as_matrix(), rotation_xyz(degrees), atol=1e-9)
