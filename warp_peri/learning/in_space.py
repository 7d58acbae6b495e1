"""The linear peridynamic solid learned from fields in space (theory, V7)."""

from __future__ import annotations

import numpy as np

from warp_peri.contract import MaterialFit
from warp_peri.core.elastic import allowed_tensors
from warp_peri.core.groups import lattice_group
from warp_peri.errors import InputError
from warp_peri.fitting.long_waves import long_wave_moduli
from warp_peri.fitting.settings import Conditions, Optimum
from warp_peri.fitting.training_data import sample_weights
from warp_peri.materials.crystal import tensors_of
from warp_peri.materials.lps import Solid
from warp_peri.materials.lps_fit import LPSFound, Products, optimum
from warp_peri.points.samples import Samples

ALPHA = 1.0
"""Of K = r^(−α) Σ D B; D bends it to any other."""
SHARE = 0.0161
"""ζ over the shear modulus that the data show, where none is given."""


def learn_in_space(
    samples: Samples,
    horizon: float,
    degree: int,
    *,
    method: Optimum,
    zeta: float | None = None,
    normalise: bool = False,
) -> MaterialFit:
    """λ, μ and D of fields on a cubic lattice, by least squares of L u = b with D(k) ≥ ζ s(k).

    Args:
        samples: displacements and loads, periodic or with a collar of 2δ.
        horizon: δ, in the unit of length.
        degree: M of the Bernstein polynomials.
        method: whose moduli of long waves are held.
        zeta: ζ [stress]; None takes a small part of the shear modulus that the data show.
        normalise: divide each sample by ‖b‖.

    Its history has ‖L u − b‖ / ‖b‖ of all samples, the cuts of the search, how many numbers; its
    certificate is of the tensors on the training lattice, tensors_of(material, spacing).

    Raises InputError for samples that do not carry the horizon, and without a positive answer.
    """
    products = Products(samples, horizon)
    block = products.rows(sample_weights([samples], normalise=normalise)[0])
    allowed = allowed_tensors("isotropic", lattice_group(3), np.eye(3))
    mu = float(long_wave_moduli(samples, allowed)[0][0, 1, 0, 1])
    start = LPSFound(Solid(0.0, mu, ALPHA, np.ones(degree + 1)))
    asked = Conditions(zeta=zeta or SHARE * mu)
    reached = optimum([block], [products.classes], start, asked, method)
    model = reached.model(horizon, dimension=3, units=samples.points.units)
    proof = tensors_of(model, samples.spacing).certificate
    if not reached.converged or proof is None or not proof.holds:
        raise InputError("data: no positive solid of this horizon and kernel was found for them")
    record = {"residual": reached.loss**0.5, "cuts": reached.cuts, "numbers": degree + 3}
    return MaterialFit(model, record, proof=proof)
