"""The linear peridynamic solid learned from fields in space, on rows of tensors (theory, V7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from warp_peri.core.elastic import allowed_tensors
from warp_peri.core.groups import point_group, shared_with_nodes
from warp_peri.core.proof import Proof
from warp_peri.core.stencil import invariant_basis, ratios, zone_sample
from warp_peri.errors import InputError
from warp_peri.lps.model import Model, Solid, bernstein_basis
from warp_peri.lps.symbol import stencil
from warp_peri.micromodulus.law import tensors_of
from warp_peri.micromodulus.regression import long_wave_moduli, rows
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.regression.search import particular
from warp_peri.regression.settings import ISOTROPIC
from warp_peri.shown import in_rows

ALPHA = 1.0
"""Of K = r^(−α) Σ D B; D bends it to any other."""
SHARE = 0.0161
"""ζ over the shear modulus that the data show, where none is given."""
BELOW = 10.0
"""Weight of a wave that is softer than ζ s, beside the relative residual."""


@dataclass(frozen=True, repr=False)
class SpaceFit:
    """A learned solid in space.

    Attributes:
        material: the model; `tensors_of(material, spacing)` solves with it at any size.
        certificate: of these tensors on the training lattice (T11–T13).
        history: ‖L u − b‖ / ‖b‖ of all samples, the rounds of the search, how many numbers.
    """

    material: Model
    certificate: Proof
    history: dict[str, Any]

    def __repr__(self) -> str:
        residual = f"{100 * self.history['residual']:.3g} % of the training loads"
        return in_rows("SpaceFit", [*self.material.rows(), ("residual", residual)])


def learn_in_space(
    samples: Samples,
    horizon: float,
    degree: int,
    *,
    moduli: tuple[float, float] | str | None = None,
    zeta: float | None = None,
    normalise: bool = False,
) -> SpaceFit:
    """λ, μ and D of fields on a cubic lattice, by least squares of L u = b with D(k) ≥ ζ s(k).

    On the lattice the solid is a law of tensors of range 2δ that are linear in μ w and in
    (λ−μ) w w (T17): the samples are swept once for all tensors of a cubic crystal, and what is left
    is a search over the few numbers of K.

    Args:
        samples: displacements and loads, periodic or with a collar of 2δ.
        horizon: δ, in the unit of length.
        degree: M of the Bernstein polynomials.
        moduli: of long waves: None leaves them free, "isotropic" or (λ, μ) [stress] holds them.
        zeta: ζ [stress]; None takes a small part of the shear modulus that the data show.
        normalise: divide each sample by ‖b‖.

    Raises InputError for samples that do not carry the horizon, and without a positive answer.
    """
    points, h = samples.points, samples.spacing
    group = shared_with_nodes(point_group("m-3m", 3), np.eye(3))
    bonds = invariant_basis(2 * horizon / h, group)
    R, y = rows(samples, bonds, normalise=normalise)
    size = float(np.linalg.norm(y))
    classes = bond_classes(h, horizon, dimension=3)
    seen = long_wave_moduli(samples, allowed_tensors("isotropic", group, np.eye(3)))[0]
    mu, excess = float(seen[0, 1, 0, 1]), float(seen[0, 0, 1, 1] - seen[0, 1, 0, 1])
    basis = bernstein_basis(classes.r, horizon, degree)
    each = (classes.weight * classes.r**-ALPHA)[:, None] * basis  # K W of unit D
    volume = (classes.count * classes.r**2) @ each
    held, values = _held(moduli, classes, each, volume, mu)
    start, free = particular(held, values)
    fixed = isinstance(moduli, tuple)
    if isinstance(moduli, tuple):
        excess = moduli[0] - moduli[1]
    reach = int(np.abs(bonds.steps).max())
    project = np.linalg.pinv(bonds.basis.reshape(len(bonds.basis), -1).T)
    phase = zone_sample(group, 3)
    floor = zeta or SHARE * mu

    def numbers(x: np.ndarray) -> tuple[np.ndarray, float, float]:
        D = start + free @ x[: free.shape[1]]
        shear = mu * float(volume @ D)
        return D, shear, shear + (x[-1] * mu if len(x) > free.shape[1] else excess)

    def misses(x: np.ndarray) -> np.ndarray:
        D, shear, lam = numbers(x)
        wide = -stencil(classes, Solid(lam, shear, ALPHA, D)).numpy()
        middle = wide.shape[-1] // 2
        wide = np.pad(wide, 2 * [(0, 0)] + 3 * [(reach, reach)])
        tensors = np.moveaxis(wide[:, :, *(bonds.steps + middle + reach).T], 2, 0)
        p = project @ tensors.ravel()
        low = ratios(bonds.steps, tensors, phase)[0] * h**2 / floor
        return np.append((R @ p - y) / size, BELOW * np.minimum(0, low - 1))

    plain = np.zeros(free.shape[1]) + free.T @ (np.ones(len(volume)) / volume.sum() - start)
    found = least_squares(misses, plain if fixed else np.append(plain, excess / mu), x_scale="jac")
    D, shear, lam = numbers(found.x)
    model = Model(lam, shear, ALPHA, D, horizon, units=points.units, dimension=3)
    proof = tensors_of(model, h).certificate
    if proof is None or not proof.holds:
        raise InputError("data: no positive solid of this horizon and kernel was found for them")
    residual = float(np.linalg.norm(found.fun[: len(y)]))
    record = {"residual": residual, "rounds": found.nfev, "numbers": len(found.x)}
    return SpaceFit(model, proof, record)


def _held(
    moduli: Any, classes: Any, each: np.ndarray, volume: np.ndarray, mu: float
) -> tuple[np.ndarray, np.ndarray]:
    """Equalities A D = a on K W = `each` D: isotropic long waves, and the shear modulus over mu."""
    if moduli is None:
        return np.zeros((0, len(volume))), np.zeros(0)
    x = classes.xi
    fourth = (x[:, 0] ** 4 - 3 * x[:, 0] ** 2 * x[:, 1] ** 2) / (x**2).sum(axis=1)
    uneven = np.bincount(classes.bond_class, fourth) @ each
    if moduli == ISOTROPIC:
        return (uneven / np.abs(volume).max())[None], np.zeros(1)
    held = np.stack([uneven, volume]) / np.abs(volume).max()
    return held, np.array([0.0, moduli[1] / mu / np.abs(volume).max()])
