"""Third-order crystals for tests, and Ψ written down as in the theory, from the Green strain."""

from functools import cache

import numpy as np
import scipy.sparse as sp
import torch

from tests.crystal.crystals import cubic_tensor, dispersive
from tests.support.problems import AXIS
from warp_peri.materials.crystal_fit import fit_dispersion
from warp_peri.materials.third_order import Smoothing, ThirdOrderMaterial
from warp_peri.points.points import lattice_steps

LAM, MU = 0.3, 0.7
TENSOR = cubic_tensor(2, LAM + 2 * MU, LAM, MU)
CONSTANTS = (-0.5, -6.8, 1.04)
FORMS = ("energy", "filtered")


@cache
def solid(form, horizon=3.0, spacing=1.0):
    """A certified crystal with its guarantee."""
    linear = fit_dispersion(
        dispersive(TENSOR, spacing), spacing, horizon, symmetry="isotropic", tensor=TENSOR
    )
    smoothing = Smoothing(2.0 * spacing, 0.2)
    return ThirdOrderMaterial(linear, *CONSTANTS, smoothing, form, horizon).certified()


def psi(H, model, axis=AXIS):
    """Ψ of (N3) [TPa] at H, shape [..., 2, 2], with the small-strain energy taken off."""
    small = (H + np.swapaxes(H, -1, -2)) / 2
    E = small + np.swapaxes(H, -1, -2) @ H / 2
    lam, mu = model.lame

    def harmonic(strain):
        trace = np.trace(strain, axis1=-2, axis2=-1)
        return lam / 2 * trace**2 + mu * (strain**2).sum(axis=(-2, -1))

    t = np.trace(E, axis1=-2, axis2=-1)
    q = (E[..., 0, 0] - E[..., 1, 1]) / 2 + 1j * E[..., 0, 1]
    q = q * np.exp(-2j * axis)
    cubic = model.t3 * t**3 + model.tq2 * t * np.abs(q) ** 2 + model.q3 * (q**3).real
    return harmonic(E) - harmonic(small) + cubic


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def far_ends(steps, points, at):
    """Bonds ξ [B, d] of steps and the nodes that they lead to from some, [n, B]."""
    xi = points.spacing * steps @ lattice_steps(points)[1].T
    box = np.full(xi.shape[1], np.inf) if points.box is None else np.asarray(points.box)
    ends = []
    for x in points.x[at][:, None] + xi:
        away = x[:, None] - points.x
        away -= np.where(np.isfinite(box), box, 0) * np.rint(away / box)
        ends.append(np.abs(away).max(axis=2).argmin(axis=1))
    return xi, np.array(ends)


def bent_tangent(op, u, steps, into, out):
    """∂force/∂u at u [N, d] without the linear part, by sums over bonds and no FFT, [d I, d N].

    Of an operator of one energy and weights [Q, B, d] of H and of the force.
    """
    d, ends = u.shape[1], far_ends(steps, op.points, op.full)[1]
    rows, places = np.arange(len(op.full)).repeat(len(steps)), ends.ravel()
    shape, eye = (len(op.full), len(op.points.x)), np.eye(d)

    def energy(H):
        E = (H + H.T + H.T @ H) / 2
        at_rest = (H * torch.tensordot(op.at_rest, H)).sum() / 2
        return op.density(E[None], **op.numbers)[0] - at_rest

    total = 0
    for one, other in zip(into, out):
        pull, push = (
            [sp.csr_array((np.tile(w, shape[0]), (rows, places)), shape) for w in side.T]
            for side in (one, other)
        )
        H = torch.from_numpy(np.stack([each @ u for each in pull], axis=2))
        bends = torch.stack([torch.autograd.functional.hessian(energy, each) for each in H])
        for a, b, c, e in np.ndindex(4 * (d,)):
            part = push[b].T @ sp.diags_array(bends[:, a, b, c, e].numpy()) @ pull[e]
            total += sp.kron(part[op.points.interior], np.outer(eye[a], eye[c])) / len(into)
    return sp.csr_array(total)
