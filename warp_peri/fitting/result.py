"""What a fit returns: the material, what is proven of it, and the way to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from warp_peri.points.unit_names import shown_moduli
from warp_peri.reprs import Shown

if TYPE_CHECKING:
    from warp_peri.materials.influence import InfluenceFunction
    from warp_peri.materials.lps import LPSParameters


@dataclass(frozen=True)
class LossSelection:
    """A loss and, in words, why it was taken."""

    name: str
    reason: str

    def __str__(self) -> str:
        return f"{self.name} ({self.reason})"


@dataclass(frozen=True)
class Stage:
    """One stage of a fit: its result, E_res on the training set, and how long it took.

    `loss` is the trace of the loss: by epoch, or round of cuts; `steps` counts gradients of Warp's
    operator in stages of Adam, starts in stage 3.
    """

    name: str
    parameters: LPSParameters
    E_res_train: float
    seconds: float
    loss: list[float] = field(repr=False)
    steps: int = 0


@dataclass(frozen=True, repr=False)
class Fit(Shown):
    """A learned material and how it was learned; the last lines are for an LPS.

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

    def rows(self) -> list[tuple[str, str]]:
        """What to know of a fit at a glance: name and value."""
        rows: list[tuple[str, str]] = self.material.rows()
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
