"""The environment map for browsers' pictures: the newest and its lights, seldom, and only when it is another one."""

import numpy as np

from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.viewer.environment_binary import environment_binary
from vemlight.viewer.feeds import Condition, Feed

PERIOD_S = 1.0  # at least, between two: each has as many bytes as the lights of a second. 0.5 to 3 s would do


class EnvironmentFeed(Feed):
    """A feed that is offered all maps and lights, and takes few. The clock is passed in."""

    def __init__(self, condition: Condition) -> None:
        super().__init__(environment_binary, condition)
        self.newest_map: EnvironmentMap | None = None
        self.newest_lights: LightSet | None = None
        self._taken: tuple[EnvironmentMap, LightSet] | None = None
        self._taken_s = float("-inf")

    def put_if_due(self, now_s: float) -> None:
        """Puts the newest of both in, unless the last was PERIOD_S ago or less, or the same."""
        if self.newest_map is None or self.newest_lights is None or now_s - self._taken_s < PERIOD_S:
            return
        if self._taken and _same(self._taken[0], self.newest_map) and _same(self._taken[1], self.newest_lights):
            return
        self._taken, self._taken_s = (self.newest_map, self.newest_lights), now_s
        self.put(*self._taken)


def _same(one: object, other: object) -> bool:
    """Whether two are the same: tuples, of tuples and arrays."""
    if isinstance(one, tuple) and isinstance(other, tuple):
        return one is other or all(_same(a, b) for a, b in zip(one, other, strict=True))
    return np.array_equal(one, other)  # type: ignore[arg-type]
