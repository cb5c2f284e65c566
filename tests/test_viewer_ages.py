"""Ages of pictures as percentiles: of the last seconds, by rank."""

import pytest

from vemlight.viewer import ages
from vemlight.viewer.ages import MAX_PICTURES, WINDOW_S, Ages


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [1000.0]
    monkeypatch.setattr(ages.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(("count", "p50", "p99"), [(1, 1, 1), (2, 1, 2), (99, 50, 99), (100, 50, 99), (101, 51, 100), (200, 100, 198)])
def test_percentiles_are_ranks(clock, count, p50, p99):
    taken = Ages()
    for age_ms in reversed(range(1, count + 1)):
        taken.take(float(age_ms))
    assert taken.percentiles() == {"p50_ms": p50, "p99_ms": p99}


def test_what_came_long_ago_does_not_count(clock):
    taken = Ages()
    assert taken.percentiles() is None
    taken.take(900.0)
    clock[0] += WINDOW_S / 2
    taken.take(30.0)
    assert taken.percentiles() == {"p50_ms": 30.0, "p99_ms": 900.0}
    clock[0] += WINDOW_S / 2
    assert taken.percentiles() == {"p50_ms": 30.0, "p99_ms": 30.0}
    clock[0] += WINDOW_S
    assert taken.percentiles() is None


def test_memory_is_bounded(clock):
    taken = Ages()
    for age_ms in range(5 * MAX_PICTURES):
        taken.take(float(age_ms))
    assert taken.percentiles()["p50_ms"] > 4 * MAX_PICTURES  # type: ignore[index]
