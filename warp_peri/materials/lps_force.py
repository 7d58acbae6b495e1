"""The force of the linear solid on points, and its gradients: L is its own transpose once each bond
reads the stiffness of the bond back, and the influence function has Warp's tape.

Nothing is summed by atomic operations, and sums over nodes run over fixed blocks, so that the
result does not depend on how many threads there are. Nothing that a call writes is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_peri.core.torch_bridge import differentiable_once, refuse_tangents
from warp_peri.errors import InputError
from warp_peri.kernels.bonds import stay
from warp_peri.kernels.lps.plain import plain
from warp_peri.materials.lps import LPSParameters
from warp_peri.materials.lps_bonds import Bonds, SweepLaw, inverted, listed
from warp_peri.runtime import Shared, get_num_threads, ints, launch, launch_slices

BLOCKS = 8
"""Parts in which nodes are summed over, whatever the number of threads."""
FASTER = 4
"""How much less a thread has to do with a node in rows than in its list of bonds."""
KEPT = 2**25
"""Most numbers in planes that are kept between evaluations: 256 MB in double precision."""


@dataclass(frozen=True)
class Felt:
    """A force, and what its gradient reads.

    Attributes:
        law: that it is of.
        planes: the displacement as sweeps read it.
        theta: dilatation of each sample and place, shape [S, P].
        Lu: L u on the interior nodes, shape [S, d I].
    """

    law: SweepLaw
    planes: wp.array[Any]
    theta: wp.array[Any]
    Lu: wp.array[Any]


def sweep(bonds: Bonds, law: SweepLaw, of: Any, pieces: Sequence[str | None], *fields: Any) -> None:
    """Lays out, finds dilatations, then forces, on the pieces of these names, None for none; of
    values by number, planes, dilatations and forces by number."""
    layout, (_, planes, theta, out) = bonds.layout, fields
    if bonds.plain:
        kernels = plain(bonds.scalar, bonds.dimension)
        for name, kernel, given in zip(
            pieces[1:], (kernels.dilatation, kernels.force), ((planes, theta), (planes, theta, out))
        ):
            if name:
                piece = layout.pieces[name]
                launch(kernel, (len(theta), len(piece)), (piece, of, *given[:-1]), given[-1:])
        return
    key = (*pieces, len(theta), get_num_threads(), law.fields)
    ready = layout.ready.setdefault(key, [])
    try:
        shared, ends, last = ready.pop()
    except IndexError:
        kernels, last, known = law.kernels, of, [one.__ctype__() for one in fields]
        ends = [type(one).from_buffer_copy(one) for one in known]
        nodes: list[Any] = [layout.pieces[name] for name in pieces]
        work = sum(map(len, nodes)) * len(theta) * max(1, kernels.lanes // FASTER)
        shared = Shared(kernels.swept, (*nodes, of, None), 3 * (None,), 3, work, stay)
        for place, end in enumerate(ends, 4):
            shared.give(place, end)
    if last is not of:
        shared.give(3, of)
    for end, one in zip(ends, fields):
        end.data = one.ptr or 0
    shared()
    ready.append((shared, ends, of))


def _swept(
    bonds: Bonds, law: SweepLaw, of: Any, laid: str, asked: str | None, correct: Any, *fields: Any
) -> None:
    """A sweep in which `correct` changes θ of the nodes that have lost bonds, before forces."""
    cut = bonds.families.cut
    sweep(bonds, law, of, (laid, "needed", None if len(cut) else asked), *fields)
    if len(cut):
        theta = fields[2].numpy()
        theta[:, cut] = correct(theta[:, cut])
        fields[2].assign(theta)
        sweep(bonds, law, of, (None, None, asked), *fields)


def evaluate(bonds: Bonds, u: wp.array[Any], law: SweepLaw, *, kept: bool = True) -> Felt:
    """L u of fields [S, d N]; what its gradient reads is the caller's, unless it is not `kept`."""
    layout, samples, d = bonds.layout, len(u), bonds.dimension
    Lu = bonds.empty(samples, d * len(bonds.families.rows))
    spare = [] if kept else layout.ready.setdefault(("planes", samples), [])
    try:
        planes, theta = spare.pop()
    except IndexError:
        theta = bonds.zeros(samples, layout.places)
        planes = bonds.empty(samples, d * layout.places) if layout.in_rows else u
    corrected = lambda _: (law.table.surface @ u.numpy().T).T  # noqa: E731
    _swept(bonds, law, law.forward, "laid", "forces", corrected, u, planes, theta, Lu)
    if layout.in_rows and planes.size <= KEPT:
        spare.append((planes, theta))
    return Felt(law, planes, theta, Lu)


def pulled(
    bonds: Bonds, law: SweepLaw, g: wp.array[Any], *, displacement: bool = True
) -> tuple[Any, ...]:
    """Of g on the interior, [S, d I], Lᵗ g on all nodes; g as sweeps read it, its dilatation by the
    transpose, and that of nodes which have lost bonds apart."""
    layout, samples, d, cut = bonds.layout, len(g), bonds.dimension, bonds.families.cut
    seeds = bonds.zeros(samples, d * layout.places)
    if not layout.in_rows:
        spread = seeds.numpy().reshape(samples, -1, d)
        spread[:, bonds.families.rows] = g.numpy().reshape(samples, -1, d)
        seeds.assign(spread.reshape(samples, -1))
    tau, lost = bonds.zeros(samples, layout.places), list[np.ndarray]()
    by_u = bonds.empty(samples, d * bonds.nodes if displacement else 0)
    asked = "nodes" if displacement else None

    def apart(tau: np.ndarray) -> float:
        lost.append(tau)
        return 0.0

    _swept(bonds, law, law.back, "back", asked, apart, g, seeds, tau, by_u)
    if lost and displacement:
        by_u.assign(by_u.numpy() + (law.table.surface.T @ (law.bulk_at(cut) * lost[0]).T).T)
    return by_u, seeds, tau, *lost


def gradient(
    bonds: Bonds,
    felt: Felt,
    g: wp.array[Any],
    *,
    displacement: bool = True,
    moduli: bool = True,
    influence: bool = True,
) -> dict[str, Any]:
    """Derivatives of a scalar by name, given its derivative g [S, d I] to L u: to u, [S, d N], to λ
    and μ, numbers or one a node, and to α and D; those to moduli come with the latter."""
    law, layout, cut = felt.law, bonds.layout, bonds.families.cut
    whole = layout.pieces["whole"]
    by_u, seeds, tau, *lost = pulled(bonds, law, g, displacement=displacement)
    found = {"u": by_u} if displacement else {}
    if not (moduli or influence):
        return found
    lam, mu, alpha, D = law.values
    by_mu, by_bulk = bonds.zeros(layout.places), bonds.zeros(layout.places)
    fields = law.back, felt.planes, felt.theta, seeds, tau
    if layout.in_rows:
        by_own = bonds.zeros(BLOCKS, len(law.table.kw) * law.kernels.lanes)
    else:
        by_own = bonds.zeros(1, len(layout.end))
    outputs = by_own, by_mu, by_bulk
    if not bonds.plain:
        ends = ints(np.arange(BLOCKS + 1) * len(whole) // BLOCKS)
        weight = max(len(whole) * len(g) // BLOCKS, 1)
        inputs = ends, whole, *fields
        launch_slices(law.kernels.slopes, BLOCKS, inputs, outputs, weight=weight)
    else:
        slopes = plain(bonds.scalar, bonds.dimension).slopes
        launch(slopes, len(whole), (whole, *fields), outputs)
    bulk, shear = by_bulk.numpy(), by_mu.numpy()
    if lost:
        bulk[cut] += (felt.theta.numpy()[:, cut] * lost[0]).sum(axis=0)
    for name, part, one in (("lam", bulk, lam), ("mu", shear - bulk, mu)):
        found[name] = part[layout.home] if one.size > 1 else part.sum(dtype=float)
    if influence:
        by_kw = _by_class(law, by_own) + (_by_surface(bonds, felt, lost[0]) if lost else 0)
        found |= zip(("alpha", "D"), bonds.influence(alpha, D, by_kw))
    return found


def _by_class(law: SweepLaw, by_own: wp.array[Any]) -> np.ndarray:
    """Derivatives to K W of each class, [C], of the sums that slopes leave."""
    bonds, table, by = law.bonds, law.table, by_own.numpy().astype(float)
    if bonds.layout.in_rows:
        of = bonds.families.classes
        by = by.reshape(BLOCKS, len(table.kw), -1).sum(axis=(0, 2))
        return np.asarray((by - of.count * of.r**2 * (by @ table.kw) / table.m) / table.m)
    if bonds.lattice:
        return np.bincount(listed(bonds.points, bonds.families)[3], by[0])
    return np.asarray(by[0])


def _by_surface(bonds: Bonds, felt: Felt, lost: np.ndarray) -> np.ndarray:
    """The same of dilatations by (40–41), of `lost`, their derivatives over λ − μ: of a bond f
    p_f · S⁻¹ ξ_f − (S⁻¹ ξ_f) · (Σ_e K W p_e ⊗ S⁻¹ ξ_e) ξ_f, p that to K W S⁻¹ ξ."""
    table, (owner, end, xi, kind) = felt.law.table, bonds.left
    turned, place = inverted(bonds, table.kw[kind].astype(float))
    u = felt.planes.numpy().reshape(len(lost), -1, bonds.dimension)
    pull = (felt.law.bulk_at(bonds.families.cut) * lost)[:, place, None]
    p = (pull * (u[:, end] - u[:, owner])).sum(axis=0)
    both = np.zeros((len(bonds.families.cut), *2 * xi.shape[1:]))
    np.add.at(both, place, table.kw[kind, None, None] * p[:, :, None] * turned[:, None])
    by = (p * turned).sum(axis=1) - np.einsum("ea,eab,eb->e", turned, both[place], xi)
    return np.bincount(kind, by, len(table.kw))


class _Force(torch.autograd.Function):
    """L u as a torch function of u [S, N, d], λ, μ, α and D."""

    @staticmethod
    def forward(ctx: Any, bonds: Bonds, *inputs: torch.Tensor) -> torch.Tensor:
        ctx.bonds, u = bonds, inputs[0]
        ctx.save_for_backward(*inputs)  # the arrays share their memory
        law = bonds.law(*(value.detach().cpu().numpy() for value in inputs[1:]))
        ctx.felt = evaluate(bonds, _flat(bonds, u), law)
        return _shaped(bonds, ctx.felt.Lu)

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        inputs = ctx.saved_tensors  # an error where one was changed in place since
        g, (by_field, *learns) = _flat(ctx.bonds, upstream[0]), ctx.needs_input_grad[1:]
        asked = {"displacement": by_field, "moduli": any(learns[:2]), "influence": any(learns[2:])}
        by = gradient(ctx.bonds, ctx.felt, g, **asked)
        slopes = (
            torch.as_tensor(by[name], dtype=one.dtype, device=one.device).reshape(one.shape)
            if wanted else None
            for name, one, wanted in zip(("lam", "mu", "alpha", "D"), inputs[1:], learns)
        )  # fmt: skip
        return None, _shaped(ctx.bonds, by["u"]) if by_field else None, *slopes


def _flat(bonds: Bonds, field: torch.Tensor) -> wp.array[Any]:
    """Fields [S, ·, d] of a tensor, which share its memory, as kernels read them, [S, d ·]."""
    flat: Any = field.detach().reshape(len(field), -1).contiguous()
    if bonds.plain:
        return wp.from_torch(flat, requires_grad=False)  # type: ignore[return-value]
    return bonds.floats(flat.numpy())


def _shaped(bonds: Bonds, field: Any) -> torch.Tensor:
    """Such fields as a tensor again, [S, ·, d]."""
    if bonds.plain:
        flat: torch.Tensor = wp.to_torch(field, requires_grad=False)
    else:
        flat = torch.from_numpy(field.numpy())
    return flat.reshape(len(flat), -1, bonds.dimension)


_force: Callable[..., torch.Tensor] = _Force.apply


def lps_force(bonds: Bonds, u: torch.Tensor, solid: LPSParameters) -> torch.Tensor:
    """L u [TPa/Å] on the interior nodes, shape [..., I, d], differentiable in u and in every value
    of the solid.

    Args:
        bonds: of a point set with N nodes.
        u: displacement [Å], shape [N, d] or [S, N, d], in the precision of the bonds.
        solid: numbers, arrays or tensors; λ = μ, of which neither asks for a gradient, for bonds
            that are bond-based.

    Raises InputError for a u of another shape or type, or such λ and μ on bond-based bonds.
    """
    return force_by(bonds, u, *solid.values())


def force_by(bonds: Bonds, u: torch.Tensor, *values: Any) -> torch.Tensor:
    """`lps_force` of λ, μ, α and D, the first two numbers or one value a node, shape [N]."""
    check_field(bonds, u, bonds.device)
    refuse_tangents(u, *values)
    asked = [torch.is_grad_enabled() and getattr(one, "requires_grad", False) for one in values]
    check_bond_based(bonds, values[0], values[1], any(asked[:2]))
    fields = u.reshape(-1, bonds.nodes, bonds.dimension)
    if any(asked) or (torch.is_grad_enabled() and u.requires_grad):
        like: dict[str, Any] = {"dtype": u.dtype, "device": u.device}
        Lu = _force(bonds, fields, *(torch.as_tensor(x, **like).reshape(-1) for x in values))
    else:  # which torch takes longer to convert than a small sweep
        law = bonds.law(
            *(x.detach().cpu().numpy() if isinstance(x, torch.Tensor) else x for x in values)
        )
        Lu = _shaped(bonds, evaluate(bonds, _flat(bonds, fields), law, kept=False).Lu)
    return Lu.reshape(*u.shape[:-2], -1, bonds.dimension)


def check_bond_based(bonds: Bonds, lam: Any, mu: Any, asked: bool) -> None:
    """Refuse bonds without dilatations for λ ≠ μ, and for a gradient to one of them."""
    if bonds.bond_based and (asked or bool(torch.as_tensor(lam != mu).any())):
        raise InputError(
            "lambda, mu: expected equal values without a gradient on a collar of one horizon, "
            "which has no dilatations; a collar of two has them"
        )


def check_field(bonds: Bonds, u: torch.Tensor, device: str) -> None:
    """Refuse a displacement whose device, type or shape is not that of the bonds."""
    nodes, d, dtype = bonds.nodes, bonds.dimension, getattr(torch, bonds.scalar.__name__)
    if u.device != torch.device(device):
        raise InputError(f"u: expected a tensor on {device}, got one on {u.device}")
    fits = u.dim() in (2, 3) and u.shape[-2:] == (nodes, d) and u.shape[0] > 0
    if u.dtype != dtype or not fits:
        raise InputError(
            f"u: expected {bonds.scalar.__name__} of shape [S, {nodes}, {d}], S ≥ 1, or "
            f"[{nodes}, {d}], got {u.dtype} of shape {list(u.shape)}"
        )
