"""Materials on a lattice with an energy density of each node's strain: L u + Gᵗ P(G u).

G are gradients by stencils, H_q(x) = Σ_ξ u(x + ξ) ⊗ w_q(ξ), and W a function of torch of the Green
strain E = (H + Hᵗ + HᵗH)/2. P = (1 + H) W′(E), of which a linear part L has what W is at rest.
Fields are planes on a torus around the nodes that are felt, components first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy.fft
import torch
from numpy.typing import ArrayLike

from warp_peri.core.stencil import Stencil, grid_of, half_ball
from warp_peri.points.arguments import plain
from warp_peri.points.points import PointsLike, nodes_of
from warp_peri.protocols import OperatorBase
from warp_peri.runtime import one_thread

Density = Callable[..., torch.Tensor]
"""W [stress] of E, shape [..., d, d], and of numbers by name; shape [...]."""
FEW = 100_000
"""Numbers of an array below which threads cost more than they save."""
MOST = 2**23
"""Numbers of the gradients that are held at once; more samples follow one another."""


def times(A: torch.Tensor, B: torch.Tensor) -> torch.Tensor:
    """Matrix products A B, each [d, d, ...]."""
    return (A[:, :, None] * B).sum(1)


def symmetric(A: torch.Tensor) -> torch.Tensor:
    """Symmetric part (A + Aᵗ)/2 of matrices [d, d, ...]."""
    return (A + A.transpose(0, 1)).div_(2)


def strain_rate(H: torch.Tensor, X: torch.Tensor) -> torch.Tensor:
    """Derivative of the Green strain at H along X, each [d, d, ...]."""
    return symmetric(times(H.transpose(0, 1), X).add_(X))


def strain(H: torch.Tensor) -> torch.Tensor:
    """Green strain (H + Hᵗ + HᵗH)/2 of gradients [d, d, ...]."""
    return strain_rate(H / 2, H)


class Swept(OperatorBase):
    """An operator that works on a few samples at once: `size` numbers each, arrays of `parts`."""

    size: int
    parts = 1

    def _parts(self, sweep: Callable[..., Any], *fields: ArrayLike) -> list[np.ndarray]:
        """Results of a sweep over fields [S, N, d], a few samples at once."""
        given = [plain("u", field) for field in fields]
        for each in given:
            self.check(each)
        flat = [each.reshape(-1, *self.shape) for each in given]
        step, count = max(1, MOST // self.size), len(flat[0])
        few = self.size * min(step, count) < FEW * self.parts
        with torch.enable_grad(), one_thread(few), np.errstate(all="ignore"):  # of steps run away
            pieces = ((f[n : n + step] for f in flat) for n in range(0, count, step))
            return [np.asarray(sweep(*piece)) for piece in pieces]

    def _swept(self, sweep: Callable[..., Any], *fields: ArrayLike) -> np.ndarray:
        """Results of a sweep joined, in the leading shape of the fields."""
        found = np.concatenate(self._parts(sweep, *fields))
        return found.reshape(np.shape(fields[0])[:-2] + found.shape[1:])


class Pointwise(Swept):
    """Operator of an energy density on a lattice: minus the internal force density.

    Args:
        points: a lattice, whose interior has a collar of twice the horizon, or periodic.
        horizon: of the longest bond of gradients and linear part [length].
        density: W(E, **numbers).
        steps: ξ/h of the gradients along the lattice's axes, shape [B, d].
        weights: w_q(ξ) [1/length] in the points' coordinates, [Q, B, d]; W is the mean over q.
        back: other weights for the force, which then has no energy.
        stencil: of a linear part, along the lattice's axes, which has the moduli of W at rest.
        numbers: of the density, by name.

    The F nodes within the horizon of the interior, where H is taken, are `full`. Raises InputError
    as grid_of does, for interior nodes without a collar.
    """

    def __init__(
        self,
        points: PointsLike,
        horizon: float,
        density: Density,
        steps: np.ndarray,
        weights: np.ndarray,
        *,
        back: np.ndarray | None = None,
        stencil: Stencil | None = None,
        numbers: Mapping[str, Any] | None = None,
    ) -> None:
        self.points, self.density, self.has_energy = nodes_of(points), density, back is None
        d = steps.shape[1]
        ball = half_ball(horizon / self.points.spacing, d)
        ball = np.concatenate([ball, -ball, 0 * ball[:1]])
        far = (ball[:, None] + np.concatenate([steps, -steps])).reshape(-1, d)
        far = np.unique(far, axis=0)  # in order: ξ before 0 before −ξ
        half, least = far[len(far) // 2 + 1 :], 2 * int(np.abs(ball).max())
        grid = grid_of(self.points, half, least=least)
        sizes = (n if grid.periodic else scipy.fft.next_fast_len(n, real=True) for n in grid.shape)
        self._torus, self._axes = tuple(sizes), tuple(range(-d, 0))
        place = np.ravel_multi_index(np.unravel_index(grid.place, grid.shape), self._torus)
        asked = np.zeros(self._torus, bool)
        inside = self.points.interior[grid.near]
        asked.flat[place[inside]] = True
        self._inside = place[inside]

        def reached(steps: np.ndarray) -> np.ndarray:
            felt = np.any([np.roll(asked, step, self._axes) for step in steps], axis=0)
            return np.asarray(felt.flat[place])

        near, whole = reached(far), reached(ball)
        self._near, self._places = grid.near[near], place[near]
        self.full, self._full = grid.near[whole], place[whole]
        sides = weights, (weights if back is None else back) / len(weights)
        into, out = (self._symbol(steps, side.transpose(2, 0, 1)) for side in sides)
        self._symbols, self._mirrored = (into, out), (into.conj(), out.conj())
        self.size = asked.size * d * d * len(weights)
        self._straight = self._linear = None
        self.at_rest = torch.zeros(4 * (d,), dtype=torch.float64)
        if stencil is not None:
            C = (grid.axes @ stencil.tensors @ grid.axes.T).transpose(1, 2, 0)
            both = np.concatenate([stencil.steps, -stencil.steps, 0 * stencil.steps[:1]])
            C = np.concatenate([-C, -C, 2 * C.sum(axis=2, keepdims=True)], axis=2)
            self._straight = self._symbol(both, C).real
        self.take(numbers or {})

    def take(self, numbers: Mapping[str, Any]) -> None:
        """Change the density's numbers, and what the linear part has of W at rest."""
        self.numbers = dict(numbers)
        if self._straight is not None:
            self.at_rest = self.stiffness()
            given = self.at_rest, self._mirrored[1], self._symbols[0]
            self._linear = self._straight - np.einsum("abcd,bq...,dq...->ac...", *given)

    @torch.enable_grad()
    def stiffness(self) -> torch.Tensor:
        """Stiffness ∂²W/∂E² at rest [stress], shape [d, d, d, d]."""
        energy = lambda E: self._energies((E + E.T)[..., None] / 2).sum()  # noqa: E731
        rest = torch.zeros(2 * self.shape[1:], dtype=torch.float64)
        return torch.as_tensor(torch.autograd.functional.hessian(energy, rest))

    def _symbol(self, steps: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Symbol of u ↦ Σ w(ξ) u(x + ξ), shape [..., *half a torus], of w [..., B]."""
        field = np.zeros((*values.shape[:-1], *self._torus))
        np.add.at(field, (..., *(-steps % self._torus).T), values)
        return np.asarray(scipy.fft.rfftn(field, axes=self._axes))

    def _waves(self, values: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Fourier transform of values at places [..., n], zero elsewhere, [..., *half a torus]."""
        planes = np.zeros((*values.shape[:-1], int(np.prod(self._torus))))
        planes[..., places] = values
        planes = planes.reshape(*values.shape[:-1], *self._torus)
        return np.asarray(scipy.fft.rfftn(planes, axes=self._axes, overwrite_x=True))

    def _planes(self, waves: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Inverse transform of waves at some places, shape [..., n]."""
        planes = scipy.fft.irfftn(waves, self._torus, self._axes, overwrite_x=True)
        return np.take(planes.reshape(*planes.shape[: -len(self._torus)], -1), places, axis=-1)

    def _field(self, u: np.ndarray) -> np.ndarray:
        """Fourier transform of fields [S, N, d], [d, S, *half a torus]."""
        return self._waves(np.take(u.transpose(2, 0, 1), self._near, axis=-1), self._places)

    def _gradient(self, waves: np.ndarray, side: int = 0) -> torch.Tensor:
        """Gradients H of transformed fields at the nodes `full`, shape [d, d, S, Q, F]."""
        slopes = waves[:, None, :, None] * self._symbols[side][:, None]
        return torch.from_numpy(self._planes(slopes, self._full))

    def _pulled(self, P: torch.Tensor, side: int, places: np.ndarray, field: Any) -> np.ndarray:
        """`_gradient` transposed of P, plus the linear part's force, at some places, [S, n, d]."""
        waves = self._waves(P.numpy(), self._full) * self._mirrored[side][:, None]
        total = waves.sum(axis=(1, 3))
        if self._linear is not None:
            linear = self._linear if side else self._linear.conj().swapaxes(0, 1)
            total += (linear[:, :, None] * field).sum(axis=1)
        return self._planes(total, places).transpose(1, 2, 0)

    def _energies(self, E: torch.Tensor, numbers: Any = None) -> torch.Tensor:
        """Energy density W of strains [d, d, ...]."""
        return self.density(E.movedim((0, 1), (-2, -1)), **(numbers or self.numbers))

    @torch.enable_grad()
    def _slope(self, E: torch.Tensor, numbers: Any = None, *, graph: bool = False) -> torch.Tensor:
        """Derivative W′(E) at strains [d, d, ...]; with a graph of E, a leaf, and of numbers."""
        E = E if graph else E.detach().requires_grad_()
        W = self._energies(E, numbers)
        return symmetric(torch.autograd.grad(W.sum(), E, create_graph=graph)[0])

    def _stress(self, H: torch.Tensor) -> torch.Tensor:
        """Stress P of gradients [d, d, ...]."""
        S = self._slope(strain(H))
        return times(H, S).add_(S)

    def _bent(self, u: np.ndarray, v: np.ndarray, side: int, places: np.ndarray) -> np.ndarray:
        """Derivative of the force at fields u along v, or its transpose (side 1), at places."""
        waves, H = self._field(v), self._gradient(self._field(u))
        X, E = self._gradient(waves, side), strain(H).requires_grad_()
        S = self._slope(E, graph=True)
        bent = symmetric(torch.autograd.grad(S, E, strain_rate(H, X))[0])
        change = times(X, S.detach()).add_(times(H, bent)).add_(bent)
        return self._pulled(change, 1 - side, places, waves)

    def force(self, u: ArrayLike, radius: float = 0.0) -> np.ndarray:
        """Force on the interior nodes [stress/length], [..., I, d]; with `radius` > 0 that of
        gradients projected to |H| ≤ radius (N10)."""

        def sweep(u: np.ndarray) -> np.ndarray:
            H = near = self._gradient(waves := self._field(u))
            if radius > 0:
                near = H * (radius / H.norm(dim=(0, 1))).clamp(max=1)
            P = self._stress(near)
            if radius > 0:  # at rest it is in the linear part, of all of H
                P = P + torch.tensordot(self.at_rest, H - near, 2)
            return self._pulled(P, 1, self._inside, waves)

        return self._swept(sweep, u)

    def jvp(self, u: ArrayLike, v: ArrayLike) -> np.ndarray:
        """Derivative of the force at u along v, shape [..., I, d]."""
        return self._swept(lambda u, v: self._bent(u, v, 0, self._inside), u, v)

    def vjp(self, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """Transposed derivative of the force at u times w [..., I, d], on all nodes [..., N, d]."""

        def sweep(u: np.ndarray, w: np.ndarray) -> np.ndarray:
            out = np.zeros_like(u)
            out[:, self._near] = self._bent(u, w, 1, self._places)
            return out

        return self._swept(sweep, u, self.on_all(w))

    @property
    def learnable(self) -> dict[str, Any]:
        """Numbers of the energy density, by name."""
        return self.numbers

    def by_numbers(self, name: str, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """Derivative of Σ w · force(u) by a number, for fields [K, N, d] and weights [K, I, d]."""
        one = torch.tensor(self.numbers[name], dtype=torch.float64, requires_grad=True)

        def sweep(u: np.ndarray, w: np.ndarray) -> torch.Tensor:
            H, X = self._gradient(self._field(u)), self._gradient(self._field(w), 1)
            S = self._slope(strain(H).requires_grad_(), {**self.numbers, name: one}, graph=True)
            return torch.autograd.grad(S, one, strain_rate(H, X), materialize_grads=True)[0]

        return np.asarray(np.sum(self._parts(sweep, u, self.on_all(w)), axis=0))

    def gradients(self, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Gradients H and stresses P, means over q, at the nodes `full`, each [..., F, d, d]."""

        def sweep(u: np.ndarray) -> torch.Tensor:
            H = self._gradient(self._field(u))
            P = self._stress(H) - torch.tensordot(self.at_rest, H, 2)
            return torch.stack([H, P]).mean(4).permute(3, 0, 4, 1, 2)

        both = np.moveaxis(self._swept(sweep, u), -4, 0)
        return both[0], both[1]

    def largest_gradient(self, u: ArrayLike) -> np.ndarray:
        """Largest |H| of each field over the nodes `full`, shape [...]."""
        return np.asarray(np.linalg.norm(self.gradients(u)[0], axis=(-2, -1)).max(axis=-1))

    def energy(self, u: ArrayLike) -> np.ndarray | None:
        """Energy h^d Σ W(H) over the nodes `full` [stress · length^d], [...], without that of the
        linear part; None where the force has no energy."""
        if not self.has_energy:
            return None

        def sweep(u: np.ndarray) -> Any:
            H = self._gradient(self._field(u))
            linear = (torch.tensordot(self.at_rest, H, 2) * H).sum((0, 1)) / 2
            return (self._energies(strain(H)) - linear).mean(1).sum(-1)

        return np.asarray(self.points.spacing**self.points.dimension * self._swept(sweep, u))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """First Piola stress P at the interior nodes, [..., I, d, d], without the linear part."""
        return self.gradients(u)[1][..., self.points.interior[self.full], :, :]
