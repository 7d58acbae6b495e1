"""The neural operator on the nodes of a lattice: force, tangent product and its transpose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.neural.bonds import Gather, NetworkBonds, Scatter


class NeuralLaw(Protocol):
    """What is asked of a material: ω of bonds, and force states of bonds."""

    anisotropic: bool

    def omega(self, xi: torch.Tensor) -> torch.Tensor: ...

    def force_state(
        self, omega: torch.Tensor, theta: torch.Tensor, e: torch.Tensor, r: torch.Tensor
    ) -> torch.Tensor: ...

    def parameters(self) -> Iterator[torch.nn.Parameter]: ...


class Placed:
    """Minus the internal force density of a neural operator on a lattice; equals b in equilibrium.

    ``placed(u)`` takes u [length] of shape [N, 2] or [S, N, 2] and gives forces [stress/length] on
    the interior, shape [I, 2] or [S, I, 2]: NumPy for NumPy, differentiable torch for torch.
    """

    def __init__(self, material: NeuralLaw, bonds: NetworkBonds) -> None:
        self.material, self.bonds, self.points = material, bonds, bonds.points

    def __call__(self, u: Any) -> Any:
        """Forces on the interior, (NO6)."""
        if isinstance(u, torch.Tensor):
            field = self._checked(u)
            force = self.force(field)
            return force if u.dim() == 3 else force[0]
        with torch.no_grad():
            return self(self._taken(u)).double().numpy()

    def product(self, u: Any, v: Any) -> Any:
        """Derivative of the force at u along v, both [N, 2] or [S, N, 2], or u [N, 2] alone."""
        if isinstance(u, torch.Tensor):
            self._checked(v, "v")
            return self.tangent(u)(v)
        if np.ndim(u) == 3 and np.shape(u) == np.shape(v):
            return np.stack([self.product(*pair) for pair in zip(u, v)])
        with torch.no_grad():
            return self.product(self._taken(u), self._taken(v)).double().numpy()

    def energy(self, u: Any) -> None:
        """None: the forces of a network need not have an energy."""

    def stress(self, u: Any) -> np.ndarray:
        """First Piola–Kirchhoff stress [stress] at the interior nodes, shape [..., I, 2, 2].

        Half of Σ tension M ⊗ ξ over a node's bonds, (NO13); exact for uniform strain.
        """
        bonds, field = self.bonds, np.reshape(u, (-1, *self.points.x.shape))
        with torch.no_grad():
            tension = self.tension(self._taken(field)).double().numpy()
        near, far = bonds.near[: bonds.acting], bonds.far[: bonds.acting]
        xi = bonds.xi[bonds.place[: bonds.acting]]
        y = xi + field[:, far] - field[:, near]
        pull = (tension / np.linalg.norm(y, axis=2))[..., None] * y
        part = 0.5 * bonds.area * pull[..., :, None] * xi[:, None, :]
        whole = np.zeros((len(self.points.x), len(field), 2, 2))
        for ends in (near, far):
            np.add.at(whole, ends, part.swapaxes(0, 1))
        rows = whole[bonds.rows].swapaxes(0, 1)
        stress: np.ndarray = rows.reshape(*np.shape(u)[:-2], len(bonds.rows), 2, 2)
        return stress

    def force(self, u: torch.Tensor) -> torch.Tensor:
        """Forces [S, I, 2] of u [S, N, 2]."""
        force: torch.Tensor = Scatter.apply(u, self.tension(u), self.bonds)  # type: ignore[no-untyped-call]
        return force

    def tension(self, u: torch.Tensor) -> torch.Tensor:
        """Force states of both ends of the acting bonds [stress/length³], [S, A] of [S, N, 2]."""
        omega, share, r = self.shares(u.dtype)
        e, theta = Gather.apply(u, share, self.bonds)  # type: ignore[no-untyped-call]
        own, other = self.inputs(omega, theta, e, r)
        state = self.material.force_state
        return (state(*own) + state(*other)).reshape(len(u), -1)

    def shares(self, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """ω, ω |ξ| / Σ ω |ξ|² and |ξ| of the bonds of a family, each of shape [B]."""
        bonds = self.bonds
        net = self.material
        turn = np.radians(self.points.axis or 0.0)  # directions are those of the material
        along = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        xi = torch.as_tensor(bonds.xi @ along, dtype=dtype)
        r = torch.as_tensor(bonds.lengths, dtype=dtype)
        if net.anisotropic:
            omega = net.omega(xi)
        else:  # one value for a class
            kind = torch.as_tensor(bonds.kind, dtype=torch.int64)
            first = [int(n) for n in np.unique(bonds.kind, return_index=True)[1]]
            omega = net.omega(xi[first])[kind]
        return omega, omega * r / (omega * r**2).sum(), r

    def inputs(
        self, omega: torch.Tensor, theta: torch.Tensor, e: torch.Tensor, r: torch.Tensor
    ) -> tuple[tuple[torch.Tensor, ...], tuple[torch.Tensor, ...]]:
        """What the force state takes of either end of the acting bonds, each of shape [S A]."""
        bonds = self.bonds

        def seen(nodes: torch.Tensor, places: torch.Tensor) -> tuple[torch.Tensor, ...]:
            parts = (omega[places], theta[:, nodes], e, r[places])
            return tuple(part.expand_as(e).reshape(-1) for part in parts)

        return seen(bonds.own, bonds.forward), seen(bonds.other, bonds.backward)

    def tangent(self, u: torch.Tensor) -> Tangent:
        """The derivative of the force at one field, shape [N, 2]."""
        if u.dim() != 2:
            raise InputError(f"u: expected shape {[*self.points.x.shape]}, got {[*u.shape]}")
        return Tangent(self, self._checked(u).detach())

    @property
    def dtype(self) -> torch.dtype:
        """The material's precision."""
        return next(self.material.parameters()).dtype

    def _taken(self, u: Any) -> torch.Tensor:
        """NumPy's field in the material's precision."""
        return torch.as_tensor(np.ascontiguousarray(u), dtype=self.dtype)

    def _checked(self, u: torch.Tensor, name: str = "u") -> torch.Tensor:
        """A field of shape [S, N, 2] in the material's precision."""
        nodes = len(self.points.x)
        if u.dim() not in (2, 3) or u.shape[-2:] != (nodes, 2):
            raise InputError(
                f"{name}: expected shape [{nodes}, 2] or [S, {nodes}, 2], got {[*u.shape]}"
            )
        if not len(u):
            raise InputError(f"{name}: expected at least one sample, got none")
        if u.dtype != self.dtype:
            raise InputError(
                f"{name}: expected {self.dtype}, the material's precision, got {u.dtype}"
            )
        return u.reshape(-1, nodes, 2)


class Tangent:
    """J = ∂force/∂u at one field: products with fields and with forces, without the networks.

    The slopes of every bond's force state to its extension and to the dilatations of its ends are
    computed once; after that a product is three sweeps.
    """

    def __init__(self, placed: Placed, u: torch.Tensor) -> None:
        self.bonds, self.u = placed.bonds, u
        with torch.no_grad():
            omega, self.share, r = placed.shares(u.dtype)
            e = self.bonds.extension(u)
            theta = self.bonds.average(e, self.share)
            acting = e[:, : self.bonds.acting].contiguous()
        both = []
        for seen in placed.inputs(omega, theta, acting, r):
            theta, e = (part.contiguous().requires_grad_() for part in seen[1:3])
            with torch.enable_grad():
                state = placed.material.force_state(seen[0], theta, e, seen[3])
                slopes = torch.autograd.grad(state.sum(), (theta, e))
            both.append((state.detach(), *slopes))
        (own, self.to_own, by_e), (other, self.to_other, by_far) = both
        self.tension, self.to_e = (own + other)[None], (by_e + by_far)[None]

    def __call__(self, v: torch.Tensor) -> torch.Tensor:
        """J v on the interior, shape [I, 2] or [S, I, 2], of v, shape [N, 2] or [S, N, 2]."""
        bonds = self.bonds
        field = v.reshape(-1, *self.u.shape[1:])
        u = self.u.expand(len(field), -1, -1)
        rate = bonds.stretching(u, field, len(bonds.near))
        theta = bonds.average(rate, self.share)
        tension = self.to_e * rate[:, : bonds.acting]
        tension += self.to_own * theta[:, bonds.own] + self.to_other * theta[:, bonds.other]
        force = bonds.pull(u, tension, "rows")
        force += bonds.turn(u, field, self.tension.expand(len(field), -1), "rows")
        return bonds.area * (force if v.dim() == 3 else force[0])

    def transposed(self, w: torch.Tensor) -> torch.Tensor:
        """Jᵗ w on all nodes, shape [N, 2], of w on the interior, shape [I, 2]."""
        bonds = self.bonds
        wide = bonds.area * bonds.on_every(w[None])
        by_tension = bonds.stretching(self.u, wide, bonds.acting)[0]
        seed = w.new_zeros(1, len(bonds.near))
        seed[0, : bonds.acting] = self.to_e[0] * by_tension
        by_theta = w.new_zeros(len(bonds.whole))
        by_theta.index_add_(0, bonds.own, self.to_own * by_tension)
        by_theta.index_add_(0, bonds.other, self.to_other * by_tension)
        bonds.spread(seed, self.share, by_theta[None])
        out = bonds.pull(self.u, seed, "every") + bonds.turn(self.u, wide, self.tension, "every")
        return out[0]
