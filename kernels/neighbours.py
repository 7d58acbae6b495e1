"""Who is near whom: nodes beside flagged ones, a table of numbers for a lattice."""

import warp as wp

ints = wp.array(dtype=wp.int32)


@wp.kernel(enable_backward=False)
def any_neighbour(first: wp.int32, row: ints, neighbour: ints, flag: ints, touched: ints):
    """Nodes with an unbroken bond to a flagged node."""
    i = first + wp.tid()
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        if j >= 0 and flag[wp.max(j, 0)] == 1:
            touched[i] = 1


@wp.kernel(enable_backward=False)
def lattice_neighbours(
    first: wp.int32, place: ints, offset: ints, number: ints, neighbour: wp.array2d(dtype=wp.int32)
):
    """The node at each step of the pattern from each node, −1 where there is none.

    number is a table of nodes by place, with a margin of empty ones or of periodic images, in which
    each step of the pattern leads as far from every node.
    """
    i = first + wp.tid()
    for p in range(offset.shape[0]):
        neighbour[i, p] = number[place[i] + offset[p]]
