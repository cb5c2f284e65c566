"""Limits of a process that decodes what strangers sent: memory, processor time, what it may write."""

import os
import resource

MAX_MEMORY = 6 * 2**30  # bytes of addresses: libraries and compiled code reserve 2 GB of them, an 8192 x 4096 map takes 1.2 GB to read
MAX_CPU_S = 90
MAX_WRITTEN = 16 * 2**20  # bytes of a file: compiled code is kept in some


def limit_process() -> None:
    """Keeps this process within the limits from now on. It gets what time the others leave."""
    os.nice(10)
    for what, most in (
        (resource.RLIMIT_AS, MAX_MEMORY), (resource.RLIMIT_CPU, MAX_CPU_S), (resource.RLIMIT_FSIZE, MAX_WRITTEN), (resource.RLIMIT_CORE, 0),
    ):  # fmt: skip
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
