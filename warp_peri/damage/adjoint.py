"""Cut and softening bodies in torch: derivatives along the path that was taken."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu

from warp_peri.core.tensors import as_tensor, differentiable_once, linear, real, refuse_tangents
from warp_peri.damage.lattice_body import LatticeBody
from warp_peri.damage.operator import stretch_matrix
from warp_peri.damage.softening import BondLaw
from warp_peri.dynamics.adjoint import in_motion as in_motion
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.materials.lps import Model, bernstein_basis


def bond_force(
    model: Model,
    body: LatticeBody,
    neighbour: np.ndarray,
    u: torch.Tensor,
    numbers: Mapping[str, Any],
    pressure: Any = 0.0,
) -> torch.Tensor:
    """L u of (C4) on all nodes, [S, N, d], of a model with other numbers; has every derivative.

    Args:
        model: whose influence function has the form of other numbers.
        body, neighbour: nodes and their bonds, broken ones are −1.
        u: displacement, shape [S, N, d].
        numbers: lam, mu, alpha and D as tensors.
        pressure: more stress at nodes that resists a dilatation [stress], shape [S, N].
    """
    classes, d, mu = body.classes, body.dimension, numbers["mu"]
    r = torch.from_numpy(classes.r * (model.nominal_spacing(classes.spacing) / classes.spacing))
    K = r ** -numbers["alpha"] * (
        torch.from_numpy(bernstein_basis(r.numpy(), model.horizon, model.degree)) @ numbers["D"]
    )
    kw = K * torch.from_numpy(classes.weight)
    w = kw / (torch.from_numpy(classes.count * classes.r**2) * kw).sum()  # as bond_weights
    stretch, place = stretch_matrix(body, neighbour)
    node, bond = (torch.from_numpy(one) for one in np.divmod(place, neighbour.shape[1]))
    w, square = w[torch.from_numpy(classes.bond_class)[bond]], torch.from_numpy(body.r**2)[bond]
    e = linear(u.flatten(1), lambda x: (stretch @ x.T).T, lambda y: (stretch.T @ y.T).T)
    theta = torch.zeros(u.shape[:2], dtype=u.dtype).index_add(1, node, d * w * e)
    stress = (numbers["lam"] - mu) * theta + pressure
    pull = d * (d + 2) * mu * w / square * e + d * w * stress[:, node]
    return linear(pull, lambda y: (stretch.T @ y.T).T, lambda x: (stretch @ x.T).T).view_as(u)


def pressed(cut: Any, b: Any, stress: np.ndarray, parameters: Mapping[str, Any]) -> torch.Tensor:
    """b and cut_solid.crack_load of other numbers, [N, d], differentiable in all."""
    numbers = {name: real(name, value) for name, value in parameters.items()}
    numbers = {n: torch.tensor(v, dtype=torch.float64) for n, v in cut.learnable.items()} | numbers
    lam, mu = numbers["lam"], numbers["mu"]
    even, sigma = torch.eye(cut.body.dimension, dtype=torch.float64), torch.from_numpy(stress)
    strain = (sigma - lam / (len(even) * lam + 2 * mu) * sigma.trace() * even) / (2 * mu)
    u = (torch.from_numpy(cut.body.x) @ strain)[None]
    whole, broken = (
        bond_force(cut.model, cut.body, table, u, numbers)[0]
        for table in (cut.body.neighbour, cut.neighbour)
    )
    return as_tensor("b", b) + whole - broken


def pull_of(s: torch.Tensor, softness: torch.Tensor) -> torch.Tensor:
    """As BondLaw.pull, of tensors."""
    return s * torch.exp(-softness * s.clamp(min=0))


def share_of(
    worst: torch.Tensor, softness: torch.Tensor, stretch: torch.Tensor, tail: torch.Tensor
) -> torch.Tensor:
    """As BondLaw.share, of tensors; a tail of 0 breaks at once, and has no gradient."""
    beyond = worst > stretch
    if tail == 0 or not beyond.any():
        return (~beyond).to(worst)
    fall = (1 - (worst - stretch) / tail).clamp(min=0)
    ends = pull_of(stretch, softness) * fall / pull_of(worst.where(beyond, 1.0), softness)
    return ends.clamp(max=1).where(beyond, 1.0)


def pulled(body: Any, u: Any, numbers: dict[str, Any], how: dict[str, Any]) -> Motion:
    """SoftBody.pull of tensors: force and end differentiable along the path that was taken.

    Which bonds failed when is felt, how often a load was settled is not.

    Args:
        body: softens.
        u: as of `pull`.
        numbers: softness, stretch or tail; the others are those of the body's law.
        how: options of `pull`.

    Raises InputError as `pull`, for other numbers, for bonds that break at once, which have no
    gradient, and for a second derivative.
    """
    u = as_tensor("u", u)
    law = {
        name: numbers.pop(name, getattr(body.law, name)) for name in ("softness", "stretch", "tail")
    }
    if numbers:
        raise InputError(f"parameters: expected {', '.join(law)}, got {', '.join(numbers)}")
    law = {name: real(name, value) for name, value in law.items()}
    for name, value in law.items():
        if value.numel() != 1:
            raise InputError(f"{name}: expected one number, got shape {list(value.shape)}")
    refuse_tangents(u, *law.values())
    body.law = BondLaw(**{name: float(value.detach()) for name, value in law.items()})
    if body.law.tail == 0:
        raise InputError("tail: expected > 0 for a gradient, which bonds that break at once lack")
    seen: list[list[np.ndarray]] = []
    motion: Motion = body.settled(u.detach().numpy(), seen, **how)
    given = torch.where(torch.from_numpy(body.held), u.double(), 0.0).ravel()
    cut, normal = body.section(how["line"])
    rise = np.abs(body.body.xi[body.bond] @ normal) * cut * body.square * body.stiffness
    area = torch.from_numpy(body.body.spacing**body.body.dimension * rise)
    square, breakable = torch.from_numpy(body.square), torch.from_numpy(body.breakable)
    share, worst = torch.ones_like(square), torch.zeros_like(square)
    forces, field = [], given
    for load, force, fields in zip(motion.time, motion["force"], seen):
        for one in fields:
            field = _softened(body, one, share, law["softness"], float(load) * given)
            s = linear(field, body.rows.dot, body.rows.T.dot) / square
            worst = torch.maximum(worst, s).where(breakable, 0.0)
            share = torch.minimum(share_of(worst, *law.values()), share)
        across = (area * share * pull_of(s, law["softness"])).sum()
        forces.append(across if force else 0 * across)  # 0 of a body that came apart
    history: Any = motion.history | {"force": torch.stack(forces)}
    end: Any = field.reshape(body.held.shape)
    return replace(motion, u=end, history=history)


class _Softened(torch.autograd.Function):
    """What is left of bonds, their softness and held components [d N] to where a body rests."""

    @staticmethod
    def forward(ctx: Any, body: Any, u: np.ndarray, *of: torch.Tensor) -> torch.Tensor:
        ctx.body, ctx.u = body, u
        ctx.save_for_backward(*of)
        return torch.tensor(u)

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        body, (share, softness, _), g = ctx.body, ctx.saved_tensors, upstream[0].numpy()
        d, left, beta = body.rows @ ctx.u, share.numpy(), float(softness)
        s = np.maximum(d / body.square, 0)
        weak = body.stiffness * np.exp(-beta * s)
        K = sp.csr_array(body.rows.T @ (sp.diags_array(left * weak * (1 - beta * s)) @ body.rows))
        free = body.free
        w = np.zeros_like(g)
        w[free] = splu(sp.csc_matrix(K[free][:, free])).solve(g[free])
        pull = body.rows @ w
        by_share, by_softness = -pull * weak * d, float((pull * left * weak * d * s).sum())
        by_held = np.where(free, 0.0, g - K @ w)
        found = by_share, np.array(by_softness), by_held
        return None, None, *map(torch.from_numpy, found)


_softened: Callable[..., torch.Tensor] = _Softened.apply
