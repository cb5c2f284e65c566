import numpy as np
import pytest

from vemlight.light.colour import LUMINANCE_WEIGHTS, SRGB_LINEAR_END, linear_from_srgb, luminance_from_rgb, srgb_from_linear


def test_luminance_is_that_of_rec_709():
    assert luminance_from_rgb(np.ones(3)) == pytest.approx(1)
    np.testing.assert_allclose(luminance_from_rgb(np.eye(3)), [0.2126, 0.7152, 0.0722])
    assert luminance_from_rgb(np.eye(3, dtype=np.float32)).dtype == np.float32
    assert luminance_from_rgb(np.ones((2, 5, 3), np.uint8)).shape == (2, 5)
    assert LUMINANCE_WEIGHTS.sum() == pytest.approx(1)


def test_the_srgb_curve_has_the_values_of_its_standard():
    # 8-bit codes of IEC 61966-2-1: half of the light is code 188, middle grey 0.18 code 118, and 10 / 255 lies on the line of slope 12.92
    np.testing.assert_allclose(srgb_from_linear(np.array([0.0, 0.5, 0.18, 1.0])) * 255, [0, 187.52, 117.65, 255], atol=0.01)
    assert linear_from_srgb(np.array([10 / 255])) * 12.92 == pytest.approx(10 / 255)


def test_the_srgb_curve_is_continuous_and_rises():
    below, above = srgb_from_linear(np.array([SRGB_LINEAR_END, np.nextafter(SRGB_LINEAR_END, 1)]))
    assert above - below == pytest.approx(0, abs=1e-7)  # the standard's rounded numbers leave 3e-8
    assert np.all(np.diff(srgb_from_linear(np.linspace(-0.1, 2, 5000))) > 0)


@pytest.mark.parametrize("shape", [(), (6,), (2, 3), (2, 3, 1)])
def test_the_srgb_curves_are_inverse_in_any_shape(shape):
    linear = np.random.default_rng(1).uniform(0, 1, shape)
    coded = srgb_from_linear(linear)
    assert coded.shape == shape
    np.testing.assert_allclose(linear_from_srgb(coded), linear, atol=3e-8)
    assert srgb_from_linear(np.asarray(linear, np.float32)).dtype == np.float32
