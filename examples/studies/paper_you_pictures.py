"""Figures 1, 4 and 5 of the page on You et al. (2021): see paper_you_2021.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from examples.graphene_report import save_figure
from tools.make_graphene import graphene_bodies
from warp_peri.points.dataset import Dataset

HORIZON = 20.0
"""Of the family that is drawn [Å]."""


def family(path: Path) -> None:
    """Figure 1: the family of a node of the 5 Å lattice, a bond and its force vectors."""
    x = 5.0 * (np.argwhere(np.ones((15, 15))) - 7.0)
    node = int(np.flatnonzero((x == 0).all(axis=1))[0])
    r = np.linalg.norm(x, axis=1)
    near, body = (r > 0) & (r <= HORIZON), r < 1.7 * HORIZON
    other = int(np.flatnonzero(near)[np.argmax(((x - x[node]) @ (2, 1))[near])])
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    left, bond = figure.subplots(1, 2)
    left.plot(*x[body].T, "o", color="0.75", markersize=4)
    left.plot(*x[near].T, "o", color="C0", markersize=5)
    turn = np.linspace(0, 2 * np.pi, 200)
    left.plot(*(x[node][:, None] + HORIZON * np.array([np.cos(turn), np.sin(turn)])), "k-")
    left.set_title(f"the family of a node, δ = {HORIZON:g} Å: {near.sum()} bonds")
    bond.plot(*x[[node, other]].T, "o-", color="C0")
    force = 0.2 * (x[other] - x[node])
    for place, sign in ((node, 1), (other, -1)):
        bond.annotate("", x[place] + sign * force, x[place], arrowprops={"arrowstyle": "->"})
    bond.annotate("x", x[node], (0, 8), textcoords="offset points")
    bond.annotate("y", x[other], (0, 8), textcoords="offset points")
    bond.set_title("a bond and its force vectors")
    for ax in (left, bond):
        ax.set(aspect="equal", xlabel="x₁ [Å]", ylabel="x₂ [Å]")
        ax.plot(*x[node], "o", color="C3", markersize=6)
    save_figure(figure, path)


def atoms(data: Dataset, path: Path) -> None:
    """Figure 4: the lattice, the sheet of atoms, the nodes."""
    sheet, _ = graphene_bodies()
    places = sheet.positions()
    middle = places.mean(axis=0)
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    near, whole, nodes = figure.subplots(1, 3)
    close = np.abs(places - middle).max(axis=1) < 8
    near.plot(*places[close].T, "o", color="C0", markersize=7)
    near.set_title("hexagonal lattice")
    whole.plot(*places.T, ".", color="C0", markersize=1)
    whole.set_title(f"{len(places)} atoms")
    inner = data["train"].x[data["train"].interior]
    nodes.plot(*inner.T, ".", color="C1", markersize=4)
    nodes.set_title(f"{len(inner)} nodes, 5 Å apart")
    for ax in (near, whole, nodes):
        ax.set(aspect="equal", xlabel="x₁ [Å]", ylabel="x₂ [Å]")
    save_figure(figure, path)


def fields(data: Dataset, path: Path) -> None:
    """Figure 5: u₁ and b₁ of a training, a validation and a test sample."""
    figure = Figure(figsize=(10.5, 6.4), layout="constrained")
    titles = {"train": "training", "val": "validation", "test": "disk"}
    rows = figure.subplots(2, 3)
    for column, (name, title) in zip(rows.T, titles.items()):
        samples = data[name]
        number = 8 if name == "train" else 0
        x = samples.x[samples.interior]
        shown = {"u₁ [Å]": samples.u, "b₁ [TPa/Å]": np.asarray(samples.b)}
        for ax, (label, field) in zip(column, shown.items()):
            values = field[number][samples.interior, 0]
            limit = np.abs(values).max()
            drawn = ax.tricontourf(*x.T, values, levels=21, cmap="RdBu_r", vmin=-limit, vmax=limit)
            figure.colorbar(drawn, ax=ax, label=label, shrink=0.8)
            ax.set(
                aspect="equal", xlabel="x₁ [Å]", ylabel="x₂ [Å]", title=f"{title}, load {number}"
            )
    save_figure(figure, path)
