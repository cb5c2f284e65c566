"""How often somebody may do something."""

import time


class Allowance:
    """So many at once, and `per_s` more each second after that."""

    def __init__(self, burst: float, per_s: float) -> None:
        self._burst, self._per_s = burst, per_s
        self._left, self._counted_s = burst, time.monotonic()

    def take(self, amount: float = 1.0) -> bool:
        """Takes `amount` from it; whether there was as much."""
        if not self.has(amount):
            return False
        self._left -= amount
        return True

    def has(self, amount: float = 1.0) -> bool:
        """Whether as much is left."""
        self._refill()
        return amount <= self._left

    @property
    def is_full(self) -> bool:
        """Whether nothing was taken lately."""
        self._refill()
        return self._left >= self._burst

    def _refill(self) -> None:
        now_s = time.monotonic()
        self._left = min(self._burst, self._left + (now_s - self._counted_s) * self._per_s)
        self._counted_s = now_s
