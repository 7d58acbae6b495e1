"""Small laws and lattices that the tests of micromodulus tensors share."""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.linalg import norm
from scipy.spatial import cKDTree

from tests.support import problems, sup
from tests.support.problems import normal
from warp_peri.core import elastic
from warp_peri.core.elastic import checked_orientation, point_group, shared_with_nodes
from warp_peri.core.stencil import invariant_basis
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.crystal_fit import fit_dispersion

CUBIC = {2: ("4mm", 2.5), 3: ("m-3m", 2.0)}
CUBES = elastic.allowed_tensors("m-3m", np.eye(3))
"""Elastic tensors of cubic crystals."""
COPPER = {"C11": 0.170, "C12": 0.122, "C44": 0.076}


def cubic_tensor(d, C11=0.170, C12=0.122, C44=0.076):
    """C_ijkl of a cubic or square crystal along its axes."""
    one = np.eye(d)
    tensor = C12 * np.einsum("ij,kl->ijkl", one, one)
    tensor += C44 * (np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one))
    for i in range(d):
        tensor[i, i, i, i] = C11
    return tensor


def dispersive(tensor, length=1.0):
    """Γ(k) of an elastic tensor, softer at short waves as a lattice is, [K, d] to [K, d, d]."""

    def symbol(k):
        local = np.einsum("ijkl,nj,nl->nik", tensor, k, k)
        return local / (1 + 0.05 * length**2 * (k**2).sum(1))[:, None, None]

    return symbol


@cache
def learned(d, orientation=None):
    """A certified law of a copper-like crystal."""
    (name, reach), turn = CUBIC[d], checked_orientation(orientation, d)
    C = np.einsum("ai,bj,ck,dl,ijkl->abcd", *[turn] * 4, cubic_tensor(d))
    how = {"symmetry": name, "orientation": turn, "tensor": C}
    return fit_dispersion(dispersive(C), 1.5, 1.5 * reach, **how)


def random_law(d, symmetry="m-3m"):
    """Tensors of a symmetry, of any sign, that are no crystal's."""
    name = symmetry if d == 3 else "4mm"
    bonds = invariant_basis(2.0, shared_with_nodes(point_group(name, d), np.eye(d)))
    p = normal(len(bonds.basis))
    return CrystalMaterial(1.5, bonds.steps, np.tensordot(p, bonds.basis, 1), symmetry=name)


def lattice(d, n, collar, spacing=1.5, ball=False):
    """Nodes of a square or cube, or of a ball in it, with a collar."""
    inside = np.ones(d * (n,), bool)
    if ball:
        inside = norm(np.indices(inside.shape) - (n - 1) / 2, axis=0) <= n / 2
    return replace(problems.lattice(inside, collar * spacing / 2, spacing), axis=None)


def far_end(points, xi):
    """How far from the end of a bond at each node the nearest node is, and which one it is."""
    x, tree = points.x + xi, cKDTree(points.x, boxsize=points.box)
    return tree.query(x if points.box is None else x % points.box)


def plain_energy(law, points, u):
    """Energy of every bond with an unknown at an end."""
    total = 0.0
    for step, C in zip(law.steps, law.tensors):
        far, other = far_end(points, law.spacing * step)
        bent = (u[other] - u)[((far < 1e-6) & (points.interior | points.interior[other]))]
        total += 0.5 * law.spacing**law.dimension * np.einsum("ni,ij,nj->", bent, C, bent)
    return total


def huang_defect(law):
    """Largest break of Huang's relations, relative to the largest bracket."""
    held = 0.0 if law.stress is None else elastic.stress_brackets(law.stress)
    brackets = law.stencil.brackets
    return sup(elastic.huang_rows((brackets - held)[None])) / sup(brackets)
