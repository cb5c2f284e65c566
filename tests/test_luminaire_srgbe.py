import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vemlight.renderer.luminaire.srgbe import printed_rgb_from_srgbe, printed_srgbe_from_rgb, rgb_from_srgbe, srgbe_from_rgb


def error(rgb, decoded):
    return np.abs(decoded - rgb).max(axis=-1) / np.abs(rgb).max(axis=-1)


@given(arrays(np.float32, (5, 3), elements=st.floats(-(2.0**125), 2.0**125, width=32)))
def test_decoding_brings_back_7_bits_and_the_sign(rgb):
    decoded = rgb_from_srgbe(srgbe_from_rgb(rgb))
    seen = np.abs(rgb).max(axis=-1) >= 2.0**-126
    # half a step of 1/254 of 2^e, and the largest component is at least 2^e / 4: 1 / 127 = 0.79 %
    assert np.all(error(rgb[seen], decoded[seen]) <= 1 / 127 + 1e-6)
    assert np.all(decoded[~seen] == 0)
    assert np.array_equal(rgb_from_srgbe(srgbe_from_rgb(-rgb)), -decoded)


def test_zero_nan_and_inf_have_a_defined_answer():
    odd = np.array([[0, 0, 0], [np.nan, 1, 0], [np.inf, -np.inf, 0], [2.0**-127, 0, 0]])
    decoded = rgb_from_srgbe(srgbe_from_rgb(odd))
    assert not decoded[0].any()
    assert not decoded[3].any()
    assert decoded[1].tolist() == [0, 1, 0] or abs(decoded[1, 1] - 1) < 0.008
    assert decoded[2, 0] == -decoded[2, 1]
    assert 3e37 < decoded[2, 0] < 1e38
    assert np.all(np.isfinite(decoded))


def test_the_printed_code_fails_where_the_safe_one_does_not():
    with np.errstate(divide="ignore", invalid="ignore"):
        e = np.floor(np.log2(np.float32(0))) + 2
        assert np.isnan(np.float32(0) * np.exp2(-e))  # black, before the frame buffer rounds it
    one = printed_rgb_from_srgbe(printed_srgbe_from_rgb(np.array([1.0, 0.0, 0.0])))
    assert one == pytest.approx(np.array([0.996, 0.0078, 0.0078]), abs=1e-4)  # zeros come back as light
    assert np.isinf(printed_rgb_from_srgbe(printed_srgbe_from_rgb(np.full(3, 2.0**126 * 1.9)))).any()
    rgb = np.random.default_rng(1).lognormal(0, 2, (20_000, 3))
    printed = error(rgb, printed_rgb_from_srgbe(printed_srgbe_from_rgb(rgb)))
    assert printed.max() == pytest.approx(0.0078, abs=2e-4)


def test_accumulating_in_the_format_loses_light():
    """63 passes of positive light, encoded after each: the loss of 2003's frame buffer, and none in float."""
    rng = np.random.default_rng(2)
    passes = rng.lognormal(0, 1, (99, 4000, 3)).astype(np.float32)
    truth = passes.cumsum(axis=0)
    bias = {}
    code = srgbe_from_rgb(np.zeros((4000, 3)))
    for k in range(99):
        code = srgbe_from_rgb(rgb_from_srgbe(code) + passes[k])
        bias[k + 1] = float((rgb_from_srgbe(code) / truth[k]).mean() - 1)
    assert abs(bias[25]) < 0.01
    assert -0.06 < bias[99] < -0.005
    once = rgb_from_srgbe(srgbe_from_rgb(truth[-1]))
    assert abs(float((once / truth[-1]).mean() - 1)) < 1e-3
