"""Thumbnails of a source: few, small, laid out as the page's disc, made in spare time."""

import time

import numpy as np
import pytest

from vemlight.capture.frames import Frame
from vemlight.capture.thumbnails import ThumbnailNews, Thumbnails, averaged, disc, log_average, thumbnail_frames
from vemlight.errors import UserError
from vemlight.runtime.wire import MAX_PART, MAX_THUMBNAILS, THUMBNAIL_SIDE


def frame(radiance: np.ndarray) -> Frame:
    return Frame(radiance.astype(np.float32), "hemisphere", 0.0, None, 0, 0)


@pytest.mark.parametrize("frames", [1, 2, 47, 48, 49, 5000])
def test_the_first_and_the_last_frame_are_among_them_and_there_are_few(frames):
    wanted = thumbnail_frames(frames)
    assert wanted == sorted(set(wanted))
    assert (wanted[0], wanted[-1], len(wanted)) == (0, frames - 1, min(frames, MAX_THUMBNAILS))


def test_all_of_them_are_a_hundredth_of_what_a_message_may_hold():
    assert MAX_THUMBNAILS * THUMBNAIL_SIDE**2 * 3 < MAX_PART / 100


@pytest.mark.parametrize(("row", "col", "place"), [(20, 90, (9, 24)), (20, 0, (24, 38)), (20, 180, (24, 9)), (20, 270, (38, 24))])
def test_plus_y_is_at_the_top_and_plus_x_at_the_left(row, col, place):
    """The azimuth of column `col` of 360 is `col` degrees from +X towards +Y, and the sky is seen from below."""
    radiance = np.full((30, 360, 3), 0.01)
    radiance[row, (col + np.arange(-3, 4)) % 360] = 50.0
    made = disc(frame(radiance), 0.01)
    brightest = np.unravel_index(made.sum(axis=2).argmax(), made.shape[:2])
    wanted = (place[0], THUMBNAIL_SIDE - 1 - place[1]) if place[0] == 24 else place
    assert np.abs(np.subtract(brightest, wanted)).max() <= 2
    assert not made[0, 0].any()  # outside the rim


def test_one_adaptation_shows_which_frames_are_brighter():
    dim, bright = np.full((20, 80, 3), 0.5), np.full((20, 80, 3), 4.0)
    adapted = log_average(frame(dim))
    assert adapted == pytest.approx(0.5, rel=1e-3)
    assert disc(frame(bright), adapted).mean() > 1.5 * disc(frame(dim), adapted).mean()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0])
def test_darkness_and_what_is_invalid_give_a_disc_too(value):
    made = disc(frame(np.full((20, 80, 3), value)), 0.0)
    assert made.shape == (THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3)


def test_fewer_values_have_the_same_mean():
    values = np.random.default_rng(1).random((96, 7, 3))
    assert averaged(values, 0, 48).mean() == pytest.approx(values.mean())
    assert averaged(values, 0, 96) is values
    assert averaged(values, 1, 4).shape == (96, 4, 3)


def test_those_before_a_damaged_frame_stay(monkeypatch):
    monkeypatch.setattr("vemlight.capture.thumbnails.PAUSE_S", 0.0)

    def read(k: int) -> Frame:
        if k == 8:
            raise UserError("damaged")
        return frame(np.full((4, 16, 3), 1.0 + k))

    made = Thumbnails(20, lambda: read)
    until = time.monotonic() + 20
    while len(made.made()[0]) < 2 and time.monotonic() < until:
        time.sleep(0.01)
    time.sleep(0.05)
    frames, discs = made.made()
    assert frames.tolist() == [0, 4]
    assert discs.shape == (2, THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3)


def test_they_are_sent_when_some_are_new_and_now_and_then(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("vemlight.capture.thumbnails.time.monotonic", lambda: now[0])
    news = ThumbnailNews()
    assert [news.due(0), news.due(3), news.due(3), news.due(4)] == [False, True, False, False]
    now[0] += 1.0
    assert [news.due(3), news.due(4)] == [False, True]
    now[0] += 10.0
    assert news.due(4)
