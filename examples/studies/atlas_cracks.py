"""Stability atlas: learned kernels that are broken, a critical stretch misjudged, steps too long."""

from __future__ import annotations

import warnings

import matplotlib.pyplot as plt
import numpy as np

from examples.studies.atlas_entry import Entry, words
from warp_peri import Model
from warp_peri.damage.lattice_body import LatticeBody, lattice_body, rectangle
from warp_peri.damage.motion import BreakingBody, step
from warp_peri.damage.operator import bond_weights, cut_matrix, stiffness_across
from warp_peri.damage.slow_growth import apparent_toughness
from warp_peri.damage.solid import BrittleSolid, positive_kernel
from warp_peri.damage.stability import check_breakable, negative_eigenvalues

SHARES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


def broken_at_random(body: LatticeBody, share: float, seed: int) -> np.ndarray:
    """Neighbours with a share of the bonds near the middle broken, both directions at once."""
    random, neighbour = np.random.default_rng(seed), body.neighbour.copy()
    near = np.hypot(*body.x.T) < 8 * body.spacing
    node, bond = np.nonzero((neighbour >= 0) & near[:, None])
    far = neighbour[node, bond]
    kept = (node < far) & near[far]
    node, bond, far = node[kept], bond[kept], far[kept]
    chosen = random.random(len(node)) < share
    node, bond, far = node[chosen], bond[chosen], far[chosen]
    neighbour[node, bond] = -1 - far
    neighbour[far, body.opposite[bond]] = -1 - node
    return neighbour


def broken_kernels(model: Model, spacing: float = 5.0, cells: int = 28) -> Entry:
    """Negative eigenvalues of a learned model and of its positive kernel as bonds break."""
    counts: dict[str, list[int]] = {}
    solids = {"learned": model, "K = 1/r": positive_kernel(model, model.horizon)}
    side = cells * spacing
    body = lattice_body(rectangle(side, side, spacing), spacing, model.horizon)
    free = np.repeat((np.abs(body.x) < side / 2 - model.horizon).all(axis=1), 2)
    for name, solid in solids.items():
        w = bond_weights(solid, body.classes)
        counts[name] = []
        for share in SHARES:
            table = broken_at_random(body, share, seed=0)
            matrix = cut_matrix(body, w, table, solid.mu, solid.lam - solid.mu)
            counts[name].append(negative_eigenvalues(matrix[free][:, free]))
    plus, minus = (100 * part for part in stiffness_across(model, body.classes))
    figure, ax = plt.subplots(figsize=(5, 3.5), layout="constrained")
    for name, values in counts.items():
        ax.plot(100 * np.array(SHARES), values, "o-", label=name)
    ax.set(xlabel="bonds broken near the middle [%]", ylabel="negative eigenvalues")
    ax.legend(frameon=False)
    return Entry(
        title="A learned kernel that is broken",
        number=f"with 2 % of the bonds broken, {counts['learned'][3]} negative eigenvalues; "
        f"{max(counts['K = 1/r'])} for a positive kernel at any share",
        text="Bonds across a line carry, per length and stretch squared, "
        f"{plus:.1f} and {minus:.1f} J/m² (3.35 Å thick): what is left after some of them break is no "
        "solid. A positive kernel with the same λ and μ stays definite whatever breaks, "
        "proven in [theory](theory.md), C2.",
        seen=[words(lambda: check_breakable(model, body.classes))],
        figure=figure,
        values={"shares": SHARES, "negative": counts, "across": [plus, minus]},
    )


def misjudged_stretch(cells: int = 12, length: int = 2) -> Entry:
    """What a growing crack spends over the toughness its critical stretch was made for."""
    ratios = {}
    for lam in (-0.3, 1.0, 3.0):
        model = Model(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=3.0)
        ratios[lam] = apparent_toughness(model, 1.0, cells=cells, length=length)
    figure, ax = plt.subplots(figsize=(5, 3.5), layout="constrained")
    ax.plot(list(ratios), list(ratios.values()), "o-")
    ax.axhline(1, color="0.7")
    ax.set(xlabel="λ/μ", ylabel="spent in growth / G_c of the straight cut")
    body = lattice_body(rectangle(12.0, 10.0, 1.0), 1.0, 3.0)
    solid = BrittleSolid(
        Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=3.0), 1.0, critical_stretch=0.01
    )
    stretched = 0.02 * body.x * (0.0, 1.0)
    return Entry(
        title="A critical stretch from a formula",
        number=f"{min(ratios.values()):.2f} to {max(ratios.values()):.2f} times the toughness meant",
        text="A critical stretch is made for a straight cut whose bonds are all stretched alike. "
        "Around a tip they are not, and a growing crack spends something else. "
        "`apparent_toughness` measures it; the stretch is divided by its root.",
        seen=[words(lambda: BreakingBody(solid, body).start(u=stretched))],
        figure=figure,
        values={"ratios": {str(lam): value for lam, value in ratios.items()}},
    )


def long_steps(steps: int = 200) -> Entry:
    """Energy of a body without load on either side of the longest step."""
    body = lattice_body(rectangle(20.0, 20.0, 1.0), 1.0, 3.0)
    model = Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=3.0)
    solid = BreakingBody(BrittleSolid(model, 1.0, critical_stretch=1e6), body)
    wave = np.where((np.arange(20)[:, None] + np.arange(20)) % 2, 1.0, -1.0).reshape(-1, 1)
    figure, ax = plt.subplots(figsize=(5, 3.5), layout="constrained")
    last = {}
    for share in (0.98, 1.1):
        state, energies = solid.start(v=1e-3 * wave * (1.0, 1.0)), []
        for _ in range(steps):
            step(solid, state, share * solid.longest_step)
            ledger = solid.ledger(state)
            energies.append(ledger.kinetic + ledger.elastic)
        last[share] = energies[-1] / energies[0]
        ax.semilogy(energies, label=f"{share:g} × the longest step")
    ax.set(xlabel="step", ylabel="energy")
    ax.legend(frameon=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from warp_peri.damage.motion import check_step

        seen = words(lambda: check_step(solid, 1.1 * solid.longest_step))
    return Entry(
        title="Steps beyond what breaking allows",
        number=f"energy times {last[1.1]:.1e} in {steps} steps at 1.1 times the longest step",
        text="The longest step is proven for every body and any breaking (C9), so it is a little "
        "shorter than one body needs; a tenth beyond it waves grow in a whole square.",
        seen=[seen],
        figure=figure,
        values={"growth": {str(share): value for share, value in last.items()}},
    )
