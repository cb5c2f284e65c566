"""The set of rows of the greatest value in which no number comes twice: weighted set packing, by branch and bound (Land and Doig 1960)."""

import numpy as np

from vemlight.fuse.union_find import root_of
from vemlight.kernels import kernel, subroutine

MAX_NODES = 50_000  # of a search; a dozen lamps take a few hundred


def best_disjoint(members: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, bool]:
    """Which rows of members (n, m) int64, numbers >= 0 or -1 for none, to take so that no number comes twice and the values (n,) add up to
    the most: ascending indices, and whether they are surely the best. A search of more than MAX_NODES steps gives the best that it met.
    """
    worth = np.flatnonzero(values > 0)
    if not len(worth):
        return worth, True
    order = worth[np.argsort(-values[worth], kind="stable")]
    numbers, place = np.unique(members[order], return_inverse=True)
    compact = place.reshape(len(order), members.shape[1]) - int(numbers[0] < 0)
    taken, is_exact = _best(compact, values[order], len(numbers) - int(numbers[0] < 0))
    return np.sort(order[taken]), is_exact


@kernel
def _best(members, values, numbers):
    """Which rows, the greatest value first, a best set takes, and whether it is surely the best; members hold 0 .. numbers - 1, or -1.

    Rows that are linked by a number are one group, which is searched number by number. A branch is left when the numbers that are still
    free cannot bring more than the best so far: each at most the greatest share of a value that a row has for it.
    """
    rows, width = members.shape
    group, best_share = np.arange(numbers), np.zeros(numbers)
    sizes = np.zeros(rows, np.int64)
    for r in range(rows):
        first = -1
        for m in range(width):
            if members[r, m] >= 0:
                sizes[r] += 1
                first = members[r, m] if first < 0 else first
        for m in range(width):
            number = members[r, m]
            if number >= 0:
                best_share[number] = max(best_share[number], values[r] / sizes[r])
                a, b = root_of(group, first), root_of(group, number)
                group[max(a, b)] = min(a, b)
    taken, is_exact = np.zeros(rows, np.bool_), True
    for root in range(numbers):
        if root_of(group, root) == root:
            is_exact = _search(root, group, members, values, best_share, taken) <= MAX_NODES and is_exact
    return taken, is_exact


@subroutine
def _numbers_of(root, group, best_share, own, rank):
    # a group's numbers into `own`, those with the greatest share first, and their places there into `rank`; how many there are
    count = 0
    for n in range(len(group)):
        rank[n] = -1
        if root_of(group, n) == root:
            j = count
            while j > 0 and best_share[own[j - 1]] < best_share[n]:
                own[j] = own[j - 1]
                j -= 1
            own[j] = n
            count += 1
    for i in range(count):
        rank[own[i]] = i
    return count


@subroutine
def _listed(members, rank, count, starts, listed):
    # a group's rows by the first of their numbers, listed[starts[i] : starts[i + 1]] those of the i-th, in the order of their values
    rows, width = members.shape
    end = 0
    for i in range(count):
        starts[i] = end
        for r in range(rows):
            lowest = count
            for m in range(width):
                if members[r, m] >= 0 and rank[members[r, m]] >= 0:
                    lowest = min(lowest, rank[members[r, m]])
            if lowest == i:
                listed[end] = r
                end += 1
    starts[count] = end
    return end


@subroutine
def _search(root, group, members, values, best_share, taken):
    # the rows of a group, after how many steps
    own, rank = np.empty(len(group), np.int64), np.empty(len(group), np.int64)
    count = _numbers_of(root, group, best_share, own, rank)
    starts, listed = np.empty(count + 1, np.int64), np.empty(len(members), np.int64)
    end = _listed(members, rank, count, starts, listed)
    used, choice, chosen = np.zeros(len(group), np.bool_), np.zeros(count + 1, np.int64), np.full(count + 1, -1, np.int64)
    best, value, depth, nodes = -1.0, 0.0, 0, 0
    while depth >= 0:
        if chosen[depth] >= 0:  # back from below: undo
            value -= values[chosen[depth]]
            _mark(members[chosen[depth]], used, False)
            chosen[depth] = -1
        bound = value
        for i in range(depth, count):
            if not used[own[i]]:
                bound += best_share[own[i]]
        if depth == count and value > best:
            best = value
            for n in range(end):
                taken[listed[n]] = False
            for i in range(count):
                if chosen[i] >= 0:
                    taken[chosen[i]] = True
        nodes += 1
        options = starts[depth + 1] - starts[depth] if depth < count else -1
        if depth == count or bound <= best + 1e-9 or choice[depth] > options or (nodes > MAX_NODES and best >= 0):
            choice[depth] = 0
            depth -= 1
            continue
        option = choice[depth]
        choice[depth] += 1
        if option == options:
            depth += 1  # none of them
            choice[depth] = 0
            continue
        row = listed[starts[depth] + option]
        if _is_free(members[row], used):
            chosen[depth] = row
            value += values[row]
            _mark(members[row], used, True)
            depth += 1
            choice[depth] = 0
    return nodes


@subroutine
def _is_free(row, used):
    free = True
    for number in row:
        free = free and not (number >= 0 and used[number])
    return free


@subroutine
def _mark(row, used, to):
    for number in row:
        if number >= 0:
            used[number] = to
