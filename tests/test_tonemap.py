import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.renderer.frame import ToneRequest
from vemlight.renderer.output.tonemap import (
    MAX_STEP_S,
    MIDDLE_GREY,
    TIME_CONSTANT_S,
    Adaptation,
    adapt,
    subsampled,
    tone_curve,
    tone_mapped,
)
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

BLACK = np.concatenate([np.zeros((4, 4, 3), np.float32), np.ones((4, 4, 1), np.float32)], axis=-1)


def gray(values: np.ndarray) -> np.ndarray:
    """A picture (1, n, 4) of gray surfaces."""
    row = np.repeat(np.asarray(values, np.float32)[:, None], 4, axis=1)
    row[:, 3] = 1
    return row[None]


def test_the_log_average_is_the_geometric_mean():
    state = adapt(None, gray(np.array([0.1, 1.0, 10.0])), 0.04)
    assert state.log_average == pytest.approx(np.log(1.0), abs=1e-6)
    assert state.seen


@given(st.floats(1e-6, 1e6))
def test_a_pictures_scale_does_not_matter(scale: float):
    picture = gray(np.array([0.02, 0.1, 0.5, 1.0, 3.0, 20.0]))
    a = tone_mapped(picture, adapt(None, picture, 0.04), 0.0).astype(int)
    scaled = picture * np.array([scale, scale, scale, 1], np.float32)
    b = tone_mapped(scaled, adapt(None, scaled, 0.04), 0.0).astype(int)
    assert np.abs(a - b).max() <= 1


def test_a_flat_picture_becomes_middle_gray():
    picture = gray(np.full(9, 7.0))
    state = adapt(None, picture, 0.04)
    assert state.key == MIDDLE_GREY
    # white = 1 makes the operator the identity, so 0.18 in sRGB: 1.055 * 0.18^(1 / 2.4) - 0.055 = 0.4613
    assert tone_mapped(picture, state, 0.0)[0, 0].tolist() == [118, 118, 118, 255]


def test_the_highest_luminance_becomes_white_and_order_is_kept():
    values = np.geomspace(0.01, 100, 400)
    picture = gray(values)
    state = adapt(None, picture, 0.04)
    curve = tone_curve(state, 0.0)
    assert curve.white is not None
    level = np.exp(state.log_high) * curve.scale
    assert level * (1 + level / curve.white**2) / (1 + level) == pytest.approx(1.0)
    assert np.all(np.diff(tone_mapped(picture, state, 0.0)[0, :, 0].astype(int)) >= 0)


def test_smoothing_runs_in_logarithms_alike_up_and_down():
    low, high = gray(np.full(9, 0.01)), gray(np.full(9, 10.0))
    up = adapt(adapt(None, low, 0.04), high, 0.1).log_average - np.log(0.01)
    down = np.log(10.0) - adapt(adapt(None, high, 0.04), low, 0.1).log_average
    assert up == pytest.approx(down, rel=1e-6)
    assert up == pytest.approx(np.log(1000) * (1 - np.exp(-0.1 / TIME_CONSTANT_S)), rel=1e-6)


def test_two_short_steps_are_one_long_step():
    low, high = gray(np.full(9, 0.01)), gray(np.full(9, 10.0))
    start = adapt(None, low, 0.04)
    assert adapt(adapt(start, high, 0.05), high, 0.05).log_average == pytest.approx(adapt(start, high, 0.1).log_average, rel=1e-9)
    assert adapt(start, high, 100.0) == adapt(start, high, MAX_STEP_S)
    assert adapt(start, high, -1.0) == start


def test_of_lamps_that_flicker_ten_times_a_second_a_twenty_fifth_is_left():
    times_s = np.arange(0, 4, 0.02)
    states = [adapt(None, gray(np.ones(4)), 0.02)]
    for time_s in times_s:
        states.append(adapt(states[-1], gray(np.full(4, np.exp(np.sin(20 * np.pi * time_s)))), 0.02))
    left = max(state.log_average for state in states[-50:])  # of an amplitude of 1; a low-pass leaves 1 / (2 pi 10 Hz 0.4 s) = 0.04
    assert 0.03 < left < 0.055


def test_the_first_picture_after_a_gap_is_about_half_way_to_the_new_light():
    low, high = adapt(None, gray(np.full(9, 1.0)), 0.04), gray(np.full(9, np.e))
    assert 0.4 < adapt(low, high, 10.0).log_average < 0.55


def test_the_key_goes_from_low_for_a_dark_picture_with_lights_to_high_for_a_bright_one_with_shadows():
    # Reinhard 2003: 0.18 times 4 to the power of -1 to 1
    for log_average, key in ((0.0, 0.045), (0.5, 0.18), (1.0, 0.72)):
        assert Adaptation(log_average, log_low=0.0, log_high=1.0).key == pytest.approx(key)


@pytest.mark.parametrize(("outliers", "counts"), [(7, False), (15, True)])  # of 1000 pixels, beside a quantile of 1 %
def test_a_few_pixels_do_not_set_the_lowest_and_the_highest_luminance(outliers, counts):
    values = np.ones(1000)
    values[:outliers], values[-outliers:] = 0.01, 100.0
    state = adapt(None, gray(values), 0.04)
    assert (state.log_low < -1, state.log_high > 1) == (counts, counts)


@pytest.mark.parametrize(("darkest", "counts"), [(0.7e-4, False), (1.4e-4, True)])
def test_what_is_ten_thousand_times_darker_than_the_median_is_black(darkest, counts):
    values = np.ones(100)
    values[:20] = darkest
    assert (adapt(None, gray(values), 0.04).log_average < -1) == counts


def test_statistics_come_from_up_to_256_x_256_pixels():
    for size, expected in (((256, 256), (256, 256)), ((257, 256), (128, 128)), ((1080, 1920), (180, 320))):
        assert subsampled(np.broadcast_to(np.float32(0), (*size, 4))).shape[:2] == expected


def test_black_frames_change_nothing_and_light_after_them_counts_at_once():
    lit = gray(np.array([0.5, 1.0, 2.0]))
    assert adapt(None, BLACK, 0.04) == Adaptation()
    assert adapt(adapt(None, BLACK, 0.04), lit, 0.04) == adapt(None, lit, 0.04)
    state = adapt(None, lit, 0.04)
    assert adapt(state, BLACK, 0.04) == state
    assert not tone_mapped(BLACK, Adaptation(), 0.0)[..., :3].any()


def test_hostile_pixels_stay_in_their_place():
    picture = gray(np.array([np.nan, np.inf, -1.0, 1.0, 2.0]))
    state = adapt(None, picture, 0.04)
    assert state == adapt(None, picture[:, 3:], 0.04)
    assert tone_mapped(picture, state, 0.0)[0, :3, 0].tolist() == [0, 255, 0]


def test_alpha_is_kept_and_colour_is_not_multiplied_by_it():
    solid = np.array([[[0.3, 0.2, 0.1, 1.0]]], np.float32)
    state = adapt(None, solid, 0.04)
    half = tone_mapped(solid * np.float32(0.5), state, 0.0)[0, 0]
    assert half.tolist() == [*tone_mapped(solid, state, 0.0)[0, 0, :3].tolist(), 128]
    assert tone_mapped(np.zeros((1, 1, 4), np.float32), state, 0.0)[0, 0].tolist() == [0, 0, 0, 0]


def test_a_stop_doubles_the_light():
    picture = gray(np.array([0.5, 1.0, 2.0]))
    state = adapt(None, picture, 0.04)
    doubled = picture * np.array([2, 2, 2, 1], np.float32)
    assert np.array_equal(tone_mapped(picture, state, 1.0), tone_mapped(doubled, state, 0.0))


def test_the_state_survives_its_file_form():
    state = adapt(None, gray(np.array([0.5, 1.0, 2.0])), 0.04)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=Adaptation) == state


def test_the_exponential_curve_is_that_of_its_paper():
    values = np.array([0.0, 0.5, 1.0, 2.5])  # of mean 1
    picture = gray(values)
    state = adapt(None, picture, 0.04)
    assert state.log_mean == pytest.approx(0, abs=1e-7)
    linear = 1 - np.exp(-values)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(tone_mapped(picture, state, 0.0, "exponential")[0, :, 0] - 255 * coded).max() <= 0.5 + 1e-4
    assert not tone_mapped(BLACK, Adaptation(), 0.0, "exponential")[..., :3].any()


@given(st.floats(1e-6, 1e6))
def test_a_pictures_scale_does_not_matter_to_the_exponential_curve_either(scale: float):
    picture = gray(np.array([0.02, 0.1, 0.5, 1.0, 3.0, 20.0]))
    scaled = picture * np.array([scale, scale, scale, 1], np.float32)
    a, b = (tone_mapped(image, adapt(None, image, 0.04), 0.0, "exponential").astype(int) for image in (picture, scaled))
    assert np.abs(a - b).max() <= 1
    assert np.all(np.diff(a[0, :, 0]) >= 0)


@pytest.mark.parametrize("tone", ["reinhard", "exponential"])
def test_the_shader_draws_the_same_curve(tone):
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=48, height=36, shadow_map=32, tone=tone))
    for power in (0.0, 1e-20, 1.0, 1e9):
        lights = LightSet.of(np.zeros(1), np.array([[0.6, 0.0, 0.8]]), np.array([[power, power / 2, power / 3]]))
        picture = renderer.picture(lights).copy()
        state = adapt(None, picture, 0.04)
        for stops in (-4.0, 0.0, 6.0):
            off = np.abs(renderer.tone_mapped(picture, state, stops).astype(int) - tone_mapped(picture, state, stops, tone))
            assert off.max() <= 1  # float32 and float64 on either side of a step
            assert np.mean(off > 0) < 0.01
    renderer.release()


def test_the_shader_has_the_same_answer_to_hostile_pixels():
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=6, height=1, shadow_map=32))
    picture = gray(np.array([np.nan, np.inf, -np.inf, -1.0, 1e-30, 1e30])).astype(np.float32)
    state = adapt(None, gray(np.array([0.5, 1.0, 2.0])), 0.04)
    assert np.array_equal(renderer.tone_mapped(picture, state, 0.0), tone_mapped(picture, state, 0.0))
    renderer.release()


@pytest.mark.parametrize(("width", "height"), [(48, 36), (320, 240), (521, 257)])  # every pixel; every second, of even and odd sizes
def test_the_eye_adapts_to_the_pixels_that_are_subsampled(width, height):
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=width, height=height, shadow_map=32))
    lights = LightSet.of(np.zeros(1), np.array([[0.6, 0.0, 0.8]]), np.ones((1, 3)))
    drawn = renderer.frame(lights, tone=ToneRequest(None, 0.0, 0.04))
    picture = drawn.picture
    assert picture is not None
    assert drawn.adaptation == adapt(None, subsampled(picture), 0.04)
    assert subsampled(picture).shape[0] < height or height == 36
    renderer.release()
