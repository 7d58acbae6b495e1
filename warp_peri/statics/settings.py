"""How a static problem is solved, where the caller chooses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from warp_peri.errors import InputError
from warp_peri.launch import DEVICE
from warp_peri.points.arrays import is_number
from warp_peri.points.quadrature import DEGREE
from warp_peri.statics.dirichlet import PRECONDITIONERS
from warp_peri.statics.equilibrium import TOLERANCE


@dataclass(frozen=True)
class Direct:
    """A factorisation of the assembled operator.

    Attributes:
        iterative: GMRES with an incomplete factorisation, for many scattered points.
        quadrature_degree: of the polynomials that the weights are exact for.
    """

    iterative: bool = False
    quadrature_degree: int = DEGREE

    @property
    def method(self) -> str:
        """Its name in records."""
        return "gmres" if self.iterative else "lu"


@dataclass(frozen=True)
class Krylov:
    """Conjugate gradients on a lattice.

    Attributes:
        preconditioner: "sine" for rectangles, "multigrid" for any nodes, "strip" where λ ≫ μ;
            "fft", the inverse symbol, and "cg", none, are there to compare. None chooses.
        tolerance: true residual over right-hand side.
        device: where they run, as Warp names it.

    Raises InputError for another preconditioner, or a tolerance outside (0, 1).
    """

    preconditioner: str | None = None
    tolerance: float = TOLERANCE
    device: str = DEVICE

    def __post_init__(self) -> None:
        if self.preconditioner is not None and self.preconditioner not in PRECONDITIONERS:
            known = ", ".join(PRECONDITIONERS)
            raise InputError(f"preconditioner: expected {known}, got {self.preconditioner!r}")
        check_tolerance(self.tolerance)


@dataclass(frozen=True)
class Newton:
    """Repeated linear solves, then Newton's method, for laws that are not linear.

    Attributes:
        tolerance: residual over the linear right-hand side.
        eigenvalues: whether the smallest eigenvalue of the tangent is asked for at each answer.

    Raises InputError for a tolerance outside (0, 1).
    """

    tolerance: float = TOLERANCE
    eigenvalues: bool = False

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance)


Solver: TypeAlias = Direct | Krylov | Newton | None


def check_tolerance(value: float) -> None:
    """Raise InputError for what is no share of a residual."""
    if not (is_number(value) and 0 < value < 1):
        raise InputError(f"tolerance: expected a number between 0 and 1, got {value!r}")


def refuse_solver(solver: Solver, known: tuple[type, ...], law: str) -> None:
    """Raise InputError for settings of a solver that does not go with a law."""
    if solver is not None and not isinstance(solver, known):
        names = " or ".join(f"{kind.__name__}(…)" for kind in known) or "none"
        raise InputError(f"solver: expected {names} for {law}, got {solver!r:.60}")
