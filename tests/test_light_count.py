import numpy as np
import pytest

from vemlight.sampler.light_count import budget_after, count_after, fade_weights_after


def fed(counts, slack=1.0, fps=25.0, now=None, start_s=0.0):
    """The number in use after each of the requirements, and the last state."""
    used = []
    for k, count in enumerate(counts):
        now = count_after(now, int(count), start_s + k / fps, slack)
        used.append(now.count)
    return np.array(used), now


def test_the_number_rises_at_once_and_falls_late_to_the_largest_seen_meanwhile():
    used, _ = fed([40, 60, *[30, 47, 35] * 20])
    late = 2 + 25  # a second
    assert used[:2].tolist() == [40, 60]
    assert (used[2:late] == 60).all()
    assert (used[late:] == 47).all()


def test_a_requirement_a_little_smaller_changes_nothing():
    used, _ = fed([60, *[49] * 200, *[59] * 200])
    assert (used == 60).all()


@pytest.mark.parametrize("seed", range(4))
def test_noise_in_the_requirement_does_not_come_through(seed):
    # Noise of 7 %, the error's own uncertainty with 96 probes: the number in use settles on the largest requirement of some seconds.
    required = np.rint(100 * (1 + 0.07 * np.random.default_rng(seed).standard_normal(300)))
    used, _ = fed(required, slack=1.1)
    assert len(set(used[100:])) <= 2
    assert 100 <= used[-1] <= 130


def test_a_number_that_proved_too_small_is_not_tried_again_soon():
    # It looks as if 15 would do when there are 30, and 30 when there are 15: an estimate from lights that have not settled.
    now, used = count_after(None, 30, 0.0), []
    for k in range(1, 58 * 25):
        now = count_after(now, 15 if now.count == 30 else 30, k / 25)
        used.append(now.count)
    assert np.count_nonzero(np.diff(used)) == 2  # down and back up, once
    assert used[-1] == 30
    # A requirement well below even what proved too small is trusted.
    used, _ = fed([10] * 40, now=now, start_s=k / 25)
    assert used[-1] == 10


def test_what_proved_too_small_stops_no_fall_from_far_above():
    """30 fell to 15, which was too few; a minute of many lights later 30 do again, and nobody waits for the back-off."""
    used, _ = fed([30, *[15] * 28, *[30] * 28, *[90] * 5, *[16] * 40])
    assert used[28] == 15
    assert used[29] == 30
    assert used[61] == 90
    assert used[-1] == 30


def test_a_gap_and_time_that_goes_back_begin_anew():
    now = fed([60] * 10)[1]
    assert now
    assert count_after(now, 20, now.updated_s + 1.04).count == 20
    assert count_after(now, 20, now.updated_s - 0.2).count == 20


def test_the_budget_is_never_exceeded_and_its_noise_settles():
    # A picture's time fluctuates by 10 %; the renderer smooths its costs with a weight of 0.2, which leaves 10 % sqrt(0.2 / 1.8) = 3 %.
    generator, used = np.random.default_rng(2), [0]
    budgets = np.rint(60 * (1 + 0.03 * generator.standard_normal(500))).astype(int)
    for number in budgets.tolist():
        used.append(budget_after(used[-1], number))
        assert 0 < used[-1] <= number
    assert len(set(used[50:])) <= 4
    assert used[-1] >= 48
    assert budget_after(used[-1], 200) == 200
    assert budget_after(used[-1], 0) == 0  # no target


def test_lights_come_and_go_in_steps_of_time():
    weights = fade_weights_after(np.zeros(0), 3, None)
    assert weights.tolist() == [1, 1, 1]
    weights = fade_weights_after(weights, 5, 0.05)  # of the 0.2 s that it takes
    np.testing.assert_allclose(weights, [1, 1, 1, 0.25, 0.25])
    weights = fade_weights_after(weights, 2, 0.1)
    np.testing.assert_allclose(weights, [1, 1, 0.5])
    assert fade_weights_after(weights, 2, 0.2).tolist() == [1, 1]
    assert fade_weights_after(weights, 2, 100.0).tolist() == [1, 1]


@pytest.mark.parametrize(("required", "falls"), [(50, True), (79, True), (81, False), (95, False)])
def test_the_number_falls_to_less_than_four_fifths_alone(required, falls):
    used, _ = fed([100, *[required] * 40])
    assert used[-1] == (required if falls else 100)


@pytest.mark.parametrize(("waited_s", "retried"), [(40.0, False), (57.0, False), (63.0, True), (80.0, True)])
def test_a_number_that_proved_too_small_is_tried_again_after_a_minute(waited_s, retried):
    used, state = fed([100, *[60] * 27, *[100] * 5])
    assert used[-6] == 60  # fell, and came back within a second
    assert used[-1] == 100
    # The gaps between frames stay below a second; the backoff counts from the fall.
    frames = int(waited_s / 0.8)
    for k in range(frames):
        state = count_after(state, 100, 1.3 + 0.8 * k)
    for k in range(40):
        state = count_after(state, 60, 1.3 + 0.8 * frames + k / 25)
    assert state
    assert state.count == (60 if retried else 100)


@pytest.mark.parametrize(("budget", "used"), [(110, 100), (124, 100), (126, 126), (99, 99)])
def test_a_larger_budget_is_taken_up_from_a_quarter_more(budget, used):
    assert budget_after(100, budget) == used
