"""Figures 1, 4 and 5 of the page on You et al. (2021): see paper_you_2021.py."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import MaxNLocator

from examples.figures import headline, outer, panels, save_figure
from tools.make_graphene import SMOOTHING_RADIUS, read_samples
from warp_peri import Dataset

HORIZON = 20.0
"""Of the family that is drawn [Å]."""
SHOWN = {"train": 8, "val": 0, "test": 0}
"""Loads that are drawn."""


def family(path: Path) -> None:
    """Figure 1: the family of a node of the 5 Å lattice, a bond and its force vectors."""
    x = 5.0 * (np.argwhere(np.ones((15, 15))) - 7.0)
    node = int(np.flatnonzero((x == 0).all(axis=1))[0])
    r = np.linalg.norm(x, axis=1)
    near, body = (r > 0) & (r <= HORIZON), r < 1.7 * HORIZON
    other = int(np.flatnonzero(near)[np.argmax(((x - x[node]) @ (2, 1))[near])])
    figure, (left, bond) = panels(8, 3.8, count=2)
    left.plot(*x[body].T, "o", color="0.75", markersize=4)
    left.plot(*x[near].T, "o", color="C0", markersize=5)
    turn = np.linspace(0, 2 * np.pi, 200)
    left.plot(*(x[node][:, None] + HORIZON * np.array([np.cos(turn), np.sin(turn)])), "k-")
    left.set_title(f"the family of a node: {near.sum()} bonds, δ = {HORIZON:g} Å")
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
    headline(figure, "A node has a bond with every node within the horizon")
    save_figure(figure, path)


def atoms(data: Dataset, cache: Path, path: Path) -> None:
    """Figure 4: lattice and nodes with the cone of one, atoms and nodes under a training load."""
    loaded, x = read_samples(cache, "train")[2][SHOWN["train"]], data["train"].x
    places = loaded.reference
    r = np.linalg.norm(places, axis=1)
    figure, (near, whole, nodes) = panels(11.5, 3.6, count=3)
    close = np.abs(places).max(axis=1) < 13
    cone = np.clip(1 - r / SMOOTHING_RADIUS, 0, None)[close]
    drawn = near.scatter(*places[close].T, c=cone, s=16, cmap="Blues", edgecolors="0.6", lw=0.4)
    figure.colorbar(drawn, ax=near, label="cone of the middle node", shrink=0.8)
    near.plot(*x[np.abs(x).max(axis=1) < 13].T, "+", color="C1", markersize=9)
    turn = np.linspace(0, 2 * np.pi, 200)
    near.plot(*(SMOOTHING_RADIUS * np.array([np.cos(turn), np.sin(turn)])), "C1-", linewidth=1)
    near.set_title("atoms, nodes (+), a cone")
    inside = data["train"].interior
    u = {"atoms": loaded.displacement[:, 0], "nodes": data["train"].u[SHOWN["train"], inside, 0]}
    most = np.abs(u["atoms"]).max()
    style: Any = {"cmap": colormaps["RdBu_r"].resampled(15), "vmin": -most, "vmax": most}
    style |= {"linewidths": 0, "antialiaseds": False}  # few colours: a page is not to be large
    whole.scatter(*(places + loaded.displacement).T, c=u["atoms"], s=4, **style)
    whole.set_title(f"{len(places)} atoms under a load")
    drawn = nodes.scatter(*x[inside].T, c=u["nodes"], s=16, **style)
    nodes.set_title(f"{inside.sum()} nodes, 5 Å apart")
    figure.colorbar(drawn, ax=[whole, nodes], label="u₁ [Å]", shrink=0.8)
    for ax in (near, whole, nodes):
        ax.set_aspect("equal")
    outer(np.array([[near, whole, nodes]]), "x₁ [Å]", "x₂ [Å]")
    headline(figure, "A cone around each node smooths the atoms' displacements onto it")
    save_figure(figure, path, dpi=140)


def fields(data: Dataset, path: Path) -> None:
    """Figure 5: u₁ and b₁ of a training, a validation and a test sample."""
    figure, grid = panels(11, 6, count=3, rows=2)
    titles = {"train": "training load", "val": "validation load", "test": "disk"}
    for column, (name, title) in zip(grid.T, titles.items()):
        samples, number = data[name], SHOWN[name]
        x = samples.x[samples.interior]
        shown = {"u₁ [Å]": samples.u, "b₁ [GPa/Å]": 1e3 * np.asarray(samples.b)}
        for ax, (label, field) in zip(column, shown.items()):
            values = field[number][samples.interior, 0]
            limit = np.abs(values).max()
            drawn = ax.tricontourf(*x.T, values, levels=21, cmap="RdBu_r", vmin=-limit, vmax=limit)
            bar = figure.colorbar(drawn, ax=ax, label=label, shrink=0.75)
            bar.locator = MaxNLocator(5, symmetric=True)
            bar.update_ticks()
            ax.set(aspect="equal", title=f"{title}, {label[:2]}")
    outer(grid, "x₁ [Å]", "x₂ [Å]")
    headline(figure, "Waves teach the model; another load and disks test it")
    save_figure(figure, path)
