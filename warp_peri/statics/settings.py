"""How a static problem is solved, where the caller chooses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number
from warp_peri.points.quadrature import DEGREE

TOLERANCE = 1e-8
"""Of iterative solves: true residual over right-hand side."""
PRECONDITIONERS = ("multigrid", "sine", "strip")
"""Of conjugate gradients on lattices, by name."""
PETSC = "petsc"
"""On ranks alone: multigrid whose coarse problem PETSc solves."""


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
        preconditioner: "sine" for boxes of nodes, "multigrid" for any nodes, "strip" where λ ≫ μ;
            None chooses. On ranks "multigrid", or "petsc" for a coarse problem by PETSc
            (docs/ranks.md).
        tolerance: true residual over right-hand side.

    Raises InputError for another preconditioner, or a tolerance outside (0, 1).
    """

    preconditioner: str | None = None
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        if self.preconditioner not in (None, *PRECONDITIONERS, PETSC):
            known = ", ".join(PRECONDITIONERS)
            raise InputError(
                f"preconditioner: expected {known}, or {PETSC} on ranks, got "
                f"{self.preconditioner!r}"
            )
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


@dataclass(frozen=True, eq=False)
class PolakRibiere:
    """Conjugate directions with secant steps, which ask a law for its force alone: any law's.

    Solutions say nothing of what is proven, nor of strains beyond the data; the law's own do.

    Attributes:
        tolerance: residual over that of the collar's displacement alone.
        most: steps of a sample, each of two forces.
        start: displacement [length] that the search begins at, shape [N, d] or [S, N, d], of which
            interior values count; "previous", the answer of the sample before; None for zero.

    Raises InputError for a tolerance outside (0, 1), `most` below 1, and another word.
    """

    tolerance: float = TOLERANCE
    most: int = 1000
    start: Any = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance)
        if not (is_number(self.most) and self.most == int(self.most) >= 1):
            raise InputError(f"most: expected a whole number ≥ 1, got {self.most!r}")
        if isinstance(self.start, str) and self.start != "previous":
            raise InputError(f"start: expected 'previous' or a displacement, got {self.start!r}")


@dataclass(frozen=True)
class Coupling:
    """How rim and bulk meet.

    Attributes:
        spacing: of the bulk's lattice [Å]; None for the coarsest that resolves loads and body.
        overlap: width of what both solve for [Å]; None for two horizons, of a crystal four
            spacings.
        degree: 2 for quadratic elements, curved at the outline; 1 for linear ones.
        tolerance: of the mismatch on the rim's inner side.

    Raises InputError for lengths that are not > 0, another degree, or a tolerance outside (0, 1).
    """

    spacing: float | None = None
    overlap: float | None = None
    degree: int = 2
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        for name, expected, value, largest in (
            ("spacing", "a lattice spacing > 0", self.spacing, np.inf),
            ("overlap", "a length > 0", self.overlap, np.inf),
            ("tolerance", "a number between 0 and 1", self.tolerance, 1.0),
        ):
            if value is not None and not (is_number(value) and 0 < value < largest):
                raise InputError(f"{name}: expected {expected}, got {value!r}")
        if self.degree not in (1, 2):
            raise InputError(f"degree: expected 1 or 2, got {self.degree!r}")


Solver: TypeAlias = Direct | Krylov | Newton | PolakRibiere | None


def check_tolerance(value: float) -> None:
    """Raise InputError for what is no share of a residual."""
    if not (is_number(value) and 0 < value < 1):
        raise InputError(f"tolerance: expected a number between 0 and 1, got {value!r}")


def refuse_solver(solver: Solver, known: tuple[type, ...], law: str) -> None:
    """Raise InputError for settings of a solver that does not go with a law."""
    if solver is not None and not isinstance(solver, known):
        names = " or ".join(f"{kind.__name__}(…)" for kind in known) or "none"
        raise InputError(f"solver: expected {names} for {law}, got {solver!r:.60}")
