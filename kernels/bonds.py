"""What a bond is to the sweeps: its class and its vector.

Bond e of node i runs from row[i] to row[i + 1] and leads to neighbour[e]; a negative neighbour is a
broken bond. On a lattice (lattice = 1) every row is the whole family in one order, so bond e is
number e − row[i] of the pattern, which has its class and its vector ξ. On scattered points
(lattice = 0) every bond is its own class, and ξ joins the nearest images; box holds the periods and
their inverses, zeros where the points are not periodic.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp


@cache
def bonds(scalar):
    """Functions of a bond in one precision, with the types of vectors and boxes."""
    vec, mat = wp.types.vector(2, scalar), wp.types.matrix((2, 2), scalar)
    box_type = wp.types.vector(4, scalar)

    @wp.func
    def bond_class_of(lattice: wp.int32, bond_class: wp.array(dtype=wp.int32), p: wp.int32):
        if lattice == 1:
            return bond_class[p]
        return p

    @wp.func
    def bond_vector(
        lattice: wp.int32,
        pattern: wp.array(dtype=vec),
        p: wp.int32,
        x: wp.array(dtype=vec),
        i: wp.int32,
        j: wp.int32,
        box: box_type,
    ):
        if lattice == 1:
            return pattern[p]
        xi = x[j] - x[i]
        if box[0] > scalar(0.0):
            images = vec(box[0] * wp.rint(xi[0] * box[2]), box[1] * wp.rint(xi[1] * box[3]))
            return xi - images
        return xi

    return SimpleNamespace(
        vec=vec, mat=mat, box=box_type, bond_class_of=bond_class_of, bond_vector=bond_vector
    )
