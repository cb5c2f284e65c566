"""Matrices between primaries: published values, whites, and what is no set of primaries."""

import numpy as np
import pytest

from vemlight.light.primaries import REC709, XYZ, adapted_white, rec709_from_primaries, rec709_from_xyz, xyz_from_primaries

REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACES_AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


def test_rec709_luminance_is_the_published_row():
    np.testing.assert_allclose(xyz_from_primaries(REC709)[1], [0.2126, 0.7152, 0.0722], atol=5e-5)  # ITU-R BT.709-6


def test_rec2020_luminance_is_the_published_row():
    np.testing.assert_allclose(xyz_from_primaries(REC2020)[1], [0.2627, 0.6780, 0.0593], atol=5e-5)  # ITU-R BT.2020-2


def test_rec2020_to_rec709_is_the_published_matrix():
    published = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]  # ITU-R BT.2087-0, inverted
    np.testing.assert_allclose(rec709_from_primaries(REC2020), published, atol=2e-4)


@pytest.mark.parametrize("primaries", [REC709, REC2020, ACES_AP0])
def test_white_stays_white(primaries):
    np.testing.assert_allclose(rec709_from_primaries(primaries) @ np.ones(3), np.ones(3), atol=1e-9)


def test_adapting_to_another_white_and_back_changes_nothing():
    there, back = adapted_white((0.3127, 0.329), (0.3457, 0.3585)), adapted_white((0.3457, 0.3585), (0.3127, 0.329))
    np.testing.assert_allclose(there @ back, np.eye(3), atol=1e-12)


def test_channels_that_are_xyz_are_not_adapted():
    np.testing.assert_array_equal(rec709_from_primaries((*XYZ, 1 / 3, 1 / 3)), rec709_from_xyz())
    np.testing.assert_allclose(rec709_from_xyz() @ xyz_from_primaries(REC709), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("primaries", [(0.0,) * 8, (np.nan,) * 8, (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.329), (*REC709[:6], 0.3, 0.0)])
def test_what_is_no_set_of_primaries_is_refused(primaries):
    with pytest.raises(ValueError, match="no primaries"):
        xyz_from_primaries(primaries)
