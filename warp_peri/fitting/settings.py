"""What a fit is given (sets, kernel, method, conditions), and its result."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from warp_peri.errors import InputError, Shown
from warp_peri.points.arguments import Count, Natural, NotNegative, Positive, typed
from warp_peri.points.dataset import Dataset
from warp_peri.points.points import Samples
from warp_peri.points.unit_names import shown_moduli
from warp_peri.protocols import LINEAR, offered, placed

if TYPE_CHECKING:
    from warp_peri.materials.influence import InfluenceFunction
    from warp_peri.materials.lps import LPSParameters

HORIZONS = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0)
"""Horizons δ that `sweep` tries [Å] (You et al. 2021, section 6.2)."""
DEGREES = (0, 5, 10, 15, 20)
"""Degrees M that `sweep` tries (You et al. 2021, section 6.2)."""
ISOTROPIC, LONG_WAVES = "isotropic", "long waves"
SMOOTHNESS = 1e-10
"""Weight of the second differences of D beside the relative residual. It costs an ordinary fit
nothing that can be seen, and keeps D from growing until its terms cancel to the last digit."""


@typed
@dataclass(frozen=True)
class Bernstein:
    """Influence function K(r) = r^(−α) Σ_k D_k B_k,M(r/δ) of any sign (theory, 4).

    Attributes:
        degree: M ≥ 0.

    Raises InputError for a degree that is none.

    >>> wp.fit(samples, wp.LPS(12.5, wp.Bernstein(2))).material.D.shape
    (3,)
    """

    degree: Natural = 10


Kernel: TypeAlias = "Bernstein | InfluenceFunction | Sequence[InfluenceFunction]"


@typed
@dataclass(frozen=True)
class StabilityConditions:
    """Stability conditions that a fit must keep on every lattice.

    Attributes:
        kind: "direct", D(k) ≥ ζ s(k); "paper" asks for (i) and (iii) of (4.6) besides.
        zeta: ζ [TPa]; None takes 0.0161 of the stiffness that the data of a fit show, which is
            0.0100 TPa on graphene.

    Raises InputError for another kind, or a ζ that is not above zero.
    """

    kind: Literal["direct", "paper"] = "direct"
    zeta: Positive | None = None

    @property
    def level(self) -> float:
        """Level ζ [stress]; InputError where none is given, for it is a part of a stiffness."""
        if self.zeta is None:
            raise InputError("zeta: expected a stiffness > 0, a small part of the shear modulus")
        return self.zeta

    def forms(self, kappa: Any, mu: Any, level: float) -> list[tuple[Any, float]]:
        """Coefficient κ of each stability condition's form Γ + κφφᵗ, and its level."""
        forms = [(kappa, level)]
        if self.kind == "paper":  # Σ w r² = 1
            forms += [(0 * kappa, level), (-2 / mu, 0.0)]
        return forms


@typed
@dataclass(frozen=True)
class GaussNewton:
    """Fit method: the constrained optimum of the loss (theory, 26–28), from plain kernels r^(−α).

    Attributes:
        moduli: (λ, μ) [TPa] to hold at long waves on every lattice (8 Σ w ξ₁²ξ₂²/r² = 1 makes them
            the moduli of the discrete operator); "isotropic" holds that condition and learns λ and
            μ; None learns them freely. "long waves" holds those that the long waves of the samples
            show (theory, 28a), where free ones are two standard errors away.
        rounds: most rounds of cutting planes.
        smoothness: weight η of the second differences of D beside the relative residual (28).

    Raises InputError for moduli that no solid has.
    """

    moduli: tuple[float, float] | str | None = LONG_WAVES
    rounds: Count = 40
    smoothness: NotNegative = SMOOTHNESS

    def __post_init__(self) -> None:
        named = isinstance(self.moduli, str)
        if self.moduli is None or (named and self.moduli in (ISOTROPIC, LONG_WAVES)):
            return
        try:
            lam, mu = map(float, () if named else self.moduli)
        except (TypeError, ValueError):
            lam = mu = np.nan
        if not (np.isfinite(lam + mu) and mu > 0 and lam + mu > 0):
            raise InputError(
                f"moduli: expected (λ, μ) with μ > 0, λ + μ > 0, {ISOTROPIC!r} or "
                f"{LONG_WAVES!r}, got {self.moduli!r:.60}"
            )
        object.__setattr__(self, "moduli", (lam, mu))  # of a list or an array too

    @property
    def held(self) -> tuple[float, float] | str | None:
        """Moduli that a search holds by itself; those of long waves are found before it."""
        return None if self.moduli == LONG_WAVES else self.moduli


@typed
@dataclass(frozen=True)
class TwoStage:
    """Fit method: Algorithm 1 of You et al. (2021) as printed, Adam on positive kernels, then an
    augmented Lagrangian that holds the eigenvalues (4.6) of the training domain.

    Attributes:
        seed: of the initial constants and D.
        checkpoint: file that stage 2 keeps its state in and goes on from.
        epochs: most epochs of stage 1; the paper's loss stagnates between 1000 and 2000.
        inner_epochs: most epochs of each round of stage 2.
        outer_iterations: most rounds of stage 2; the paper has a hundred.

    Raises InputError for a number that is none.
    """

    seed: Natural = 0
    checkpoint: str | os.PathLike[str] | None = None
    epochs: Natural = 4000
    inner_epochs: Natural = 500
    outer_iterations: Natural = 20


@typed
@dataclass(frozen=True)
class AugmentedLagrangian:
    """Fit method: Adam and an augmented Lagrangian to the optimum, which GaussNewton then checks.

    Unlike Algorithm 1 in coordinates that suit its steps (theory, 28b), so that it arrives.

    Attributes:
        seed: of the initial D.
        steps: of Adam in a round.
        rounds: most rounds.
        optimum: settings of the check, which goes on from there and from plain kernels.

    Raises InputError for a number that is none.
    """

    seed: Natural = 0
    steps: Count = 100
    rounds: Count = 60
    optimum: GaussNewton = field(default_factory=GaussNewton)


Method: TypeAlias = TwoStage | GaussNewton | AugmentedLagrangian


METHODS = {"optimum": GaussNewton, "two-stage": TwoStage, "constrained": AugmentedLagrangian}
"""Fit methods by their names in a shell."""


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
    """A learned material and how it was learned; the last four lines are for an LPS.

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
        """Name and value of each line of the fit's summary table."""
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


def listed(
    samples: Samples | Dataset | Sequence[Samples] | None, name: str = "samples"
) -> list[Samples]:
    """One set, several or none as a list; of a Dataset `train`, or its only set; InputError, which
    begins with the name, for anything else."""
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
    return list(sets)


def check_noise(noise: Samples, points: Samples) -> None:
    """Raise InputError for noise on other nodes than its training set's."""
    if len(noise) == 0:
        raise InputError("noise: expected at least one field, got none")
    mine, its = points.points, noise.points
    if its.units != mine.units:
        raise InputError(
            f"units: expected the same for all sets, got {its.units} of noise and {mine.units}"
        )
    near = its.x.shape == mine.x.shape and np.allclose(its.x, mine.x, 0, 1e-6 * mine.spacing)
    if not (near and np.array_equal(its.interior, mine.interior)):
        raise InputError(
            f"noise: expected the {len(mine.x)} nodes of the training set, got {len(its.x)} others"
        )


LOUD = 0.1
"""A residual above which a solid does not describe the data."""


def left_by(material: Any, samples: Samples, verb: str) -> tuple[Any, np.ndarray, float]:
    """Operator of a solid, or of a material with a linear part, on a set; what it leaves of the
    loads on the interior, [S, I, d]; and ‖L u − b‖ / ‖b‖. InputError without either."""
    law, b = getattr(material, "model", material), samples.loads[:, samples.interior]
    known = offered(getattr(law, "linear", law), "stencil", verb, LINEAR)
    if not b.any():
        raise InputError("samples: expected loads on their interior, got none")
    free = callable(known) or hasattr(law, "linear")
    loose: dict[str, Any] = {"allow_uncertified": True} if free else {}
    operator = placed(material, samples.points, verb=verb, **loose)
    left = b - operator(samples.u)
    return operator, left, float(np.linalg.norm(left) / np.linalg.norm(b))
