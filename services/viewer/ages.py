"""How old the light of the pictures is when they arrive here: percentiles over the last seconds."""

import math
import time
from collections import deque

WINDOW_S = 10.0  # 250 pictures of 25 a second: the 99th percentile is the third largest of them. 5 to 60 s would do
MAX_PICTURES = 1024  # of 100 a second


class Ages:
    """Of the pictures within WINDOW_S."""

    def __init__(self) -> None:
        self._taken: deque[tuple[float, float]] = deque(maxlen=MAX_PICTURES)

    def take(self, age_ms: float) -> None:
        """Takes a picture's, which has just come."""
        self._taken.append((time.monotonic(), age_ms))

    def percentiles(self) -> dict[str, float] | None:
        """p50_ms and p99_ms: the least age that half of the pictures, or all but a hundredth, do not exceed; None where none came."""
        recent_s = time.monotonic() - WINDOW_S
        ages = sorted(age_ms for taken_s, age_ms in self._taken if taken_s > recent_s)
        if not ages:
            return None
        return {f"p{part}_ms": ages[math.ceil(part / 100 * len(ages)) - 1] for part in (50, 99)}
