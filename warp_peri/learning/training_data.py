"""The training sets of a fit, made ready once: full losses, reduced ones, conditions, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.regression.conditions import Conditions, LatticeConditions
from warp_peri.regression.full import FullLoss, sample_weights
from warp_peri.regression.noise import corrected, noise_loss
from warp_peri.regression.reduced import ReducedLoss, reduce


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
    elif lattice_spacing is not None:
        spacings = [lattice_spacing]
    else:
        raise InputError(
            "points: scattered points need method=TwoStage(lattice_spacing=…) with constraints "
            "'symbol', and a spacing whose symbol keeps the conditions"
        )
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
