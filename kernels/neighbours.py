"""Who is near whom: a cell list for any points, a table of numbers for a lattice."""

from functools import cache

import warp as wp


@cache
def near_points(dimension):
    """The kernel in d dimensions. Cells are counted in three, of which the plane has one layer."""
    d = dimension
    vec = wp.types.vector(d, wp.float64)

    @wp.func
    def separation(a: vec, b: vec, box: vec):
        """From a to the nearest image of b; a period of zero means no images."""
        step = b - a
        if box[0] > wp.float64(0.0):
            for axis in range(d):
                step[axis] = step[axis] - box[axis] * wp.rint(step[axis] / box[axis])
        return step

    @wp.kernel(enable_backward=False)
    def near_points(
        x: wp.array(dtype=vec),
        cell: wp.array(dtype=wp.vec3i),
        cells: wp.vec3i,
        cell_start: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
        box: vec,
        reach: wp.float64,
        fill: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        r: wp.array(dtype=wp.float64),
    ):
        """Points within reach of each point: first their number into row[i + 1], then who they are.

        Cells are at least as wide as the reach, so that those around a point's own hold them all;
        in a periodic box of two cells both are looked at once. order lists the points cell by cell,
        and those of cell c begin at cell_start[c].
        """
        i = wp.tid()
        first = cell[i] - wp.vec3i(1, 1, 1)
        last = wp.min(cell[i] + wp.vec3i(1, 1, 1), cells - wp.vec3i(1, 1, 1))
        if box[0] > wp.float64(0.0):
            last = first + wp.min(cells, wp.vec3i(3, 3, 3)) - wp.vec3i(1, 1, 1)
        else:
            first = wp.max(first, wp.vec3i(0, 0, 0))
        e = row[i]
        count = wp.int32(0)
        for a in range(first[0], last[0] + 1):
            p = (a + cells[0]) % cells[0]
            for b in range(first[1], last[1] + 1):
                q = p * cells[1] + (b + cells[1]) % cells[1]
                for c in range(first[2], last[2] + 1):
                    near = q * cells[2] + (c + cells[2]) % cells[2]
                    for n in range(cell_start[near], cell_start[near + 1]):
                        j = order[n]
                        length = wp.length(separation(x[i], x[j], box))
                        if j != i and length <= reach:
                            if fill > 0:
                                neighbour[e + count] = j
                                r[e + count] = length
                            count += 1
        if fill == 0:
            row[i + 1] = count

    return near_points


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
    place: wp.array(dtype=wp.int32),
    offset: wp.array(dtype=wp.int32),
    number: wp.array(dtype=wp.int32),
    neighbour: wp.array2d(dtype=wp.int32),
):
    """The node at each step of the pattern from each node, −1 where there is none.

    number is a table of nodes by place, with a margin of empty ones or of periodic images, in which
    each step of the pattern leads as far from every node.
    """
    i = first + wp.tid()
    for p in range(offset.shape[0]):
        neighbour[i, p] = number[place[i] + offset[p]]
