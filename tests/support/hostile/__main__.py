"""Damaged files and bombs of every format that is read, each read in a child process with limits.

`python -m tests.support.hostile [--count N] [--seed S] [--no-bombs] [FORMAT ...]`. A file is right or refused with a UserError of one
line. A fault, whose file is kept, is a signal, another exception, a library's word on the terminal, more than MAX_S or MAX_BYTES.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tests.support.hostile.formats import FORMATS
from tests.support.hostile.trial import examine


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=f"of {', '.join(FORMATS)}; left out: all")
    parser.add_argument("--count", type=lambda text: int(float(text)), default=2000)
    parser.add_argument("--bombs", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "vemlight-hostile", help="folder for the faulty files")
    options = parser.parse_args()
    found = 0
    for name in options.formats or FORMATS:
        began_s = time.monotonic()
        count = round(FORMATS[name].share * options.count)
        bombs, faults = examine(name, count, options.seed, options.keep, options.bombs)
        found += len(faults)
        took_s = time.monotonic() - began_s
        print(f"{name}: {count} damaged files, {bombs} bombs, {len(faults)} faults, {took_s:.0f} s", flush=True)
        for kind in dict.fromkeys(fault.reason for fault in faults):
            some = [fault for fault in faults if fault.reason == kind]
            print(f"  {len(some)} x {kind}: {some[0].name}", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
