"""What a source of files plays: a pure state under controls, whose stamps never jump and whose frames do only where it says so."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vemlight.runtime.playback import Playback
from vemlight.runtime.wire import ControlMessage

FPS = 25.0


def played(playback: Playback, count: int) -> tuple[list[tuple[int, float, int]], Playback]:
    """(frame, stamp, segment) of the next `count` frames that are published."""
    rows = []
    for _ in range(count):
        rows.append((playback.index, playback.time_s, playback.segment))
        playback = playback.after(1)
    return rows, playback


def frames_of(playback: Playback, count: int) -> list[int]:
    return [index for index, _, _ in played(playback, count)[0]]


def test_without_wishes_the_whole_is_played_again_and_again_in_one_segment():
    rows, _ = played(Playback.start(4, FPS), 10)
    assert [index for index, _, _ in rows] == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]
    assert [time_s for _, time_s, _ in rows] == [n / FPS for n in range(10)]  # to the bit
    assert {segment for _, _, segment in rows} == {0}


@given(frames=st.integers(1, 200), wanted=st.integers(0, 400), before=st.integers(0, 300), paused=st.booleans())
def test_a_seek_goes_to_its_frame_once_and_is_said(frames, wanted, before, paused):
    playback = Playback.start(frames, FPS).after(before)
    control = ControlMessage(seek_number=1, seek_s=wanted / FPS, paused=paused)
    after = playback.obeying(control)
    assert after.index == min(wanted, frames - 1)
    assert after.segment == playback.segment + (after.index != playback.index)
    assert after.time_s == playback.time_s
    assert after.after(1).obeying(control) == after.after(1)  # the same message comes twice a second


@given(speeds=st.lists(st.tuples(st.sampled_from([0.25, 0.5, 1.0, 1.5, 2.0, 4.0]), st.booleans(), st.integers(1, 9)), max_size=8))
def test_stamps_go_on_by_the_interval_at_which_frames_are_due(speeds):
    playback, last_s = Playback.start(50, FPS), -1 / FPS
    for speed, paused, count in speeds:
        playback = playback.obeying(ControlMessage(speed=speed, paused=paused))
        rows, playback = played(playback, count)
        rate = FPS if paused else FPS * min(speed, 1.0)
        for k, (_, time_s, _) in enumerate(rows):
            passed = time_s - last_s
            assert passed == pytest.approx(1 / rate) or (k == 0 and passed > 0)
            last_s = time_s


@pytest.mark.parametrize(("speed", "frames"), [(0.25, [0, 1, 2, 3]), (1.5, [0, 1, 3, 4, 6]), (2.0, [0, 2, 4]), (4.0, [0, 4, 8])])
def test_slow_motion_shows_every_frame_for_longer_and_a_higher_speed_passes_over_some(speed, frames):
    playback = Playback.start(100, FPS).obeying(ControlMessage(speed=speed))
    assert frames_of(playback, len(frames)) == frames
    assert playback.rate_hz == FPS * min(speed, 1.0)


def test_what_comes_late_is_passed_over_and_keeps_its_time():
    playback = Playback.start(100, FPS).obeying(ControlMessage(speed=2.0))
    assert playback.after(3) == playback.after(1).after(1).after(1)


@given(first=st.integers(0, 19), span=st.integers(0, 19), speed=st.sampled_from([0.5, 1.0, 2.0, 4.0]), loop=st.booleans())
def test_only_the_range_is_played_and_each_jump_is_said(first, span, speed, loop):
    last = min(first + span, 19)
    control = ControlMessage(in_s=first / FPS, out_s=last / FPS, speed=speed, loop=loop)
    rows, playback = played(Playback.start(20, FPS).obeying(control).after(1), 40)
    assert all(first <= index <= last for index, _, _ in rows)
    for (before, _, segment), (after, _, next_segment) in pairwise(rows):
        wraps = loop and before + max(1, speed) > last
        assert next_segment - segment == (wraps and first < last and not playback.is_whole)
        assert wraps or after == min(last, before + max(1, speed))
    if not loop:
        assert rows[-1][0] == last
        assert playback.at_end


def test_an_ended_range_stands_and_plays_on_from_a_seek():
    playback = Playback.start(4, FPS).obeying(ControlMessage(loop=False))
    assert frames_of(playback, 6) == [0, 1, 2, 3, 3, 3]
    assert frames_of(playback.after(6).obeying(ControlMessage(loop=False, seek_number=5, seek_s=1 / FPS)), 3) == [1, 2, 3]


def test_a_pause_shows_the_same_frame_and_a_step_the_next():
    paused = ControlMessage(paused=True)
    playback = Playback.start(10, FPS).after(3).obeying(paused)
    rows, playback = played(playback, 5)
    assert {index for index, _, _ in rows} == {3}
    stepped = playback.obeying(ControlMessage(paused=True, seek_number=9, seek_s=4 / FPS))
    assert frames_of(stepped, 2) == [4, 4]


def test_in_after_out_is_refused():
    with pytest.raises(ValueError, match="in_s is after out_s"):
        ControlMessage(in_s=2.0, out_s=1.0)
