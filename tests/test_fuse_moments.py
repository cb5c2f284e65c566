"""Frames of several cameras become moments: on one clock, with lost frames, silence, and cameras that come back."""

import random

import numpy as np
import pytest

from vemlight.fuse.moments import PATIENCE_FRAMES, SILENT_S, Moments, seen_at_ns
from vemlight.runtime import stamps, wire

FPS = 30.0
PERIOD_NS = 1e9 / FPS
BEGAN_NS = 10**12


def frame(sequence: int) -> wire.Message:
    stamp = stamps.Stamp(sequence=sequence, time_s=0.0, captured_ns=0, monotonic_ns=0, boot_id="")
    return wire.MapMessage(stamp=stamp, rows=1, cols=1, coverage="hemisphere"), (np.zeros((1, 1, 3), np.float32),)


class Played:
    """Cameras that send frame n at n periods and a phase; `lost` says which frames do not come. Time goes on in steps of a millisecond.

    every: of how many periods each camera sends a frame, which may be changed in between.
    """

    def __init__(self, phases: list[float], delays_ms: list[float] | None = None) -> None:
        self.moments = Moments(len(phases), FPS)
        self.phases, self.delays_ns = phases, [1e6 * each for each in delays_ms or [1.0] * len(phases)]
        self.found = []
        self.now_ns = float(BEGAN_NS)
        self.sent = [0 for _ in phases]
        self.every = [1.0 for _ in phases]
        self._at_ns = [BEGAN_NS + phase * PERIOD_NS for phase in phases]

    def until(self, periods: float, lost=lambda camera, n: False) -> list:
        before = len(self.found)
        while self.now_ns < BEGAN_NS + periods * PERIOD_NS:
            for k, at_ns in enumerate(self._at_ns):
                if at_ns + self.delays_ns[k] <= self.now_ns:
                    if not lost(k, self.sent[k]):
                        self.moments.take(k, frame(self.sent[k]), round(at_ns), round(self.now_ns))
                    self.sent[k] += 1
                    self._at_ns[k] += self.every[k] * PERIOD_NS
            if moment := self.moments.next(round(self.now_ns)):
                self.found.append((moment, self.now_ns))
            self.now_ns += 1e6
        return self.found[before:]


def numbers(found: list) -> list[tuple[int | None, ...]]:
    return [tuple(each[0].stamp.sequence if each else None for each in moment.frames) for moment, _ in found]


@pytest.mark.parametrize("phases", [[0, 0], [0, 0.3, -0.3], [0, 0.45], [0, 0.1, 0.2, 0.3, 0.4, -0.1, -0.2, -0.4]])
def test_frames_nearest_in_time_are_one_moment_of_which_none_is_left_out(phases):
    found = Played(phases).until(40)
    assert len(found) >= 38
    assert all(set(each) == {each[0]} for each in numbers(found[1:]))
    assert [moment.stamp.sequence for moment, _ in found] == list(range(len(found)))
    for moment, now_ns in found[1:]:
        assert moment.spread_ns == pytest.approx((max(phases) - min(phases)) * PERIOD_NS, abs=2)
        assert now_ns - moment.at_ns <= max(phases) * PERIOD_NS + 3e6, "it waits for nothing but the last of its frames"


def test_a_camera_whose_frames_come_late_is_waited_for_and_a_later_one_is_not():
    assert all(set(each) == {each[0]} for each in numbers(Played([0, 0], delays_ms=[1, 50]).until(40)[2:]))
    found = Played([0, 0], delays_ms=[1, 120]).until(40)
    assert len(found) > 35
    late = [now_ns - moment.at_ns for moment, now_ns in found[5:]]
    assert max(late) < (PATIENCE_FRAMES + 0.2) * PERIOD_NS
    assert all(a is not None and b is not None and a > b for a, b in numbers(found[8:])), "its last frame is held"


def test_lost_frames_cost_no_moment():
    chance = random.Random(5)
    gone = {(1, n) for n in range(5, 300) if chance.random() < 0.2}
    played = Played([0, 0.2, 0.1])
    found = played.until(300, lambda camera, n: (camera, n) in gone)
    assert len(found) >= 295 - played.moments.skipped
    assert played.moments.skipped <= len(gone)
    assert all(None not in each for each in numbers(found[1:])), "a lost frame is no silence"


@pytest.mark.parametrize("silent", [0, 1, 2])
def test_a_silent_camera_is_left_out_and_the_others_keep_their_rate_until_it_is_back(silent):
    played = Played([0, 0.1, 0.2])
    played.until(30)
    during = played.until(90, lambda camera, n: camera == silent)
    moments = [moment.at_ns for moment, _ in during]
    assert len(during) >= 58, "the others keep all"
    assert np.diff(moments).min() > PERIOD_NS / 2
    left_out = [each[silent] is None for each in numbers(during)]
    first = left_out.index(True)
    assert all(left_out[first:]), "once silent it is left out"
    assert first / FPS == pytest.approx(SILENT_S, abs=0.15)
    back = played.until(120)
    assert len(back) >= 28
    assert all(None not in each for each in numbers(back[2:]))


@pytest.mark.parametrize("slow", [0, 1, 2])
@pytest.mark.parametrize("every", [3.0, 20.0, 50.0])
def test_a_camera_that_comes_back_slower_costs_the_others_nothing(slow, every):
    """At 10, 1.5 and 0.6 frames a second beside 30."""
    played = Played([0, 0.1, 0.2])
    played.until(30)
    played.until(60, lambda camera, n: camera == slow)
    played.every[slow] = every
    played.until(60 + 4 * every)  # its rate is known after two frames
    skipped = played.moments.skipped
    found = played.until(60 + 8 * every)
    assert played.moments.skipped == skipped
    assert len(found) >= 4 * every - 2, "the rate of the fast ones"
    waited_ns = np.array([now_ns - moment.at_ns for moment, now_ns in found])
    assert np.mean(waited_ns > 0.3 * PERIOD_NS) < 2 / every, "only the slow one's own frame is waited for"
    assert all(None not in each for each in numbers(found)), "between its frames it is not silent"
    ages = [moment.spread_ns / PERIOD_NS for moment, _ in found]
    assert max(ages) <= every + 1, "its last frame is held"


def test_a_camera_that_comes_back_faster_sets_the_beat():
    played = Played([0, 0.1])
    played.every = [2.0, 2.0]
    played.until(40)
    played.until(80, lambda camera, n: camera == 1)
    played.every[1] = 1.0
    played.until(90)
    assert len(played.until(150)) >= 58


def test_a_pause_is_no_period():
    """A camera that was away for long and sends one frame is silent as soon as any other."""
    played = Played([0, 0])
    played.until(30)
    played.until(400, lambda camera, n: camera == 1)
    for alive in ({440}, {520, 521}):
        last = max(alive)
        played.until(last, lambda camera, n, alive=alive: camera == 1 and n not in alive)
        silent_from = last + SILENT_S * FPS + 2
        played.until(silent_from, lambda camera, n, alive=alive: camera == 1 and n not in alive)
        assert played.moments.silent(round(played.now_ns)) == (False, True)


def test_all_silent_is_no_moment_and_wakes_nobody():
    played = Played([0, 0])
    assert played.moments.next(BEGAN_NS) is None
    assert played.moments.wait_ns(BEGAN_NS) == float("inf")
    played.until(10)
    assert played.until(90, lambda camera, n: True) == []
    assert all(played.moments.silent(round(played.now_ns)))


def test_a_restarted_camera_whose_clock_begins_anew_is_taken_at_once():
    moments = Moments(2, FPS)
    moments.take(0, frame(0), 10**10, 10**10)
    moments.take(1, frame(0), 10**10, 10**10)
    assert moments.next(10**10)
    moments.take(1, frame(7), 10**9, 10**10 + 10**7)  # far in the past: held as it is, and what it had before is forgotten
    moments.take(0, frame(1), 10**10 + 3 * 10**7, 10**10 + 3 * 10**7)
    moment = moments.next(10**10 + 10**8)
    assert moment
    assert moment.frames[1]
    header = moment.frames[1][0]
    assert isinstance(header, wire.MapMessage)
    assert header.stamp.sequence == 7


def test_a_stamp_of_the_future_holds_up_nothing():
    played = Played([0, 0])
    played.until(10)
    played.moments.take(1, frame(99), 10**18, round(played.now_ns))
    assert len(played.until(40)) >= 28


def test_stamps_of_another_host_count_by_their_realtime():
    here = stamps.Stamp(sequence=0, time_s=0.0, captured_ns=5_000, monotonic_ns=70, boot_id="a")
    assert seen_at_ns(here, "a", 100, 5_040) == 70
    assert seen_at_ns(here, "b", 100, 5_040) == 60
