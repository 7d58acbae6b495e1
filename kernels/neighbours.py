"""Who is near whom: a cell list for any points, a table of numbers for a lattice."""

import warp as wp


@wp.func
def separation(a: wp.vec2d, b: wp.vec2d, box: wp.vec2d):
    """From a to the nearest image of b; a period of zero means no images."""
    d = b - a
    if box[0] > wp.float64(0.0):
        return d - wp.vec2d(box[0] * wp.rint(d[0] / box[0]), box[1] * wp.rint(d[1] / box[1]))
    return d


@wp.kernel(enable_backward=False)
def near_points(
    x: wp.array(dtype=wp.vec2d),
    cell: wp.array2d(dtype=wp.int32),
    cell_start: wp.array2d(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    box: wp.vec2d,
    reach: wp.float64,
    fill: wp.int32,
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    r: wp.array(dtype=wp.float64),
):
    """Points within reach of each point: first their number into row[i + 1], then who they are.

    Cells are at least as wide as the reach, so that those around a point's own hold them all; in a
    periodic box of two cells both are looked at once. order lists the points cell by cell.
    """
    i = wp.tid()
    cells = wp.vec2i(cell_start.shape[0], cell_start.shape[1] - 1)
    periodic = box[0] > wp.float64(0.0)
    around = wp.vec2i(3, 3)
    if periodic:
        around = wp.vec2i(wp.min(3, cells[0]), wp.min(3, cells[1]))
    e = row[i]
    count = wp.int32(0)
    for a in range(around[0]):
        for b in range(around[1]):
            p = cell[i, 0] + a - 1
            q = cell[i, 1] + b - 1
            if periodic:
                p = (p + cells[0]) % cells[0]
                q = (q + cells[1]) % cells[1]
            if p >= 0 and q >= 0 and p < cells[0] and q < cells[1]:
                for n in range(cell_start[p, q], cell_start[p, q + 1]):
                    j = order[n]
                    length = wp.length(separation(x[i], x[j], box))
                    if j != i and length <= reach:
                        if fill == 1:
                            neighbour[e + count] = j
                            r[e + count] = length
                        count += 1
    if fill == 0:
        row[i + 1] = count


@wp.kernel(enable_backward=False)
def reverse_bonds(
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    reverse: wp.array(dtype=wp.int32),
):
    """reverse[e] is the bond from j to i where e is the bond from i to j."""
    i = wp.tid()
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        for f in range(row[j], row[j + 1]):
            if neighbour[f] == i:
                reverse[e] = f


@wp.kernel(enable_backward=False)
def any_neighbour(
    first: wp.int32,
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    flag: wp.array(dtype=wp.int32),
    touched: wp.array(dtype=wp.int32),
):
    """Nodes with an unbroken bond to a flagged node."""
    i = first + wp.tid()
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        if j >= 0 and flag[wp.max(j, 0)] == 1:
            touched[i] = 1


@wp.kernel(enable_backward=False)
def break_bonds(
    first: wp.int32,
    row: wp.array(dtype=wp.int32),
    outside: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
):
    """Break every bond that has one end outside: j becomes −1 − j."""
    i = first + wp.tid()
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        if j >= 0 and outside[i] != outside[wp.max(j, 0)]:
            neighbour[e] = -1 - j


@wp.kernel(enable_backward=False)
def lattice_neighbours(
    first: wp.int32,
    grid: wp.array2d(dtype=wp.int32),
    steps: wp.array2d(dtype=wp.int32),
    number: wp.array2d(dtype=wp.int32),
    neighbour: wp.array2d(dtype=wp.int32),
):
    """The node at each step of the pattern from each node, −1 where there is none.

    number has a margin of empty places, or is periodic.
    """
    i = first + wp.tid()
    for p in range(steps.shape[0]):
        a = (grid[i, 0] + steps[p, 0] + number.shape[0]) % number.shape[0]
        b = (grid[i, 1] + steps[p, 1] + number.shape[1]) % number.shape[1]
        neighbour[i, p] = number[a, b]
