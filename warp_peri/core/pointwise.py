"""A material on a lattice that is an energy density of each node's strain: L u + Gᵗ P(G u).

G are gradients by stencils, H_q(x) = Σ_ξ u(x + ξ) ⊗ w_q(ξ), and W a function of torch of the Green
strain E = (H + Hᵗ + HᵗH)/2. P = (1 + H) W′(E), of which a linear part L has what W is at rest.
Force, tangent and slopes by numbers are torch's derivatives of W: none is written by hand.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Lock
from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse as sp
import torch
from numpy.typing import ArrayLike

from warp_peri.contract import OnPoints
from warp_peri.core.grid import grid_of
from warp_peri.core.stencil import Stencil, half_ball
from warp_peri.points.arrays import plain
from warp_peri.points.samples import PointsLike, nodes_of

Density = Callable[..., torch.Tensor]
"""W [stress] of E, shape [..., d, d], and of numbers by name; shape [...]."""
FEW = 100_000
"""Numbers of an array below which threads of torch cost more than they save."""
MOST = 2**23
"""Numbers of the gradients that are held at once; more samples follow one another."""


class _Threads:
    """Callers that are inside `one_thread`, and how many threads torch had before the first."""

    lock, inside, before = Lock(), 0, 1


@contextmanager
def one_thread(wanted: bool = True) -> Iterator[None]:
    """Keep torch on one thread, where that is wanted, until the last such call has left.

    The number of threads is each caller's own, and that of new threads the one that was set last.
    """
    if not wanted:
        yield
        return
    with _Threads.lock:
        if not _Threads.inside:
            _Threads.before = torch.get_num_threads()
        _Threads.inside += 1
        torch.set_num_threads(1)
    try:
        yield
    finally:
        with _Threads.lock:
            _Threads.inside -= 1
            torch.set_num_threads(_Threads.before)


def times(A: torch.Tensor, B: torch.Tensor) -> torch.Tensor:
    """Products of matrices [..., d, d, F]."""
    return (A[..., None, :] * B[..., None, :, :, :]).sum(-3)


def symmetric(A: torch.Tensor) -> torch.Tensor:
    """(A + Aᵗ)/2 of matrices [..., d, d, F]."""
    return (A + A.transpose(-3, -2)).div_(2)


def along(H: torch.Tensor, X: torch.Tensor) -> torch.Tensor:
    """The derivative of the Green strain at H along X, each [..., d, d, F]."""
    return symmetric(times(H.transpose(-3, -2), X).add_(X))


def strain(H: torch.Tensor) -> torch.Tensor:
    """The Green strain (H + Hᵗ + HᵗH)/2 of gradients [..., d, d, F]."""
    return symmetric(times(H.transpose(-3, -2), H).div_(2).add_(H))


class Pointwise(OnPoints):
    """Minus the internal force density of an energy density on a lattice; b in equilibrium.

    Args:
        points: a lattice, whose interior has a collar of twice the horizon, or periodic.
        horizon: of the longest bond of gradients and linear part [length].
        density: W(E, **numbers).
        steps: ξ/h of the gradients along the lattice's axes, shape [B, d].
        weights: w_q(ξ) [1/length] in the coordinates of the points, shape [Q, B, d]. The density
            of a node is the mean over q.
        back: other weights for the force, which then has no energy.
        stencil: of a linear part, along the lattice's axes, which has the moduli of W at rest.
        numbers: of the density, by name.

    Attributes:
        full: nodes within the horizon of the interior, where H is taken.

    Raises InputError as grid_of does, for interior nodes without a collar as wide as both.
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
        self.points, self.density = nodes_of(points), density
        self.has_energy = back is None
        self._steps, self._weights = steps, (weights, weights if back is None else back)
        ball = half_ball(horizon / self.points.spacing, steps.shape[1])
        ball = np.concatenate([ball, -ball, 0 * ball[:1]])
        both = np.concatenate([steps, -steps])
        far = np.unique((ball[:, None] + both).reshape(-1, steps.shape[1]), axis=0)
        half = far[len(far) // 2 + 1 :]  # they are in order, ξ before 0 before −ξ
        grid = grid_of(self.points, half, least=2 * int(np.abs(ball).max()))
        sizes = (scipy.fft.next_fast_len(n, real=True) for n in grid.shape)
        self._torus = grid.shape if grid.periodic else tuple(sizes)
        self._axes = tuple(range(-grid.dimension, 0))
        at = np.stack(np.unravel_index(grid.place, grid.shape), axis=1)
        place, asked = np.ravel_multi_index(tuple(at.T), self._torus), np.zeros(self._torus, bool)
        self._inside = place[self.points.interior[grid.near]]
        asked.flat[self._inside] = True

        def reached(steps: np.ndarray) -> np.ndarray:
            felt = np.any([np.roll(asked, step, self._axes) for step in steps], axis=0)
            return np.asarray(felt.flat[place])

        near, whole = reached(far), reached(ball)
        self._near, self._places = grid.near[near], place[near]
        self.full, self._full, self._full_at = grid.near[whole], place[whole], at[whole]
        into, out = (self._symbol(steps, each.swapaxes(1, 2)) for each in self._weights)
        self._symbols = into, out / len(out)
        self._straight: Any = None
        self._linear: Any = None
        self.at_rest: Any = None
        if stencil is not None:
            C = (grid.axes @ stencil.tensors @ grid.axes.T).transpose(1, 2, 0)
            both = np.concatenate([stencil.steps, -stencil.steps, 0 * stencil.steps[:1]])
            C = np.concatenate([-C, -C, 2 * C.sum(axis=2, keepdims=True)], axis=2)
            self._straight = self._symbol(both, C).real
        self.take(numbers or {})

    def take(self, numbers: Mapping[str, Any]) -> None:
        """Change the numbers of the density; a linear part has what W is at rest with them."""
        self.numbers = dict(numbers)
        if self._straight is not None:
            self.at_rest, (into, out) = self.stiffness(), self._symbols
            given = self.at_rest.numpy(), out.conj(), into
            at_rest = np.einsum("abcd,qb...,qd...->ac...", *given, optimize=True)
            self._linear = self._straight - at_rest

    def _symbol(self, steps: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Of u ↦ Σ w(ξ) u(x + ξ), shape [..., *half a torus], of w [..., B]."""
        field = np.zeros((*values.shape[:-1], *self._torus))
        np.add.at(field, (..., *(-steps % self._torus).T), values)
        return np.asarray(scipy.fft.rfftn(field, axes=self._axes))

    def _waves(self, values: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Of values at some places, shape [..., n], zero elsewhere."""
        planes = np.zeros((*values.shape[:-1], int(np.prod(self._torus))))
        planes[..., places] = values
        planes = planes.reshape(*values.shape[:-1], *self._torus)
        return np.asarray(scipy.fft.rfftn(planes, axes=self._axes))

    def _read(self, waves: np.ndarray, places: np.ndarray) -> np.ndarray:
        planes = scipy.fft.irfftn(waves, s=self._torus, axes=self._axes, overwrite_x=True)
        return np.take(planes.reshape(*waves.shape[: -len(self._torus)], -1), places, axis=-1)

    def _field(self, u: np.ndarray) -> np.ndarray:
        """Waves of fields [S, N, d], [S, d, *half a torus]."""
        return self._waves(u[:, self._near].swapaxes(1, 2), self._places)

    def _gradient(self, waves: np.ndarray, side: int = 0) -> torch.Tensor:
        """H at the nodes `full`, shape [S, Q, d, d, F]."""
        slopes = waves[:, None, :, None] * self._symbols[side][:, None]
        return torch.from_numpy(self._read(slopes, self._full))

    def _pulled(self, P: torch.Tensor, side: int, places: np.ndarray, field: Any) -> np.ndarray:
        """`_gradient` transposed, of P [S, Q, d, d, F], and the linear part, of the waves of a
        field, at some places, [S, n, d]."""
        waves = self._waves(P.numpy(), self._full)
        total = (waves * self._symbols[side].conj()[:, None]).sum(axis=(1, 3))
        if self._linear is not None:
            linear = self._linear if side else self._linear.conj().swapaxes(0, 1)
            total += (linear * field[:, None]).sum(axis=2)
        return self._read(total, places).swapaxes(1, 2)

    @torch.enable_grad()
    def _slope(self, E: torch.Tensor, numbers: Any = None, *, graph: bool = False) -> torch.Tensor:
        """W′(E) of strains [..., d, d, F]; with a graph of E, a leaf, and of numbers."""
        E = E if graph else E.detach().requires_grad_()
        W = self.density(E.movedim(-1, -3), **(self.numbers if numbers is None else numbers))
        return symmetric(torch.autograd.grad(W.sum(), E, create_graph=graph)[0])

    @torch.enable_grad()
    def stiffness(self) -> torch.Tensor:
        """∂²W/∂E² at rest [stress], shape [d, d, d, d]."""
        d = self.shape[1]
        E, one = torch.zeros(d, d, 1, dtype=torch.float64, requires_grad=True), torch.eye(d * d)
        S = self._slope(E, graph=True)[..., 0].flatten()
        rows = [torch.autograd.grad(S, E, each, retain_graph=True)[0] for each in one.to(S)]
        C = torch.stack(rows).reshape(4 * (d,))
        return (C + C.transpose(2, 3)) / 2

    def _linear_stress(self, H: torch.Tensor) -> torch.Tensor | float:
        if self.at_rest is None:
            return 0.0
        return torch.einsum("abcd,...cdn->...abn", self.at_rest, H)

    def _stress(self, H: torch.Tensor) -> torch.Tensor:
        """P of gradients [S, Q, d, d, F] [stress]."""
        S = self._slope(strain(H))
        return times(H, S).add_(S)

    @torch.enable_grad()
    def _curved(self, H: torch.Tensor, X: torch.Tensor) -> torch.Tensor:
        """The derivative of P at H along X."""
        E = strain(H).requires_grad_()
        S = self._slope(E, graph=True)
        bent = torch.autograd.grad(S, E, along(H, X))[0]
        bent = symmetric(bent)
        return times(X, S.detach()).add_(times(H, bent)).add_(bent)

    def _parts(self, sweep: Callable[..., np.ndarray], *fields: ArrayLike) -> np.ndarray:
        """What a sweep makes of fields [S, N, d], a few samples at once, one after another."""
        given = [np.reshape(plain("u", f), (-1, *self.shape)) for f in fields]
        size = len(self.full) * self._weights[0].shape[0] * self.shape[1] ** 2
        step, count = max(1, MOST // size), len(given[0])
        with torch.enable_grad(), one_thread(size * min(step, count) < FEW):
            parts = [slice(n, n + step) for n in range(0, count, step)]
            return np.concatenate([sweep(*(f[part] for f in given)) for part in parts])

    def force(self, u: ArrayLike, radius: float = 0.0) -> np.ndarray:
        """The force on the interior nodes [stress/length], [..., I, d]; of gradients projected to
        |H| ≤ `radius` where that is above zero (N10)."""
        self.check(field := plain("u", u))

        def sweep(u: np.ndarray) -> np.ndarray:
            waves = self._field(u)
            H = self._gradient(waves)
            if radius > 0:
                far = H * (1 - (radius / H.norm(dim=(2, 3), keepdim=True)).clamp(max=1))
                H = H - far
            P = self._stress(H)
            if radius > 0:  # at rest it is in the linear part, of all of H
                P = P + self._linear_stress(far)
            return self._pulled(P, 1, self._inside, waves)

        return self._parts(sweep, field).reshape(*field.shape[:-2], -1, self.shape[1])

    def product(self, u: ArrayLike, v: ArrayLike) -> np.ndarray:
        """The derivative at u along v, shape [..., I, d]."""

        def sweep(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            waves = self._field(v)
            change = self._curved(self._gradient(self._field(u)), self._gradient(waves))
            return self._pulled(change, 1, self._inside, waves)

        return self._parts(sweep, u, v).reshape(*np.shape(u)[:-2], -1, self.shape[1])

    def product_transpose(self, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """The transposed product with w on the interior [..., I, d], on all nodes [..., N, d]."""

        def sweep(u: np.ndarray, w: np.ndarray) -> np.ndarray:
            waves, out = self._field(w), np.zeros_like(u)
            change = self._curved(self._gradient(self._field(u)), self._gradient(waves, 1))
            out[:, self._near] = self._pulled(change, 0, self._places, waves)
            return out

        return self._parts(sweep, u, self.on_all(w)).reshape(np.shape(u))

    @property
    def learnable(self) -> dict[str, Any]:
        """Numbers of the density, by name."""
        return self.numbers

    def by_numbers(self, name: str, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """Derivatives of Σ w · force(u) to a number, of fields [K, N, d] and weights [K, I, d]."""
        one = torch.tensor(self.numbers[name], dtype=torch.float64, requires_grad=True)

        def sweep(u: np.ndarray, w: np.ndarray) -> np.ndarray:
            H, X = self._gradient(self._field(u)), self._gradient(self._field(w), 1)
            S = self._slope(strain(H).requires_grad_(), {**self.numbers, name: one}, graph=True)
            total = torch.autograd.grad(S, one, along(H, X), materialize_grads=True)
            return total[0][None].numpy()

        return np.asarray(self._parts(sweep, u, self.on_all(w)).sum(axis=0))

    def gradients(self, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """H and P [stress], means over q, at the nodes `full`, each [..., F, d, d]."""

        def sweep(u: np.ndarray) -> np.ndarray:
            H = self._gradient(self._field(u))
            P = self._stress(H) - self._linear_stress(H)
            return torch.stack([H.mean(1), P.mean(1)], 1).movedim(-1, 2).numpy()

        both = self._parts(sweep, u).swapaxes(0, 1)
        H, P = both.reshape(2, *np.shape(u)[:-2], *both.shape[2:])
        return H, P

    def largest_gradient(self, u: ArrayLike) -> np.ndarray:
        """Largest |H| of each field over the nodes `full`, shape [...]."""
        H, _ = self.gradients(u)
        largest: np.ndarray = np.linalg.norm(H, axis=(-2, -1)).max(axis=-1)
        return largest

    def energy(self, u: ArrayLike) -> np.ndarray | None:
        """h^d Σ W(H) over the nodes `full` [stress · length^d], shape [...], without the linear
        part; None where the force has no energy."""
        if not self.has_energy:
            return None

        def sweep(u: np.ndarray) -> np.ndarray:
            H = self._gradient(self._field(u))
            W = self.density(strain(H).movedim(-1, 2), **self.numbers)
            linear = (self._linear_stress(H) * H).sum((2, 3)) / 2
            return (W - linear).mean(1).sum(-1).numpy()

        cell = self.points.spacing**self.points.dimension
        return np.asarray(cell * self._parts(sweep, u).reshape(np.shape(u)[:-2]))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """P [stress] at the interior nodes, [..., I, d, d], without the linear part."""
        return self.gradients(u)[1][..., self.points.interior[self.full], :, :]

    def tangent(self, u: ArrayLike) -> sp.csr_array:
        """∂force/∂u at a field [N, d], without the linear part: sparse, shape [d I, d N]."""
        d, inside = self.shape[1], np.flatnonzero(self.points.interior)
        H = self._gradient(self._field(self.fields(u)))
        pairs = [*itertools.product(range(d), repeat=2)]
        into, out = ([self._differences(w) for w in weights] for weights in self._weights)
        found = sp.csr_array((d * len(inside), d * len(self.points.x)))
        for c, e in pairs:
            one = torch.zeros(d, d, 1, dtype=torch.float64)
            one[c, e] = 1
            P = self._curved(H, one.expand_as(H)) - self._linear_stress(one.expand_as(H))
            rows = P[0].numpy() / len(into)
            for q, (a, b) in itertools.product(range(len(into)), pairs):
                bent = out[q][b].T @ (sp.diags_array(rows[q, a, b]) @ into[q][e])
                place = sp.coo_array(([1.0], ([a], [c])), shape=(d, d))
                found = found + sp.kron(bent.tocsr()[inside], place)
        return sp.csr_array(found)

    def _differences(self, weights: np.ndarray) -> list[sp.csr_array]:
        """Σ w(ξ) u(x + ξ) at the nodes `full` of one q, by component of w, each [F, N]."""
        number = np.full(self._torus, -1)
        number.flat[self._places] = self._near
        far = (self._full_at[:, None] + self._steps) % self._torus
        ends = number[tuple(np.moveaxis(far, -1, 0))].ravel()
        count = len(self._steps) * np.arange(len(self.full) + 1)
        shape = len(self.full), len(self.points.x)
        given = [np.tile(column, len(self.full)) for column in weights.T]
        return [sp.csr_array((each, ends, count), shape=shape) for each in given]
