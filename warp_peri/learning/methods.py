"""How a model is learned: what each method is asked for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from warp_peri.errors import InputError
from warp_peri.learning import METHODS
from warp_peri.materials.influence import InfluenceFunction
from warp_peri.points.arrays import check_whole
from warp_peri.regression.settings import Optimum

PARAMETRISATIONS = ("projected", "relu")
CONSTRAINTS = ("symbol", "dense")


@dataclass(frozen=True)
class Bernstein:
    """The influence function K(r) = r^(−α) Σ_k D_k B_k,M(r/δ) of any sign (theory, 4).

    Attributes:
        degree: M ≥ 0.

    Raises InputError for a degree that is none.

    >>> wp.fit(samples, wp.LPS(12.5, wp.Bernstein(2))).material.D.shape
    (3,)
    """

    degree: int = 10

    def __post_init__(self) -> None:
        check_whole("degree", self.degree, 0)


Kernel: TypeAlias = Bernstein | InfluenceFunction | Sequence[InfluenceFunction]


@dataclass(frozen=True)
class TwoStage:
    """Algorithm 1 of You et al. (2021): Adam on positive kernels, then an augmented Lagrangian.

    Attributes:
        parametrisation: "projected" or, as printed, "relu"; see Variables.
        constraints: of stage 2, "symbol" (over the zone) or, as printed and far slower, "dense"
            (eigenvalues on the training domain).
        seed: of the initial D of stage 1.
        checkpoint: file that stage 2 keeps its state in and goes on from.
        lattice_spacing: for training sets of scattered points, which have no symbol: spacing [Å]
            of the lattice on which the conditions are kept.
        epochs: most epochs of stage 1; the paper's loss stagnates between 1000 and 2000.
        inner_epochs: most epochs of each round of stage 2.
        outer_iterations: most rounds of stage 2.

    Raises InputError for a choice or a number that is none.
    """

    parametrisation: str = "projected"
    constraints: str = "symbol"
    seed: int = 0
    checkpoint: str | os.PathLike[str] | None = None
    lattice_spacing: float | None = None
    epochs: int = 4000
    inner_epochs: int = 500
    outer_iterations: int = 20

    def __post_init__(self) -> None:
        for name, known in (("parametrisation", PARAMETRISATIONS), ("constraints", CONSTRAINTS)):
            if getattr(self, name) not in known:
                raise InputError(
                    f"{name}: expected one of {', '.join(known)}, got {getattr(self, name)!r}"
                )
        for name in ("seed", "epochs", "inner_epochs", "outer_iterations"):
            check_whole(name, getattr(self, name), 0)
        if self.lattice_spacing is not None and self.constraints == "dense":
            raise InputError("lattice_spacing: goes with constraints='symbol', got 'dense'")


@dataclass(frozen=True)
class Constrained:
    """Adam and an augmented Lagrangian to the constrained optimum, which Optimum then checks.

    Unlike Algorithm 1 in coordinates that suit its steps (theory, 28b), so that it arrives.

    Attributes:
        seed: of the initial D.
        steps: of Adam in a round.
        rounds: most rounds.
        optimum: settings of the check, which goes on from there and from plain kernels.

    Raises InputError for a number that is none.
    """

    seed: int = 0
    steps: int = 100
    rounds: int = 60
    optimum: Optimum = field(default_factory=Optimum)

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("steps", 1), ("rounds", 1)):
            check_whole(name, getattr(self, name), least)


Method: TypeAlias = TwoStage | Optimum | Constrained


def named(name: str, **settings: Any) -> Method:
    """A method by the name it has on the command line; `seed` is of its initial D."""
    if name not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got {name!r}")
    if name == "optimum":
        return Optimum()
    return TwoStage(**settings) if name == "two-stage" else Constrained(**settings)
