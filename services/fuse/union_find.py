"""Sets that are joined (Galler and Fischer 1964): of each number the next one in its set, a root's own number."""

from vemlight.kernels import subroutine


@subroutine
def root_of(parents, n):
    while parents[n] != n:
        n = parents[n]
    return n
