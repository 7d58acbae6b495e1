"""Materials on a lattice with an energy density of each node's strain: L u + Gᵗ P(G u).

G are gradients by stencils, H_q(x) = Σ_ξ u(x + ξ) ⊗ w_q(ξ), and W a function of torch of the Green
strain E = (H + Hᵗ + HᵗH)/2. P = (1 + H) W′(E), of which a linear part L has what W is at rest.
Fields are planes on a torus around the nodes that are felt, components first.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import scipy.fft
import torch
from numpy import ndarray
from numpy.linalg import norm
from numpy.typing import ArrayLike
from torch.autograd import grad

from warp_peri.core.elastic import contracted, strain, strain_rate, symmetric, times
from warp_peri.core.stencil import Stencil, grid_of, half_ball, torus_shape, torus_symbol
from warp_peri.core.torch_bridge import Swept, own_torch
from warp_peri.errors import InputError, called
from warp_peri.points.arguments import Numbers, Pair
from warp_peri.points.points import PointsLike, nodes_of

STEP, LOST, ROUNDING = 1e-4, 1e-3, 1e-12
"""Of a number, over which its derivative is checked; of that, and of a stress, what is none."""


class Pointwise(Swept):
    """Operator of an energy density on a lattice: minus the internal force density.

    Args:
        points: a lattice, whose interior has a collar of twice the horizon, or periodic.
        horizon: of the longest bond of gradients and linear part [length].
        density: W(E, **numbers) [stress], [...], of E [..., d, d].
        steps: ξ/h of the gradients along the lattice's axes, shape [B, d].
        weights: w_q(ξ) [1/length] in the points' coordinates, [Q, B, d]; W is the mean over q.
        back: other weights for the force, which then has no energy.
        stencil: of a linear part, along the lattice's axes, which has the moduli of W at rest.
        numbers: of the density, by name; they are `learnable`.
        cubic: whether W is a polynomial of third order, as its derivatives at rest tell: in place
            of torch's graph, which takes longer than all else on few nodes.

    The F nodes within the horizon of the interior, where H is taken, are `full`. Raises InputError
    as grid_of does, for interior nodes without a collar.
    """

    def __init__(
        self,
        points: PointsLike,
        horizon: float,
        density: Callable[..., torch.Tensor],
        steps: ndarray,
        weights: ndarray,
        *,
        back: ndarray | None = None,
        stencil: Stencil | None = None,
        numbers: Numbers | None = None,
        cubic: bool = False,
    ) -> None:
        self.points, self.density, self.has_energy = nodes_of(points), density, back is None
        self._cubic, d = cubic, steps.shape[1]
        ball = half_ball(horizon / self.points.spacing, d)
        ball = np.concatenate([ball, -ball, 0 * ball[:1]])
        far = (ball[:, None] + np.concatenate([steps, -steps])).reshape(-1, d)
        far = np.unique(far, axis=0)  # in order: ξ before 0 before −ξ
        grid = grid_of(self.points, far[len(far) // 2 + 1 :], least=2 * int(np.abs(ball).max()))
        self._torus, self._axes = torus_shape(grid), tuple(range(-d, 0))
        place = np.ravel_multi_index(np.unravel_index(grid.place, grid.shape), self._torus)
        asked = np.zeros(self._torus, bool)
        self._inside = place[self.points.interior[grid.near]]
        asked.flat[self._inside] = True
        rolled = ([np.roll(asked, step, self._axes) for step in steps] for steps in (far, ball))
        near, whole = (np.any(each, axis=0).flat[place] for each in rolled)
        self._near, self._places = grid.near[near], place[near]
        self.full, self._full = grid.near[whole], place[whole]
        back = weights if back is None else back
        there = np.ravel_multi_index(tuple(-steps.T), self._torus, "wrap")
        sides = weights, back / len(back)
        self._symbols = [self._waves(side.transpose(2, 0, 1), there)[:, None] for side in sides]
        self._mirrored = [symbol.conj() for symbol in self._symbols]
        self.size, self._straight = asked.size * d * d * len(weights), None
        if stencil is not None:
            tensors = grid.axes @ stencil.tensors @ grid.axes.T
            self._straight = torus_symbol(self._torus, stencil.steps, tensors)[:, :, None]
        self.take(numbers or {})

    def take(self, numbers: Numbers) -> None:
        """Change the density's numbers, and with them its derivatives at rest."""
        self.learnable, self._third, d = dict(numbers), None, self.points.dimension
        units = symmetric(np.eye(d * d).reshape(d, d, d * d))
        self.stiffness = self._slopes(0 * units, units)[1].reshape(4 * (d,))
        self._at_rest = (self._straight is not None) * self.stiffness
        if self._cubic:
            along = np.tile(units, d * d)
            change = self._slopes(np.repeat(units, d * d, axis=2), along)[1].reshape(6 * (d,))
            self._third = change - self.stiffness[:, :, None, None]

    def _waves(self, values: ndarray, places: ndarray) -> ndarray:
        """Fourier transform of values at places [..., n], zero elsewhere, [..., *half a torus]."""
        planes = np.zeros((*values.shape[:-1], np.prod(self._torus)))
        planes[..., places] = values
        planes = planes.reshape(*values.shape[:-1], *self._torus)
        return np.asarray(scipy.fft.rfftn(planes, axes=self._axes, overwrite_x=True))

    def _planes(self, waves: ndarray, places: ndarray) -> ndarray:
        """Inverse transform of waves at some places, shape [..., n]."""
        planes = scipy.fft.irfftn(waves, self._torus, self._axes, overwrite_x=True)
        return np.take(planes.reshape(*planes.shape[: -len(self._torus)], -1), places, axis=-1)

    def _seen(self, u: ndarray, side: int = 0) -> Pair:
        """Waves of fields [S, N, d], and their gradients H at the nodes `full`, [d, d, S, Q, F]."""
        waves = self._waves(np.take(u.transpose(2, 0, 1), self._near, axis=-1), self._places)
        return waves, self._planes(waves[:, None, :, None] * self._symbols[side], self._full)

    def _pulled(self, P: ndarray, side: int, places: ndarray, field: Any) -> ndarray:
        """Gradients transposed of P, plus the linear part's force, at some places, [S, n, d]."""
        total = (self._waves(P, self._full) * self._mirrored[side]).sum(axis=(1, 3))
        if self._straight is not None:
            total += (self._straight * field).sum(axis=1)
        return self._planes(total, places).transpose(1, 2, 0)

    def _energies(self, E: Any, **other: Any) -> torch.Tensor:
        """Energy density W of strains [d, d, ...], with other numbers where some are given."""
        return self.density(torch.as_tensor(E).movedim((0, 1), (-2, -1)), **self.learnable | other)

    @own_torch()
    def _slopes(self, E: ndarray, *along: ndarray) -> list[ndarray]:
        """Derivative W′(E) at strains [d, d, ...], and its own along others; zero of a linear W."""
        if self._third is not None:  # W″ is linear, and W′(E) = W″(E/2) E
            pairs = (E / 2, E), *((E, X) for X in along)
            third = (contracted(self._third, A[:, :, None, None] * X) for A, X in pairs)
            return [contracted(self.stiffness, X) + T for T, X in zip(third, (E, *along))]
        at = torch.from_numpy(E).requires_grad_()
        found = grad(self._energies(at).sum(), at, create_graph=bool(along))
        for X in along:
            found += grad(found[0] if found[0].requires_grad else 0 * at, at, torch.from_numpy(X))
        return [symmetric(each.detach().numpy()) for each in found]

    def _stress(self, H: ndarray) -> ndarray:
        """Stress P of gradients [d, d, ...], without that of the linear part."""
        (S,) = self._slopes(strain(H))
        return np.asarray(S + times(H, S) - contracted(self._at_rest, H))

    def _bent(self, u: ndarray, v: ndarray, side: int, places: ndarray) -> ndarray:
        """Derivative of the force at fields u along v, or its transpose (side 1), at places."""
        (_, H), (waves, X) = self._seen(u), self._seen(v, side)
        S, bent = self._slopes(strain(H), strain_rate(H, X))
        change = times(X, S) + times(H, bent) + bent - contracted(self._at_rest, X)
        return self._pulled(change, 1 - side, places, waves)

    def force(self, u: ArrayLike, radius: float = 0.0) -> ndarray:
        """Force on the interior nodes [stress/length], [..., I, d]; with `radius` > 0 that of
        gradients projected to |H| ≤ radius (N10)."""

        def sweep(u: ndarray) -> ndarray:
            waves, H = self._seen(u)
            if radius > 0:
                H *= np.minimum(1, radius / norm(H, axis=(0, 1)))
            return self._pulled(self._stress(H), 1, self._inside, waves)

        return self._swept(sweep, u)

    def jvp(self, u: ArrayLike, v: ArrayLike) -> ndarray:
        """Derivative of the force at u along v, shape [..., I, d]."""
        return self._swept(lambda u, v: self._bent(u, v, 0, self._inside), u, v)

    def vjp(self, u: ArrayLike, w: ArrayLike) -> ndarray:
        """Transposed derivative of the force at u times w [..., I, d], on all nodes [..., N, d]."""

        def sweep(u: ndarray, w: ndarray) -> ndarray:
            out = np.zeros_like(u)
            out[:, self._near] = self._bent(u, w, 1, self._places)
            return out

        return self._swept(sweep, u, self.on_all(w))

    def by_numbers(self, name: str, u: ArrayLike, w: ArrayLike) -> ndarray:
        """Derivative of Σ w · force(u) by a number, for fields [K, N, d] and weights [K, I, d];
        InputError for a density that changes with it, all or in part, outside torch's graph."""
        value = self.learnable[name]
        step = STEP * abs(value) or STEP
        what = f"parameters: the energy does not differentiate {name!r}; use torch functions"

        def sweep(u: ndarray, w: ndarray) -> Any:
            (_, H), (_, X) = self._seen(u), self._seen(w, 1)
            E, along = map(torch.from_numpy, (strain(H), strain_rate(H, X)))
            E.requires_grad_()
            one = torch.tensor(value, dtype=torch.float64, requires_grad=True)

            def slope(number: Any, graph: bool = False) -> torch.Tensor:
                return grad(self._energies(E, **{name: number}).sum(), E, create_graph=graph)[0]

            def seen(along: torch.Tensor) -> float:
                with suppress(LookupError, RuntimeError, TypeError):  # takes no tensor, or as a key
                    by = grad(slope(one, True), one, along, materialize_grads=True)[0]
                    return float(by)
                return 0.0

            if self._cubic:  # torch sees all of it
                return seen(along)
            here, up, found = slope(value), None, list[float]()
            for s in (step, -step):  # unlike at a kink, and one may be none at an end
                with suppress(InputError):
                    far, near = ((called(what, slope, value + d) - here) / d for d in (s, s / 10))
                    if not (far.isfinite() & near.isfinite()).all():
                        continue
                    up = far.sign() if up is None else up  # so that no parts take each other off
                    found += [float((each * up).sum()) for each in (far, near, 2 * near - far)]
            if up is None:
                called(what, slope, value + step)
            elif found:
                off = ROUNDING * np.abs(self.stiffness).max() * float(E.detach().abs().sum()) / step
                off += LOST * max(map(abs, found))
                if not min(found) - off <= seen(up) <= max(found) + off:
                    raise InputError(what)
            return seen(along)

        return self._swept(sweep, u, self.on_all(w), total=True)

    def gradients(self, u: ArrayLike) -> Pair:
        """Gradients H and stresses P, means over q, at the nodes `full`, each [..., F, d, d]."""

        def sweep(u: ndarray) -> Any:
            _, H = self._seen(u)
            return np.stack([H, self._stress(H)]).mean(axis=4).transpose(3, 0, 4, 1, 2)

        H, P = np.moveaxis(self._swept(sweep, u), -4, 0)
        return H, P

    def largest_gradient(self, u: ArrayLike) -> ndarray:
        """Largest |H| of each field over the nodes `full`, shape [...]."""
        return np.asarray(norm(self.gradients(u)[0], axis=(-2, -1)).max(axis=-1))

    def energy(self, u: ArrayLike) -> ndarray | None:
        """Energy h^d Σ W(H) over the nodes `full` [stress · length^d], [...], without that of the
        linear part; None where the force has no energy."""
        if not self.has_energy:
            return None

        def sweep(u: ndarray) -> Any:
            _, H = self._seen(u)
            linear = (contracted(self._at_rest, H) * H).sum(axis=(0, 1)) / 2
            return (self._energies(strain(H)).detach().numpy() - linear).mean(axis=1).sum(axis=-1)

        return np.asarray(self.points.spacing**self.points.dimension * self._swept(sweep, u))

    def stress(self, u: ArrayLike) -> ndarray:
        """First Piola stress P at the interior nodes, [..., I, d, d], without the linear part."""
        return self.gradients(u)[1][..., self.points.interior[self.full], :, :]
