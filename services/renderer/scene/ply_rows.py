"""Rows of binary PLY elements with lists of several lengths, found in loops that are compiled."""

from vemlight.kernels import kernel


@kernel
def row_offsets(data, at, is_list, count_sizes, sizes, big_endian, read, offsets, counts):
    """Fills where the values of the columns that are `read` lie in `data` (n,) uint8, and how many each row has.

    offsets, counts: (columns read, rows) int64. at: where the rows begin. is_list, count_sizes, sizes, read: of each column; sizes in
    bytes. Returns where the rows end; -1 where `data` ends before.
    """
    for row in range(offsets.shape[1]):
        column = 0
        for k in range(len(is_list)):
            count = 1
            if is_list[k]:
                if at + count_sizes[k] > len(data):
                    return -1
                count = 0
                for n in range(count_sizes[k]):
                    count |= int(data[at + n]) << (8 * (count_sizes[k] - 1 - n if big_endian else n))
                at += count_sizes[k]
            if count < 0 or count > len(data) or at + count * sizes[k] > len(data):
                return -1
            if read[k]:
                offsets[column, row], counts[column, row] = at, count
                column += 1
            at += count * sizes[k]
    return at


@kernel
def gather(data, offsets, counts, item_bytes, values):
    """Copies the values at `offsets` (rows,) of `data`, as many as `counts` says, one after the other to `values` (n,) uint8."""
    n = 0
    for row in range(len(offsets)):
        for k in range(counts[row] * item_bytes):
            values[n] = data[offsets[row] + k]
            n += 1
