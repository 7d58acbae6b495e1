"""Training sets made ready once, in the units of the fit (theory, U1–U2).

Nothing in a linear solid has a length or a stress of its own, but starts, steps, bounds and
tolerances of a search are numbers. They are numbers of Å and TPa, or of units that follow the data
from there in coarse steps: powers of 64 and of 16, so that going there and back costs no digit.
During every fit the reduced loss is held to the full one: a departure warns, or ends it.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.learning.methods import Constrained, Method, TwoStage
from warp_peri.materials.lps import Solid, bernstein_basis
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.points.dataset import Dataset, in_units_of, scaled
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import USUAL, Units, check_units, search_length, search_unit
from warp_peri.regression.coordinates import Parameters, Variables
from warp_peri.regression.losses import (
    FullLoss,
    ReducedLoss,
    corrected,
    noise_loss,
    reduce,
    sample_weights,
)
from warp_peri.regression.optimum import Conditions, LatticeConditions
from warp_peri.regression.settings import Optimum


@dataclass(frozen=True)
class TrainingData:
    """What every method learns from.

    Attributes:
        sets: training sets.
        horizon: δ [Å].
        full: the loss of each through Warp's operator.
        grids: the reduced loss of each; none for scattered points.
        conditions: what must hold on each lattice.
        noise: fields of noise of each set; empty when nothing is known of it.
        added: what that noise adds to each reduced loss.
        stress: unit of stress that all of it is in [TPa].
    """

    sets: list[Samples]
    horizon: float
    full: list[FullLoss]
    grids: list[ReducedLoss]
    conditions: list[LatticeConditions]
    noise: list[Samples]
    added: list[np.ndarray]
    stress: float = 1.0

    @property
    def spacings(self) -> list[float]:
        """Spacings of the lattices that carry the conditions [Å]."""
        return [asked.classes.spacing for asked in self.conditions]

    def losses(self, name: str) -> list[ReducedLoss] | list[FullLoss]:
        """What is minimised under the name of a loss (see choose_loss)."""
        if self.added and name != "residual":
            return [corrected(grid, R) for grid, R in zip(self.grids, self.added)]
        return self.grids or self.full

    def errors(self, *numbers: object) -> float:
        """E_res over all samples at λ, μ, α, D."""
        return float(np.concatenate([loss.errors(*numbers) for loss in self.full]).mean())


def training_data(
    samples: Samples | Sequence[Samples],
    horizon: float,
    conditions: Conditions,
    *,
    noise: Samples | Sequence[Samples] | None,
    normalise: bool,
    lattice_spacing: float | None,
) -> TrainingData:
    """Check the sets and make everything that is computed of them once.

    Args:
        samples: one training set or several, all on lattices or not.
        horizon: δ [Å].
        conditions: to keep on each lattice.
        noise: fields of noise alone on the nodes of each.
        normalise: divide each sample by ‖b‖ in the residual.
        lattice_spacing: of the lattice that carries the conditions for scattered points [Å]; None
            where the method has none.

    Raises InputError for sets that cannot be learned from.
    """
    sets = listed(samples)
    if not sets:
        raise InputError("points: expected at least one training set, got none")
    weights = sample_weights(sets, normalise=normalise)
    full = [FullLoss(each, horizon, weight) for each, weight in zip(sets, weights)]
    grids, unloaded = [], listed(noise, "noise")
    if all(each.spacing > 0 for each in sets):
        if lattice_spacing is not None:
            raise InputError("lattice_spacing: only for scattered points")
        grids = [reduce(each, horizon, weight) for each, weight in zip(sets, weights)]
        spacings = [each.spacing for each in sets]
    else:
        spacings = [lattice_spacing or 0.0]
    asked = [LatticeConditions(bond_classes(h, horizon), conditions) for h in spacings]
    if unloaded and not grids:
        raise InputError("noise: fields of noise are for lattices; scattered points take none")
    if unloaded and len(unloaded) != len(sets):
        raise InputError(f"noise: expected {len(sets)} sets, got {len(unloaded)}")
    added = [
        noise_loss(fields, points, horizon, weight)
        for fields, points, weight in zip(unloaded, sets, weights)
    ]
    return TrainingData(sets, horizon, full, grids, asked, unloaded, added)


def listed(
    samples: Samples | Dataset | Sequence[Samples] | None,
    name: str = "samples",
    *,
    space: bool = False,
) -> list[Samples]:
    """One set, several or none as a list; of a data set the one called train, or the only one.

    Sets in space are for those who ask for them.

    Raises InputError, which begins with the name, for anything else.
    """
    if samples is None:
        return []
    if isinstance(samples, Dataset):
        samples = samples.obvious("train")
    sets = [samples] if isinstance(samples, Samples) else samples
    if not isinstance(sets, Sequence) or not all(isinstance(each, Samples) for each in sets):
        raise InputError(
            f"{name}: expected Samples (nodes with u and b), or a list of them, got "
            f"{type(samples).__name__}"
        )
    if not space and any(each.points.dimension != 2 for each in sets):
        raise InputError(f"{name}: expected a sheet; in space LPS and Micromodulus are learned")
    return list(sets)


RELATIVE_ZETA = 0.0161
"""ζ over the stiffness that the data show, where none was asked for: 0.0100 TPa on graphene."""
USUAL_STIFFNESS = 0.6212640458
"""A stiffness [TPa] that the search's own numbers suit: that which graphene's data show."""
PROBED_HORIZON = 2.0
"""Horizon in spacings of the bond-based solid that a lattice's stiffness is measured with."""
UNIT = Solid(1.0, 1.0, 1.0, np.ones(1))
"""K = 1/r with λ = μ = 1."""


@dataclass(frozen=True)
class Scale:
    """Units of a fit.

    Attributes:
        length, stress: of the fit, in the units of the data.
        stiffness: that the data show, in their unit of stress.
        units: names of the units of the data.
    """

    length: float
    stress: float
    stiffness: float
    units: Units = USUAL

    def samples(self, given: Samples) -> Samples:
        """The samples in these units."""
        return in_units_of(scaled(given, 1 / self.length, 1 / self.stress), USUAL)

    def conditions(self, asked: Conditions) -> Conditions:
        """The conditions with their ζ [TPa]: that of the stiffness, where none was asked for."""
        return dataclasses.replace(asked, zeta=self._zeta(asked))

    def inner_conditions(self, asked: Conditions) -> Conditions:
        """The conditions in these units."""
        return dataclasses.replace(asked, zeta=self._zeta(asked) / self.stress)

    def _zeta(self, asked: Conditions) -> float:
        return RELATIVE_ZETA * self.stiffness if asked.zeta is None else asked.zeta

    def method(self, given: Method) -> Method:
        """The method with its lengths and moduli in these units."""
        if isinstance(given, Constrained):
            return dataclasses.replace(given, optimum=self._optimum(given.optimum))
        return self._two_stage(given) if isinstance(given, TwoStage) else self._optimum(given)

    def _two_stage(self, given: TwoStage) -> TwoStage:
        spacing = given.lattice_spacing
        inner = None if spacing is None else spacing / self.length
        return dataclasses.replace(given, lattice_spacing=inner)

    def _optimum(self, given: Optimum) -> Optimum:
        return dataclasses.replace(given, moduli=self.moduli(given.moduli))

    def moduli(
        self, held: tuple[float, float] | str | None, *, back: bool = False
    ) -> tuple[float, float] | str | None:
        """Moduli to be held, in these units; `back` from them to those of the data."""
        if held is None or isinstance(held, str):
            return held
        unit = 1 / self.stress if back else self.stress
        return held[0] / unit, held[1] / unit

    def lattice_conditions(self, data: TrainingData, horizon: float) -> list[LatticeConditions]:
        """The conditions of training data in these units, in those of the data."""
        return [
            LatticeConditions(
                bond_classes(lattice.classes.spacing * self.length, horizon),
                dataclasses.replace(lattice.asked, zeta=lattice.zeta * self.stress),
            )
            for lattice in data.conditions
        ]

    def parameters(self, parameters: Parameters) -> Parameters:
        """What was found in these units, in those of the data."""
        return dataclasses.replace(
            parameters, lam=parameters.lam * self.stress, mu=parameters.mu * self.stress
        )


def scale_of(
    sets: Sequence[Samples], horizon: float, *, lengths: bool, steps: bool = True
) -> Scale:
    """The units of a fit to these samples.

    Args:
        sets: training sets.
        horizon: δ [Å].
        lengths: whether lengths may be scaled; those of a shape's own parameters are the user's.
        steps: whether stress goes in powers of 2. Adam, which ends on its way, shows what is left.

    Raises InputError as stiffness_of does.
    """
    stiffness = stiffness_of(sets, horizon)
    units = sets[0].points.units
    length = search_length(units, horizon) if lengths and 0 < horizon < np.inf else 1.0
    stress = stiffness / USUAL_STIFFNESS
    if steps:
        stress = search_unit(units[1], stiffness, USUAL_STIFFNESS, 4)
    return Scale(length, stress, stiffness, units)


def stiffness_of(sets: Sequence[Samples], horizon: float) -> float:
    """The stiffness that loads and displacements show together [TPa].

    That of the bond-based solid, K = 1/r, whose loads have the given work with the loads: ‖b‖² over
    b·A u, A of unit stiffness. Noise in u, which b knows nothing of, averages out of it.

    Raises InputError where it is not above zero: loads and displacements of opposite work.
    """
    if not sets:
        raise InputError("points: expected at least one training set, got none")
    large_b = max(
        float(np.abs(samples.loads[:, samples.interior]).max(initial=0.0)) for samples in sets
    )
    large_u = max(float(np.abs(samples.u).max(initial=0.0)) for samples in sets)
    loads = work = 0.0
    if large_b > 0 and large_u > 0:
        for samples in sets:
            reach = (
                min(PROBED_HORIZON * samples.spacing, horizon) if samples.spacing > 0 else horizon
            )
            bonds = Bonds(samples.points, reach, bond_based=True)
            force = lps_force(bonds, torch.from_numpy(samples.u / large_u), UNIT).numpy()
            b = samples.loads[:, samples.interior] / large_b
            loads, work = loads + float((b**2).sum()), work + float((force * b).sum())
    if not work > 0:
        raise InputError(
            "u, b: loads and displacements do work of opposite sign, or none, and no solid answers "
            "loads so; expected b to be the load, which is minus the internal force"
        )
    return large_b / large_u * loads / work


def scaled_data(
    sets: Sequence[Samples],
    horizon: float,
    conditions: Conditions,
    noise: Sequence[Samples],
    lattice_spacing: float | None,
    *,
    normalise: bool,
    lengths: bool,
    steps: bool,
) -> tuple[TrainingData, Scale]:
    """Training data in the units of a fit, and these units; see training_data and scale_of."""

    def made(scale: Scale | None) -> TrainingData:
        length = 1.0 if scale is None else scale.length
        return training_data(
            [samples if scale is None else scale.samples(samples) for samples in sets],
            horizon / length,
            conditions if scale is None else scale.inner_conditions(conditions),
            noise=[samples if scale is None else scale.samples(samples) for samples in noise],
            normalise=normalise,
            lattice_spacing=None if lattice_spacing is None else lattice_spacing / length,
        )

    named = {" and ".join(check_units(each.points.units)) for each in (*sets, *noise)}
    if len(named) > 1:
        raise InputError(f"units: expected the same for all sets, got {', '.join(sorted(named))}")
    try:
        scale = scale_of(sets, horizon, lengths=lengths, steps=steps)
    except InputError:
        made(None)  # what is wrong with the sets themselves comes first
        raise
    try:
        return dataclasses.replace(made(scale), stress=scale.stress), scale
    except InputError:
        made(None)  # the same refusal, with the user's own numbers
        raise


ROUNDING = 1e-13
"""Of a residual, relative to the loads: what is left of an exact fit."""
EPSILON = float(np.finfo(float).eps)
SAFETY = 100.0
"""Times what rounding does: a backward error is an estimate, and processors differ in it."""
MATTERS = 1e-6
"""Relative departure that no rounding explains and that an answer would show."""


class ConsistencyCheck:
    """Holds the reduced loss to the full one, and to its gradients."""

    def __init__(self, grids: Sequence[ReducedLoss], full: Sequence[FullLoss]) -> None:
        self.grids, self.full = grids, full
        self.gradient_size: float | None = None

    def check(self, parameters: Parameters) -> None:
        """Compare at one point, on lattices; the first one sets the size of the gradient.

        Warns where they differ by more than SAFETY times what rounding of every parameter does.
        Raises RuntimeError where that is more than MATTERS of the loss or of the gradient as well.
        """
        if not self.grids:
            return
        variables = Variables(parameters, positive=False, parametrisation="projected")
        sizes = self._sizes(parameters)
        results = []
        for loss in (
            variables.loss(self.grids),
            torch.stack([term.loss(*variables.leaves) for term in self.full]).sum(),
        ):
            parts = torch.autograd.grad(loss, variables.leaves)
            gradient = torch.cat([part.reshape(-1) for part in parts]) * sizes
            results.append((loss.item(), gradient))
        (reduced, gradient), (expected, reference) = results
        size = self.gradient_size = self.gradient_size or float(reference.norm())
        by_loss, by_gradient = self._rounding(parameters, reference / sizes, sizes)
        by_loss += EPSILON * expected + ROUNDING * np.sqrt(expected) + ROUNDING**2
        held("loss", abs(reduced - expected), by_loss, expected)
        apart = float((gradient - reference).norm())
        terms = sum(term.u.numel() for term in self.full)  # that are added up
        held("gradient", apart, EPSILON * np.sqrt(terms) * size + by_gradient, size)

    def _sizes(self, parameters: Parameters) -> torch.Tensor:
        """Units that derivatives are compared in, one for each parameter.

        λ and μ by μ; D by that of a weighted volume of D = 1, since its scale has no effect.
        """
        D, mu = parameters.D, parameters.mu
        sizes = [mu, mu, 1.0] + len(D) * [self._volume(parameters.alpha, D)]
        return torch.tensor(sizes, dtype=torch.float64)

    def _rounding(
        self, parameters: Parameters, gradient: torch.Tensor, sizes: torch.Tensor
    ) -> tuple[float, float]:
        """What relative rounding of every parameter does to the loss and to its gradient.

        Terms D_k B_k of either sign cancel in K; the sums lose as much as D itself would.
        """
        variables = Variables(parameters, positive=False, parametrisation="projected")
        numbers = [leaf.detach() for leaf in variables.leaves]
        flat = torch.cat([number.reshape(-1) for number in numbers])

        def loss(flat: torch.Tensor) -> torch.Tensor:
            parts = flat.split([number.numel() for number in numbers])
            shaped = [part.reshape(number.shape) for part, number in zip(parts, numbers)]
            return torch.stack([grid.loss(*shaped) for grid in self.grids]).sum()

        bend = torch.autograd.functional.hessian(loss, flat)
        by_gradient = (sizes[:, None] * bend * flat).norm()
        return EPSILON * float((gradient * flat).norm()), EPSILON * float(by_gradient)

    def _volume(self, alpha: float, D: np.ndarray) -> float:
        """Weighted volume of a kernel over that of K = r^(−α)."""
        classes = self.grids[0].classes
        terms = classes.count * classes.weight * classes.r ** (2 - alpha)
        basis = bernstein_basis(classes.r, classes.horizon, len(D) - 1)
        return float(abs(terms @ (basis @ D)) / terms.sum())


def held(name: str, departure: float, rounding: float, size: float) -> None:
    """Warn of what rounding does not explain, and end what an answer would show.

    Args:
        name: of what was computed twice.
        departure: of the two.
        rounding: backward error of the computation.
        size: of what was computed.

    Raises RuntimeError for a departure beyond SAFETY times the rounding and MATTERS of the size.
    """
    if departure <= SAFETY * rounding:
        return
    text = (
        f"the reduced {name} departs from the full one by {departure:.1e} of {size:.1e}; rounding "
        f"accounts for some {rounding:.1e}"
    )
    if not departure <= MATTERS * size:
        raise RuntimeError(text)
    warnings.warn(text, stacklevel=2)
