"""Changes the source in small ways, one at a time, and counts the changes that the tests notice.

    python -m tests.mutants [--only TEXT ...] [--workers N] [--list]

--only: mutants whose name or file holds one of the texts. Not part of the test suite: it takes an hour or two. Ends with 1 when a mutant
that matters survives, a harmless one is killed, one cannot be applied, or under 90 % are killed.
"""

import argparse
import sys

from tests.mutants.runner import run
from tests.mutants.tables import TABLES

MIN_KILLED = 0.9


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[""])
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--list", action="store_true")
    arguments = parser.parse_args()
    chosen = [m for table in TABLES for m in table if any(text in f"{m.name} {m.file}" for text in arguments.only)]
    if arguments.list:
        print(*(f"{m.name}: {m.old!r} -> {m.new!r}" for m in chosen), sep="\n")
        return 0
    verdicts, wrong = [], 0
    for verdict in run(chosen, arguments.workers):
        mutant = verdict.mutant
        expected = "survived" if mutant.harmless else "killed"
        wrong += verdict.outcome != expected
        note = f" (harmless: {mutant.harmless})" if mutant.harmless else "" if verdict.outcome == expected else "  <---"
        print(f"{verdict.outcome:9} {verdict.spent_s:4.0f} s  {mutant.name}{note}", flush=True)
        verdicts.append(verdict)
    killed = sum(verdict.outcome == "killed" for verdict in verdicts)
    print(f"{killed} of {len(verdicts)} killed, {killed / max(len(verdicts), 1):.0%}; {wrong} not as expected")
    return int(wrong > 0 or killed < MIN_KILLED * len(verdicts))


if __name__ == "__main__":
    sys.exit(main())
