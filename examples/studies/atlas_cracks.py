"""Stability atlas: learned kernels that break, a critical stretch misjudged, steps too long."""

import warnings
from collections.abc import Mapping

import numpy as np

from examples.figures import curves, name_lines, panels, ticks
from examples.static_crack import edge_crack
from examples.studies.atlas_entry import Entry, entry, words
from warp_peri import Cracked, Model, Points
from warp_peri.damage import (
    BrittleSolid,
    LatticeBody,
    apparent_toughness,
    box,
    energy_release,
    lattice_body,
    positive_kernel,
    rectangle,
    tip_shift,
)
from warp_peri.damage.motion import BreakingBody, check_step, step
from warp_peri.damage.operator import bond_weights, cut_matrix, stiffness_across
from warp_peri.damage.solid import check_breakable, negative_eigenvalues
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


def negative_as_broken(
    solids: Mapping[str, Model], body: LatticeBody, inside: float
) -> dict[str, list[int]]:
    """Negative eigenvalues of each model, nodes out to `inside` free, as bonds break."""
    free = np.repeat((np.abs(body.x) < inside).all(axis=1), body.x.shape[1])
    counts: dict[str, list[int]] = {name: [] for name in solids}
    for name, solid in solids.items():
        w = bond_weights(solid, body.classes)
        for share in SHARES:
            table = broken_at_random(body, share, seed=0)
            matrix = cut_matrix(body, w, table, solid.mu, solid.lam - solid.mu)
            counts[name].append(negative_eigenvalues(matrix[free][:, free]))
    return counts


def broken_kernels(model: Model, spacing: float = 5.0, cells: int = 28) -> Entry:
    """Negative eigenvalues of a learned model and of its positive kernel as bonds break."""
    side = cells * spacing
    body = lattice_body(rectangle(side, side, spacing), spacing, model.horizon)
    solids = {"learned": model, "K = 1/r": positive_kernel(model, model.horizon)}
    counts = negative_as_broken(solids, body, side / 2 - model.horizon)
    plus, minus = (100 * part for part in stiffness_across(model, body.classes))
    figure, ax = panels(5, 3.5)
    axes = {"xlabel": "bonds broken near the middle [%]", "ylabel": "negative eigenvalues"}
    curves(ax, "plot", 100 * np.array(SHARES), counts, "o-", **axes)
    most = max(counts["K = 1/r"])
    numbers = {"counts": counts["learned"][3], "most": most, "plus": plus, "minus": minus}
    values = {"shares": SHARES, "negative": counts, "across": [plus, minus]}
    seen = (lambda: check_breakable(model, body.classes),)
    return entry("broken", numbers, seen, figure, values)


def in_space(cells: int = 12) -> Entry:
    """Kernels that are broken in space, and what straight cuts along other planes take."""
    body = lattice_body(box((cells,) * 3, 1.0), 1.0, 2.0)
    waving, positive = (
        Model(0.3, 0.8, 1.0, np.array(D), horizon=2.0, dimension=3) for D in ([1.0, -0.22], [1.0])
    )
    solids = {"changes sign": waving, "K = 1/r": positive}
    counts = negative_as_broken(solids, body, cells / 2 - 2)
    takes = {
        label: [_cut_along(normal, ratio) / _cut_along((0, 1, 0), ratio) for ratio in RATIOS]
        for label, normal in PLANES.items()
    }
    figure, (left, right) = panels(9.2, 3.6, count=2)
    axes = {"xlabel": "bonds broken in a block [%]", "ylabel": "negative eigenvalues"}
    curves(left, "plot", 100 * np.array(SHARES), counts, "o-", **axes)
    axes = {"xlabel": "horizon over spacing, δ/h", "ylabel": "energy of a cut over that of {100}"}
    curves(right, "plot", RATIOS, takes, "o-", **axes)
    right.axhline(1, color="0.7")
    coarse, fine = ([shares[place] for shares in takes.values()] for place in (0, -1))
    at = int(np.flatnonzero(counts["changes sign"])[0])
    numbers = {
        "share": 100 * SHARES[at], "counts": counts["changes sign"][at],
        "most": max(counts["K = 1/r"]), "least_coarse": min(coarse), "most_coarse": max(coarse),
        "coarse": RATIOS[0], "least_fine": min(fine), "most_fine": max(fine), "fine": RATIOS[-1],
    }  # fmt: skip
    values = {"shares": SHARES, "negative": counts, "ratios": RATIOS, "cuts": takes}
    seen = (lambda: check_breakable(waving, body.classes),)
    return entry("cracks-in-space", numbers, seen, figure, values)


def _cut_along(normal: tuple[int, ...], ratio: float) -> float:
    """Energy over area and stretch² of a straight cut with λ = μ = 1, over the horizon (V5)."""
    classes = bond_classes(1.0, ratio, dimension=3)
    model = Model(1.0, 1.0, 1.0, np.ones(1), horizon=ratio, dimension=3)
    rise = classes.xi @ np.array(normal) / np.linalg.norm(normal)
    r2 = (classes.xi.astype(float) ** 2).sum(axis=1)
    return float(15 * (np.maximum(rise, 0) * bond_weights(model, classes) * r2).sum() / ratio)


def misjudged_stretch(cells: int = 12, length: int = 2) -> Entry:
    """What a growing crack spends over the toughness its critical stretch was made for."""
    models = {lam: Model(lam, 1.0, 1.0, np.ones(1), horizon=3.0) for lam in (-0.3, 1.0, 3.0)}
    ratios = {
        lam: apparent_toughness(model, 1.0, cells=cells, length=length)
        for lam, model in models.items()
    }
    figure, ax = panels(5, 3.5)
    ax.plot(list(ratios), list(ratios.values()), "o-")
    ax.axhline(1, color="0.7")
    ax.set(xlabel="ratio of the Lamé constants, λ/μ", ylabel="energy of growth / toughness")
    body = lattice_body(rectangle(12.0, 10.0, 1.0), 1.0, 3.0)
    solid = BrittleSolid(models[1.0], 1.0, critical_stretch=0.01)
    numbers = {"least": min(ratios.values()), "most": max(ratios.values())}
    values = {"ratios": {str(lam): value for lam, value in ratios.items()}}
    seen = (lambda: BreakingBody(solid, body).start(u=0.02 * body.x * (0.0, 1.0)),)
    return entry("stretch", numbers, seen, figure, values)


def edge_tips(
    lengths: tuple[int, ...] = (6, 9, 13, 18, 26), ratios: tuple[float, ...] = (2.0, 3.0, 4.0)
) -> Entry:
    """Error of G of a crack from an edge over half a strip, by its length, with its tip as cut."""
    errors, shifts = {}, {}
    figure, ax = panels(5.5, 3.6)
    for color, ratio in enumerate(ratios):
        model = Model(1.0, 1.0, 1.0, np.ones(1), ratio, units=REDUCED)
        shifts[ratio] = tip_shift(model, 1.0)
        for name, by, style in (("as cut", 0.0, "o-"), ("shifted", shifts[ratio], "s--")):
            off = [100 * (edge_crack(model, n, 0.5, by) - 1) for n in lengths]
            errors[f"{ratio:g}h, {name}"] = off
            ax.plot(lengths, off, style, color=f"C{color}", label=f"δ = {ratio:g}h, {name}")
    ax.axhline(0, color="0.7")
    ax.set(xlabel="length of the crack [spacings]", xscale="log")
    ax.set_ylabel("error of the energy release rate [%]")
    ticks(ax, lengths)
    name_lines(ax)
    middle = lengths.index(13) if 13 in lengths else 0
    plain, shifted = (errors[f"{ratios[-2]:g}h, {name}"][middle] for name in ("as cut", "shifted"))
    model = Model(1.0, 1.0, 1.0, np.ones(1), 3.0)
    x = rectangle(16.0, 16.0, 1.0)
    pulled = Cracked(Points(x, (np.abs(x) < 2).all(axis=1), 1.0), u=0.01 * x)
    two = [[[(-9.0, 0.0), (d, 0.0)]] for d in (-1.0, 1.0)]
    numbers = {
        "plain": plain, "shifted": shifted, "length": lengths[middle], "ratio": ratios[-2],
        "shifts": ", ".join(f"{s:.2f}" for s in shifts.values()),
        "ratios": ", ".join(f"{r:g}" for r in ratios),
    }  # fmt: skip
    values = {"lengths": lengths, "errors": errors, "shifts": shifts}
    seen = (lambda: energy_release(model, pulled, two, shift=0.1),)
    return entry("edge-tips", numbers, seen, figure, values)


def long_steps(steps: int = 200) -> Entry:
    """Energy of a body without load on either side of the longest step."""
    body = lattice_body(rectangle(20.0, 20.0, 1.0), 1.0, 3.0)
    model = Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=3.0)
    solid = BreakingBody(BrittleSolid(model, 1.0, critical_stretch=1e6), body)
    wave = np.where((np.arange(20)[:, None] + np.arange(20)) % 2, 1.0, -1.0).reshape(-1, 1)
    figure, ax = panels(5, 3.5)
    last = {}
    for share in (0.98, 1.1):
        state, energies = solid.start(v=1e-3 * wave * (1.0, 1.0)), []
        for _ in range(steps):
            step(solid, state, share * solid.longest_step)
            _, _, kinetic, elastic, _ = solid.ledger(state)
            energies.append(kinetic + elastic)
        last[share] = energies[-1] / energies[0]
        ax.semilogy(energies, label=f"{share:g} × the longest step")
    ax.set(xlabel="step", ylabel="energy")
    name_lines(ax)
    with warnings.catch_warnings(action="ignore"):
        seen = words(lambda: check_step(solid, 1.1 * solid.longest_step))
    values = {"growth": {str(share): value for share, value in last.items()}}
    return entry("long-steps", {"growth": last[1.1], "steps": steps}, [seen], figure, values)
