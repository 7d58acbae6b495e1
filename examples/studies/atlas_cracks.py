"""Stability atlas: learned kernels that are broken, a critical stretch misjudged, steps too long."""

import warnings

import matplotlib.pyplot as plt
import numpy as np

from examples.cracks.energy_release import energy_release, tip_shift
from examples.static_crack import edge_crack
from examples.studies.atlas_entry import Entry, words
from warp_peri import Cracked, Model, Points
from warp_peri.damage import (
    BrittleSolid,
    LatticeBody,
    apparent_toughness,
    box,
    lattice_body,
    positive_kernel,
    rectangle,
)
from warp_peri.damage.motion import BreakingBody, step
from warp_peri.damage.operator import bond_weights, cut_matrix, stiffness_across
from warp_peri.damage.stability import check_breakable, negative_eigenvalues
from warp_peri.points.families import bond_classes
from warp_peri.points.unit_names import REDUCED

SHARES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


RATIOS = (2.0, 3.0, 4.0, 6.0)
PLANES = {"{110}": (1, 1, 0), "{111}": (1, 1, 1), "{210}": (2, 1, 0)}


def broken_at_random(body: LatticeBody, share: float, seed: int) -> np.ndarray:
    """Neighbours with a share of the bonds near the middle broken, both directions at once."""
    random, neighbour = np.random.default_rng(seed), body.neighbour.copy()
    near = np.linalg.norm(body.x, axis=1) < 8 * body.spacing
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


def in_space(cells: int = 12) -> Entry:
    """Kernels that are broken in space, and what straight cuts along other planes take."""
    body = lattice_body(box((cells,) * 3, 1.0), 1.0, 2.0)
    free = np.repeat((np.abs(body.x) < cells / 2 - 2).all(axis=1), 3)
    positive = Model(0.3, 0.8, 1.0, np.ones(1), horizon=2.0, dimension=3)
    waving = Model(0.3, 0.8, 1.0, np.array([1.0, -0.22]), horizon=2.0, dimension=3)
    counts: dict[str, list[int]] = {}
    for name, model in (("changes sign", waving), ("K = 1/r", positive)):
        w = bond_weights(model, body.classes)
        counts[name] = []
        for share in SHARES:
            matrix = cut_matrix(
                body,
                w,
                broken_at_random(body, share, seed=0),
                model.mu,
                model.lam - model.mu,
            )
            counts[name].append(negative_eigenvalues(matrix[free][:, free]))
    takes = {
        label: [_cut_along(normal, ratio) / _cut_along((0, 1, 0), ratio) for ratio in RATIOS]
        for label, normal in PLANES.items()
    }
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.6), layout="constrained")
    for name, values in counts.items():
        left.plot(100 * np.array(SHARES), values, "o-", label=name)
    left.set(xlabel="bonds broken in a block [%]", ylabel="negative eigenvalues")
    for label, shares in takes.items():
        right.plot(RATIOS, shares, "o-", label=label)
    right.axhline(1, color="0.7")
    right.set(xlabel="δ / h", ylabel="energy of a straight cut over that of {100}")
    for ax in (left, right):
        ax.legend(frameon=False)
    coarse = [shares[0] for shares in takes.values()]
    fine = [shares[-1] for shares in takes.values()]
    at = int(np.flatnonzero(counts["changes sign"])[0])
    first = SHARES[at]
    return Entry(
        title="Cracks in space",
        number=f"with {100 * first:g} % of the bonds broken, {counts['changes sign'][at]} negative "
        f"eigenvalues; {max(counts['K = 1/r'])} for a positive kernel at any share",
        text="A kernel that changes sign is no more a solid in space than in the plane. Of a positive one "
        "the direction matters a little: a critical stretch is that of a cut along a plane of nodes, "
        f"{{100}}; straight cuts along other planes take {min(coarse):.2f} to {max(coarse):.2f} of its "
        f"energy at δ = {RATIOS[0]:g}h, {min(fine):.2f} to {max(fine):.2f} at {RATIOS[-1]:g}h. What a "
        "front spends that grows is another matter ([cracks](cracks.md#in-space)).",
        seen=[words(lambda: check_breakable(waving, body.classes))],
        figure=figure,
        values={"shares": SHARES, "negative": counts, "ratios": RATIOS, "cuts": takes},
    )


def _cut_along(normal: tuple[int, ...], ratio: float) -> float:
    """Energy over area and stretch² of a straight cut with λ = μ = 1, over the horizon (V5)."""
    classes = bond_classes(1.0, ratio, dimension=3)
    model = Model(1.0, 1.0, 1.0, np.ones(1), horizon=ratio, dimension=3)
    rise = classes.xi @ np.array(normal) / np.linalg.norm(normal)
    r2 = (classes.xi.astype(float) ** 2).sum(axis=1)
    return float(15 * (np.maximum(rise, 0) * bond_weights(model, classes) * r2).sum() / ratio)


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


def edge_tips(
    lengths: tuple[int, ...] = (6, 9, 13, 18, 26), ratios: tuple[float, ...] = (2.0, 3.0, 4.0)
) -> Entry:
    """Error of G of a crack from an edge over half a strip, by its length, with its tip as cut."""
    errors, shifts = {}, {}
    figure, ax = plt.subplots(figsize=(5.5, 3.6), layout="constrained")
    for color, ratio in enumerate(ratios):
        model = Model(1.0, 1.0, 1.0, np.ones(1), ratio, units=REDUCED)
        shifts[ratio] = tip_shift(model, 1.0)
        for name, by, style in (("as cut", 0.0, "o-"), ("shifted", shifts[ratio], "s--")):
            off = [100 * (edge_crack(model, n, 0.5, by) - 1) for n in lengths]
            errors[f"{ratio:g}h, {name}"] = off
            ax.plot(lengths, off, style, color=f"C{color}", label=f"δ = {ratio:g}h, {name}")
    ax.axhline(0, color="0.7")
    ax.set(xlabel="length of the crack / h", ylabel="error of G [%]", xscale="log")
    ax.set_xticks(lengths, [str(n) for n in lengths])
    ax.minorticks_off()
    ax.legend(frameon=False)
    middle = lengths.index(13) if 13 in lengths else 0
    plain, shifted = (errors[f"{ratios[-2]:g}h, {name}"][middle] for name in ("as cut", "shifted"))
    model = Model(1.0, 1.0, 1.0, np.ones(1), 3.0)
    x = rectangle(16.0, 16.0, 1.0)
    pulled = Cracked(Points(x, (np.abs(x) < 2).all(axis=1), 1.0), u=0.01 * x)
    two = [[[(-9.0, 0.0), (d, 0.0)]] for d in (-1.0, 1.0)]
    return Entry(
        title="A crack's tip acts further than it is cut",
        number=f"G of an edge crack {plain:.1f} % off as cut, {shifted:.1f} % with `tip_shift`, "
        f"{lengths[middle]} spacings long in half a strip at δ = {ratios[-2]:g}h",
        text="Bonds across the tip's last row are whole, and yet the crack opens there. So it acts as if it were "
        f"longer, by {', '.join(f'{s:.2f}' for s in shifts.values())} spacings for δ = "
        f"{', '.join(f'{r:g}' for r in ratios)}h, and G is off where little of the strip is left. `tip_shift` finds the length once "
        "for a solid and its lattice (C25); `energy_release(…, shift=…)` takes it off. Edges that are too soft are "
        "left, and at δ = 2h, where the two errors cancel, the shift makes G worse "
        "([table](cracks.md#a-crack-of-your-own)). Nobody is warned of the tip: the error is that of the nodes, and "
        "thirteen spacings for the crack and for what is left are the rule. The shift itself asks for three lengths.",
        seen=[words(lambda: energy_release(model, pulled, two, shift=0.1))],
        figure=figure,
        values={"lengths": lengths, "errors": errors, "shifts": shifts},
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
