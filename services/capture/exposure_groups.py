"""Which photographs of a folder are the exposures of one frame."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from vemlight.errors import UserError

SAME = 1.05  # times: exposures closer than this are one; cameras step by thirds of a stop, 1.26


class Photograph(NamedTuple):
    """A file and its exposure in s."""

    name: str
    exposure_s: float


def exposure_groups(photographs: Sequence[Photograph], folder: str) -> list[list[int]]:
    """Indices of the photographs of each frame, in order, those of a frame from the longest exposure to the shortest.

    A folder is one frame when all its exposures differ. Where the same exposures come again and again, each round of them is a frame, in
    whatever order the camera takes them; else each run of rising or falling exposure is one. Raises UserError for a single photograph or
    exposure, and for one that is there twice in a frame.
    """
    exposures = [photograph.exposure_s for photograph in photographs]
    if len(exposures) < 2:
        raise UserError(f"{folder}: holds 1 photograph, and a bracket has two exposures or more; leave out --brackets")
    if max(exposures) < SAME * min(exposures):
        raise UserError(f"{folder}: its {len(exposures)} photographs have one exposure, {exposures[0]:.3g} s; leave out --brackets")
    groups = _rounds(exposures) or _runs(exposures)
    for group in groups:
        group.sort(key=lambda k: -exposures[k])
        if len(group) < 2:
            raise UserError(f"{photographs[group[0]].name}: has no other exposure beside it; add the bracket's others, or leave it out")
        for longer, shorter in itertools.pairwise(group):
            if _same(exposures[longer], exposures[shorter]):
                names = f"{photographs[shorter].name}: has the exposure of {photographs[longer].name}"
                raise UserError(f"{names}, {exposures[longer]:.3g} s, in the same frame; leave one of them out")
    return groups


def _same(first: float, second: float) -> bool:
    return max(first, second) < SAME * min(first, second)


def _rounds(exposures: list[float]) -> list[list[int]]:
    """Rounds in which each exposure occurs once; nothing unless all are alike and there are two or more."""
    ordered = sorted(exposures)
    count = 1 + sum(not _same(*pair) for pair in itertools.pairwise(ordered))
    if len(exposures) % count or len(exposures) == count:
        return []
    rounds = [list(range(k, k + count)) for k in range(0, len(exposures), count)]
    first = sorted(exposures[:count])
    alike = all(all(map(_same, first, sorted(exposures[k] for k in group))) for group in rounds)
    return rounds if alike and not any(_same(*pair) for pair in itertools.pairwise(first)) else []


def _runs(exposures: list[float]) -> list[list[int]]:
    """Runs of rising or of falling exposure; the whole folder where its exposures differ and the runs are no frames of one kind."""
    runs, rising = [[0]], None
    for k, exposure_s in enumerate(exposures[1:], 1):
        # an exposure that comes twice belongs to the next run where the direction turns; else it is one too many, and refused later
        onward = next((later for later in exposures[k:] if not _same(later, exposures[k - 1])), exposure_s)
        rises = onward > exposures[k - 1]
        if len(runs[-1]) > 1 and rises != rising and not (onward is exposure_s and _same(exposure_s, exposures[k - 1])):
            runs.append([k])
            continue
        if len(runs[-1]) == 1:
            rising = rises
        runs[-1].append(k)
    differ = not any(_same(*pair) for pair in itertools.pairwise(sorted(exposures)))
    directions = {exposures[run[-1]] > exposures[run[0]] for run in runs}
    of_one_kind = len(directions) == 1 and len({len(run) for run in runs}) == 1 and len(runs[0]) > 1
    return [list(range(len(exposures)))] if differ and not of_one_kind else runs
