"""When the light of a frame was seen, by which clocks, and how long ago that is."""

import time
from functools import cache
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from vemlight.runtime.wire_fields import Nanoseconds, Sequence53


class Stamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which frame this is and when its light was seen."""

    sequence: Sequence53
    time_s: Annotated[float, Meta(ge=0, le=1e12)]  # on the source's own clock: filters use it
    captured_ns: Nanoseconds  # realtime
    monotonic_ns: Nanoseconds  # for ages on one host: steps of the realtime clock do not change it
    boot_id: Annotated[str, Meta(max_length=64)]  # monotonic clocks compare only when this is equal


@cache
def boot_id() -> str:
    """Names this run of this machine's kernel: monotonic clocks compare only within one."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def stamp(sequence: int, time_s: float) -> Stamp:
    """A stamp for light that is seen now."""
    return Stamp(sequence=sequence, time_s=time_s, captured_ns=time.time_ns(), monotonic_ns=time.monotonic_ns(), boot_id=boot_id())


def age_ms(of: Stamp) -> float:
    """Milliseconds since the light was seen: by the monotonic clock on one host, by realtime between hosts; never negative."""
    same_clock = of.boot_id and of.boot_id == boot_id()
    return max(0.0, ((time.monotonic_ns() - of.monotonic_ns) if same_clock else (time.time_ns() - of.captured_ns)) / 1e6)
