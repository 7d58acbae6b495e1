"""What a fit returns: the model, the stages on the way to it, and what was asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

from warp_peri.learning.loss_choice import LossChoice
from warp_peri.models.lps import Model
from warp_peri.models.shapes import InfluenceFunction
from warp_peri.regression.parameters import Parameters
from warp_peri.stability.certificate import Certificate
from warp_peri.stability.conditions import LatticeConditions


@dataclass(frozen=True)
class Stage:
    """One stage of a fit: its result, E_res on the training set, and how long it took.

    `loss` is the trace of the reduced loss: by epoch (stages 1, 2) or round of cuts (stage 3).
    """

    name: str
    parameters: Parameters
    E_res_train: float
    seconds: float
    loss: list[float] = field(repr=False)


@dataclass(frozen=True)
class Settings:
    """What a fit was asked for: conditions on each lattice, and what bears on its uncertainty."""

    conditions: list[LatticeConditions]
    normalise: bool
    two_functions: bool
    moduli: tuple[float, float] | str | None


@dataclass(frozen=True)
class Fit:
    """A learned model and how it was learned.

    Attributes:
        model: the model; certified for the training spacing if its certificate holds.
        certificates: the certificate on each training lattice.
        moduli: long-wave moduli C11, C12, C44 of the discrete operator on each of them [TPa].
        history: the stages, in order.
        starts: E of stage 3 by start, the square root of its relative loss; empty when not run.
        loss: which loss was minimised, and why.
        settings: what was asked for.
        influence: the influence function with its learned parameters, where one was given.
    """

    model: Model
    certificates: list[Certificate]
    moduli: list[dict[str, float]]
    history: list[Stage]
    starts: dict[str, float]
    loss: LossChoice
    settings: Settings
    influence: InfluenceFunction | None = None

    @property
    def certificate(self) -> Certificate:
        """The certificate on the first training lattice."""
        return self.certificates[0]
