"""The operator of a lattice as one stencil, differentiable in the numbers of the solid.

With full families everywhere (9) is the convolution (L u)_i = Σ_n A(n) u_{i+n}, A(n) = A(−n). On
any finite set of unknowns the operator is a block of the same convolution on a torus so large that
nothing reaches around it (theory.md, 53–54).
"""

from __future__ import annotations

import numpy as np
import torch

from warp_peri.models.influence import bernstein_basis
from warp_peri.models.solid import Solid
from warp_peri.points.families import BondClasses


def stencil(classes: BondClasses, solid: Solid) -> torch.Tensor:
    """A(n) [TPa/Å²] along the lattice's own axes, shape [d, d] and d times 2R + 1, n = 0 central.

    Differentiable in the values of the solid that are float64 tensors. R is the reach of a family
    in steps, or twice it with a dilatation; λ = μ has none (theory.md, 42).
    """
    solid = solid.map(lambda value: torch.as_tensor(value, dtype=torch.float64))
    lam, mu, alpha = (value.reshape(()) for value in (solid.lam, solid.mu, solid.alpha))
    xi, r = torch.from_numpy(classes.xi), torch.from_numpy(classes.r)
    weight, count = torch.from_numpy(classes.weight), torch.from_numpy(classes.count).to(r.dtype)
    reach = int(np.abs(classes.steps).max())
    d, size = classes.steps.shape[1], 2 * reach + 1
    place = torch.from_numpy((classes.steps + reach) @ size ** np.arange(d)[::-1])
    normalised = []
    for coefficients in (solid.D, solid.dilatation):
        basis = torch.from_numpy(bernstein_basis(classes.r, classes.horizon, len(coefficients) - 1))
        kw = weight * r**-alpha * (basis @ coefficients)
        normalised.append((kw / (count @ (kw * r**2)))[classes.bond_class])
    w, p = normalised
    bonds = -2 * d * (d + 2) * mu * w / (xi**2).sum(dim=1) * torch.einsum("na,nb->abn", xi, xi)
    gamma = torch.zeros(d, d, size**d, dtype=r.dtype).index_add(2, place, bonds)
    middle, box = torch.tensor([size**d // 2]), d * (size,)
    gamma = gamma.index_add(2, middle, -bonds.sum(dim=2, keepdim=True)).reshape(d, d, *box)
    if solid.bond_based:
        return gamma
    phi = torch.zeros(d, size**d, dtype=r.dtype).index_add(1, place, d * p * xi.T)
    phi = phi.reshape(d, 1, *box)
    convolved = {2: torch.nn.functional.conv2d, 3: torch.nn.functional.conv3d}[d]
    bulk = convolved(phi, phi.flip(*range(2, 2 + d)), padding=2 * reach)
    whole: torch.Tensor = torch.nn.functional.pad(gamma, 2 * d * [reach]) - (lam - mu) * bulk
    return whole
