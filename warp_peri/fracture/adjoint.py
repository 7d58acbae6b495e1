"""Cut and softening bodies in torch: derivatives along the path that was taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu

from warp_peri.core.tensors import as_tensor, linear, nonlinear, real, refuse_tangents
from warp_peri.dynamics.adjoint import in_motion as in_motion
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.fracture.body import LatticeBody
from warp_peri.fracture.bonds import stretch_matrix
from warp_peri.fracture.softening import BondLaw, SoftBody, pull_of, share_of
from warp_peri.fracture.statics import strain_of
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
    """b and statics.crack_load of other numbers, [N, d], differentiable in all."""
    numbers = {name: real(name, value) for name, value in parameters.items()}
    numbers = {n: torch.tensor(v, dtype=torch.float64) for n, v in cut.learnable.items()} | numbers
    even, sigma = torch.eye(cut.body.dimension, dtype=torch.float64), torch.from_numpy(stress)
    u = (torch.from_numpy(cut.body.x) @ strain_of(sigma, numbers["lam"], numbers["mu"], even))[None]
    whole, broken = (
        bond_force(cut.model, cut.body, table, u, numbers)[0]
        for table in (cut.body.neighbour, cut.neighbour)
    )
    return as_tensor("b", b) + whole - broken


def pulled(body: SoftBody, u: Any, numbers: dict[str, Any], how: dict[str, Any]) -> Motion:
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
    own = {name: numbers.pop(name, getattr(body.law, name)) for name in vars(body.law)}
    if numbers:
        raise InputError(f"parameters: expected {', '.join(own)}, got {', '.join(numbers)}")
    given, *law = (real(name, value) for name, value in {"u": u, **own}.items())
    refuse_tangents(given, *law)
    for name, value in zip(own, law):
        if value.numel() != 1:
            raise InputError(f"{name}: expected one number, got shape {list(value.shape)}")
    body.law = BondLaw(*(float(value.detach()) for value in law))
    if body.law.tail == 0:
        raise InputError("tail: expected > 0 for a gradient, which bonds that break at once lack")
    seen: list[list[np.ndarray]] = []
    motion: Motion = body.pull(given.detach().numpy(), seen=seen, **how)
    given, *law = map(_differentiated_once, (given, *law))
    given = torch.where(torch.from_numpy(body.held), given, 0.0).ravel()
    levers, square, breakable = map(
        torch.from_numpy, (body.levers(how["line"]), body.square, body.breakable)
    )
    share, worst = torch.ones_like(square), torch.zeros_like(square)
    forces, field = [], given
    for load, force, fields in zip(motion.time, motion["force"], seen):
        for one in fields:
            field = _at_rest(body, one, share, law[0], float(load) * given)
            s = linear(field, body.rows.dot, body.rows.T.dot) / square
            worst = torch.maximum(worst, s).where(breakable, 0.0)
            share = torch.minimum(share_of(worst, law[0], law[1], law[2], torch), share)
        across = (levers * share * pull_of(s, law[0], torch)).sum()
        forces.append(across if force else 0 * across)  # 0 of a body that came apart
    history: Any = motion.history | {"force": torch.stack(forces)}
    end: Any = field.reshape(body.held.shape)
    return replace(motion, u=end, history=history)


def _differentiated_once(x: torch.Tensor) -> torch.Tensor:
    """A tensor itself, of which second derivatives are refused."""
    return nonlinear(lambda x: x, None, (lambda x, upstream: upstream,), x)


def _at_rest(
    body: SoftBody, u: np.ndarray, share: Any, softness: Any, given: torch.Tensor
) -> torch.Tensor:
    """u at rest [d N], with derivatives to what is left of bonds, their softness and what is held:
    those of a step of Newton's method from there, which does not move it."""
    left, beta, factors = share.detach().numpy(), float(softness.detach()), list[Any]()
    square, stiffness = (torch.from_numpy(one) for one in (body.square, body.stiffness))

    def inverse(g: np.ndarray) -> np.ndarray:
        if not factors:
            s = np.maximum(body.stretch(u), 0)
            slope = body.stiffness * left * np.exp(-beta * s) * (1 - beta * s)
            K = sp.csr_array(body.rows.T @ (sp.diags_array(slope) @ body.rows))
            factors.append(splu(sp.csc_array(K[body.free][:, body.free])))
        w = np.zeros_like(g)
        w[body.free] = factors[0].solve(g[body.free])
        return w

    field = torch.where(torch.from_numpy(body.free), torch.from_numpy(u), given)
    s = linear(field, body.rows.dot, body.rows.T.dot) / square
    pull = stiffness * square * share * pull_of(s, softness, torch)
    force = linear(pull, body.rows.T.dot, body.rows.dot)
    return field - linear(force, np.zeros_like, inverse)
