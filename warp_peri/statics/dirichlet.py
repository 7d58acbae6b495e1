"""A Dirichlet problem on lattice nodes as one convolution: products, definiteness, and solves.

L_II is a block of the operator of a torus (theory.md, 53), so the smallest eigenvalue of that
operator's symbol bounds it from below: above zero, conjugate gradients find the one answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.operator.stencil import smallest_ratio
from warp_peri.statics.domain import Domain
from warp_peri.statics.preconditioners import Preconditioner, additive, nothing, sine, torus_inverse
from warp_peri.statics.strip import Strip

MOST_ITERATIONS = 1500
RESTARTS = 2
"""Times that a solve goes on from where the true residual was found too large."""
STRIP, EDGE = 2, 3
"""Widths of the strip that is eliminated: with λ ≫ μ in reaches, beside multigrid in nodes."""
SINGULAR = 1e-13
"""A bound of the smallest eigenvalue below this fraction of the largest is no bound."""

PRECONDITIONERS: dict[str, Callable[[Domain, torch.Tensor], Preconditioner]] = {
    "multigrid": additive,
    "sine": sine,
    "strip": torus_inverse,
    "fft": torus_inverse,
    "cg": nothing,
}


@dataclass
class SolveRecord:
    """What a solve took.

    Attributes:
        iterations: of conjugate gradients.
        residual: the true ‖L u − b‖ / ‖right-hand side‖ of the answer.
    """

    iterations: int = 0
    residual: float = 0.0


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
        self.filtered = PRECONDITIONERS[method](domain, A)
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
        # On shared cores torch's threads wait for one another at every small operation (3 to 20
        # times as long in all); transforms and kernels, most of the work, have their own.
        count = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return self._solve(right, tolerance)
        finally:
            torch.set_num_threads(count)

    def _solve(self, right: torch.Tensor, tolerance: float) -> tuple[torch.Tensor, SolveRecord]:
        record = SolveRecord()
        largest = float(right.abs().max()) if right.numel() else 0.0
        u = torch.zeros_like(right)
        if largest == 0:
            return u, record
        right = right / largest  # squares of very small and very large loads are no numbers
        size, left = float(right.norm()), right
        for _ in range(1 + RESTARTS):
            u += self._descend(left, 0.9 * tolerance * size, record)
            left = right - self.product(u)
            record.residual = float(left.norm()) / size
            if record.residual <= tolerance:
                return u * largest, record
            if record.iterations >= MOST_ITERATIONS:
                break
        raise InputError(
            f"the solve stalled: residual {record.residual:.1e} of the right-hand side after "
            f"{record.iterations} iterations, {tolerance:.1e} was asked for; the operator on these "
            f"{len(self.domain.free)} nodes is nearly singular, or so nearly incompressible "
            f"that {self.method} does not come close to it: try strip or lu"
        )

    def _descend(self, r: torch.Tensor, goal: float, record: SolveRecord) -> torch.Tensor:
        """Conjugate gradients from zero until the recursive residual meets the goal."""
        u, r = torch.zeros_like(r), r.clone()
        if self.strip is not None:
            u = self.strip(r)
            r -= self.product(u)
        z = self.precondition(r)
        p, rz = z.clone(), _dot(r, z)
        while float(r.norm()) > goal and record.iterations < MOST_ITERATIONS:
            q = self.product(p)
            energy = _dot(p, q)
            if not (energy > 0 and rz > 0):
                raise InputError(
                    f"the operator on these {len(self.domain.free)} nodes is indefinite: a "
                    f"direction has the energy {energy:.1e}"
                )
            record.iterations += 1
            step = rz / energy
            u.add_(p, alpha=step)
            r.sub_(q, alpha=step)
            z = self.precondition(r)
            last, rz = rz, _dot(r, z)
            p = z.add_(p, alpha=rz / last)
        return u


def _dot(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(torch.dot(a.flatten(), b.flatten()))
