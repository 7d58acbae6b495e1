"""What a fit results in, and what its material leaves of the loads."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray
from numpy.linalg import norm

from warp_peri.errors import InputError, Rows, Shown
from warp_peri.points.arguments import LINEAR, offered, shown_moduli
from warp_peri.points.points import Samples
from warp_peri.protocols import placed

if TYPE_CHECKING:
    from warp_peri.materials.influence import InfluenceFunction
    from warp_peri.materials.lps import LPSParameters


@dataclass(frozen=True)
class LossSelection:
    """The selected loss and, in words, why it was taken."""

    name: str
    reason: str

    def __str__(self) -> str:
        return f"{self.name} ({self.reason})"


@dataclass(frozen=True)
class Stage:
    """One stage of a fit: its result, E_res on the training set, and seconds. `loss` is its trace
    by epoch or round of cuts; `steps` counts gradients in Adam, starts in stage 3."""

    name: str
    parameters: LPSParameters
    E_res_train: float
    seconds: float
    loss: list[float] = field(repr=False)
    steps: int = 0


@dataclass(frozen=True, repr=False)
class Fit(Shown):
    """A learned material and how it was learned; from `moduli` to `influence` for an LPS.

    Attributes:
        material: the model.
        certificate: what is proven of it, or of its linear part, on the first training lattice.
        errors: E_res, the mean relative residual on the training samples, where it is known.
        history: of an LPS the stages, in order; of others losses and numbers on the way, by name.
        law: what was asked for, with the kernel, the conditions and the method as they were taken.
        loss: which loss was minimised, and why, where there was a choice.
        moduli: long-wave moduli C11, C12, C44 of the discrete operator on each lattice [stress].
        starts: E of stage 3 by start, the square root of its relative loss; empty when not run.
        degrees: relative residual of loads left out, by degree, where no kernel was asked for.
        influence: the influence function with its learned parameters, where one was given.
        left: largest ‖L u − b‖/‖b‖ of a training set, by its weights; 0 where it is not known.
    """

    material: Any
    certificate: Any
    errors: dict[str, float]
    history: Any
    law: Any = None
    loss: LossSelection = LossSelection("residual", "")
    moduli: list[dict[str, float]] = field(default_factory=list)
    starts: dict[str, float] = field(default_factory=dict)
    degrees: dict[int, float] = field(default_factory=dict)
    influence: InfluenceFunction | None = None
    left: float = 0.0

    def rows(self) -> Rows:
        rows: Rows = self.material.rows()
        for constants in self.moduli[:1]:
            held = "" if self.law.method.moduli is None else ", held"
            told = shown_moduli(self.material.units, constants.values())
            rows.append(("C11, C12, C44", told + held))
        if self.degrees:
            left = (f"{100 * error:.3g} % by {M}" for M, error in self.degrees.items())
            rows.append(("loads left out", f"{', '.join(left)}: the degree is the least as good"))
        for error in self.errors.values():
            rows.append(("residual", f"{100 * error:.3g} % of the training loads"))
        return rows + ([("loss", f"{self.loss}")] if self.loss.reason else [])


ROUNDED = 1e-9
"""Of the largest load, that is none."""


def check_noise(noise: Samples, points: Samples) -> None:
    """Raise InputError for noise on other nodes than its training set's, and for loaded fields."""
    if len(noise) == 0:
        raise InputError("noise: expected at least one field, got none")
    mine, its = points.points, noise.points
    near = its.x.shape == mine.x.shape and np.allclose(its.x, mine.x, 0, 1e-6 * mine.spacing)
    if its.units != mine.units or not (near and np.array_equal(its.interior, mine.interior)):
        raise InputError(
            f"noise: expected the {len(mine.x)} nodes of the training set in units {mine.units}, "
            f"got {len(its.x)} others in {its.units}"
        )
    loads = 0.0 if noise.b is None else np.abs(noise.b[:, its.interior]).max()
    if loads > ROUNDED * np.abs(points.loads).max(initial=0.0):
        raise InputError("noise: expected displacements of the unloaded body, got loads")


LOUD = 0.1
"""A residual above which a solid does not describe the data."""


def left_by(material: Any, samples: Samples, verb: str) -> tuple[Any, ndarray, float]:
    """Operator of a solid, or of a material with a linear part, on a set; what it leaves of the
    loads on the interior, [S, I, d]; and ‖L u − b‖ / ‖b‖. InputError without either."""
    law, b = getattr(material, "model", material), samples.loads[:, samples.interior]
    known = offered(getattr(law, "linear", law), "stencil", verb, LINEAR)
    if not b.any():
        raise InputError("samples: expected loads on their interior, got none")
    free = callable(known) or hasattr(law, "linear")
    operator = placed(material, samples.points, verb=verb, allow_uncertified=free)
    left = b - operator(samples.u)
    return operator, left, float(norm(left) / norm(b))
