"""A camera of a rig that was away and comes back with another unit and another size of map."""

import numpy as np
import pytest

from tests.support.analytic_rooms import TRIANGLE, maps_of, noisy, random_room, rig_of
from vemlight.fuse.fusing import FuseState, fuse_step
from vemlight.light.environment_map import EnvironmentMap

RIG = rig_of(TRIANGLE)


@pytest.fixture(scope="module")
def seen() -> tuple[list[EnvironmentMap], list[EnvironmentMap]]:
    """Maps of one room, of 90 and of 60 rows."""
    room = random_room(3)
    return maps_of(room, RIG, np.random.default_rng(1)), maps_of(room, RIG, np.random.default_rng(1), rows=60)


class Fused:
    """Fuses noisy maps of a moment, again and again."""

    def __init__(self) -> None:
        self._state = FuseState.start(RIG)
        self._noise = np.random.default_rng(2)

    def after(self, frames: int, maps: list[EnvironmentMap | None]):
        """(near lights' ids, irradiance) of the last of so many frames."""
        for _ in range(frames):
            now = [None if each is None else noisy(each, self._noise) for each in maps]
            self._state, _, near, report = fuse_step(self._state, now)
        return near.ids.tolist(), report.irradiance


def scaled(seen: EnvironmentMap, factor: float) -> EnvironmentMap:
    return EnvironmentMap((factor * seen.radiance).astype(np.float32), seen.coverage, seen.bright_cells)


@pytest.mark.parametrize(
    ("away", "factor"),
    [pytest.param(away, factor, marks=() if (away, factor) in ((0, 4.0), (2, 0.3)) else pytest.mark.long)
     for away in (0, 1, 2) for factor in (4.0, 1.5, 0.3)],
)  # fmt: skip
def test_a_camera_comes_back_with_another_unit_and_size(seen, away, factor):
    maps, small = seen
    fused = Fused()
    ids, before = fused.after(20, maps)
    assert ids
    fused.after(3, [None if k == away else each for k, each in enumerate(maps)])
    back = [scaled(small[k], factor) if k == away else each for k, each in enumerate(maps)]
    ids_back, after = fused.after(3, back)
    assert ids_back == ids
    assert np.allclose(after, before, rtol=0.02), "in the unit of those that stayed, after three frames"
    _, later = fused.after(20, back)
    assert np.allclose(later, before, rtol=0.02), "and for good"


def test_a_first_camera_that_comes_late_takes_the_unit_of_the_others(seen):
    maps, _ = seen
    fused = Fused()
    _, before = fused.after(10, [None, *maps[1:]])
    _, after = fused.after(20, [scaled(maps[0], 4.0), *maps[1:]])
    assert np.allclose(after, before, rtol=0.05)  # three views and two
