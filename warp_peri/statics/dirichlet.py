"""A Dirichlet problem on lattice nodes as one convolution: products, definiteness, and solves.

L_II is a block of the operator of a torus (theory.md, 53), so the smallest eigenvalue of that
operator's symbol bounds it from below: above zero, conjugate gradients find the one answer.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.operator.stencil import smallest_ratio
from warp_peri.statics.conjugate_gradients import SolveRecord, definite
from warp_peri.statics.domain import Domain
from warp_peri.statics.preconditioners import Preconditioner, additive, nothing, sine, torus_inverse
from warp_peri.statics.settings import PRECONDITIONERS
from warp_peri.statics.strip import Strip

STRIP, EDGE = 2, 3
"""Widths of the strip that is eliminated: with λ ≫ μ in reaches, beside multigrid in nodes."""
SINGULAR = 1e-13
"""A bound of the smallest eigenvalue below this fraction of the largest is no bound."""

_MADE: dict[str, Callable[[Domain, torch.Tensor], Preconditioner]] = dict(
    zip(PRECONDITIONERS, (additive, sine, torus_inverse, torus_inverse, nothing))
)


class Dirichlet:
    """L_II of one model on the nodes of a domain, ready to be solved with.

    Args:
        domain: where the nodes lie.
        A: the stencil of the model [TPa/Å²], shape [2, 2, 2R + 1, 2R + 1], on the processor.
        method: a name in PRECONDITIONERS; "sine" is for rectangles; "strip" and "multigrid"
            eliminate the nodes near the edge first.

    Raises InputError for an operator that is not proven positive definite: singular or indefinite.
    """

    def __init__(self, domain: Domain, A: torch.Tensor, method: str) -> None:
        if method == "sine" and not domain.is_rectangle:
            raise InputError("method: sine is for rectangles of nodes; try multigrid")
        self.domain, self.method = domain, method
        self.scale = float(A[0, 0, A.shape[-1] // 2, A.shape[-1] // 2])
        self.symbol = domain.torus.symbol(A)
        self.check_definite()
        self.filtered = _MADE[method](domain, A)
        width = {"strip": STRIP * (A.shape[-1] // 2), "multigrid": EDGE}.get(method, 0)
        self.strip = Strip(domain, A, width) if width else None

    def check_definite(self) -> None:
        """Raise InputError unless the symbol proves that L_II is positive definite."""
        ratio = smallest_ratio(self.symbol, self.domain.torus)
        # every node's Laplacian is at least that of the box's longest wave
        long = sum(4 * np.sin(np.pi / 2 / (n + 1)) ** 2 for n in self.domain.mask.shape)
        if ratio * long > SINGULAR * self.scale:
            return
        spacing = self.domain.classes.spacing
        kind = "singular" if abs(ratio) * long <= SINGULAR * self.scale else "indefinite"
        raise InputError(
            f"the operator on these {len(self.domain.free)} nodes is {kind} or cannot be told from "
            f"it: the smallest Λmin D(k)/s(k) is {ratio * spacing**2:.2e}, and static problems "
            "of the model have no unique or no stable answer here"
        )

    def product(self, field: torch.Tensor) -> torch.Tensor:
        """L_II of a field [2, n₁, n₂] that is zero outside the mask."""
        n, m = self.domain.mask.shape
        return self.domain.torus.product(self.symbol, field)[:, :n, :m] * self.domain.mask

    def pull(self, wide: torch.Tensor) -> torch.Tensor:
        """L of a field of the wider box, at the unknown nodes."""
        return self.domain.inner(self.domain.torus.product(self.symbol, wide))

    def precondition(self, r: torch.Tensor) -> torch.Tensor:
        """z ≈ L_II⁻¹ r; with a strip r is zero on it, and so is L_II z."""
        z = self.filtered(r)
        return z if self.strip is None else z - self.strip(self.product(z))

    def solve(self, right: torch.Tensor, tolerance: float) -> tuple[torch.Tensor, SolveRecord]:
        """The field with L_II u = right and its record, to a true relative residual.

        Raises InputError when a direction has no positive energy, or CG stalls above the tolerance.
        """
        nodes = f" on these {len(self.domain.free)} nodes"
        hint = f", or so nearly incompressible that {self.method} does not come close to it: try "
        return definite(
            self.product,
            self.precondition,
            right,
            tolerance,
            begin=self.strip,
            where=nodes,
            hint=hint + "strip or lu",
        )
