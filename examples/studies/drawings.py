"""Drawings that explain: from atoms to an answer; interior, collar and horizon; which model
when; speed against accuracy; why the influence function changes sign; what is proven; what an
error bar says.

The first three are sketches, but the disk of the first is computed: docs/disk.png, by
`make graphene`. The others show data: speed against accuracy as the library keeps it, and
graphene's waves and disks, with models that are fitted here in seconds.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Ellipse, FancyArrowPatch, Polygon, Rectangle
from scipy.optimize import least_squares

import warp_peri as wp
from examples.predict import rich_law
from examples.train_graphene import DATA, SMOOTHING_RADIUS, make_data
from warp_peri.damage import LatticeBody, lattice_body, positive_kernel, rectangle
from warp_peri.damage.operator import bond_weights, cut_matrix
from warp_peri.damage.solid import negative_eigenvalues
from warp_peri.methods import Optimum
from warp_peri.points.families import bond_classes
from warp_peri.prediction import Family
from warp_peri.regression.coordinates import Coordinates, Parameters
from warp_peri.regression.losses import reduce, sample_weights

DOCS = Path(__file__).resolve().parent.parent.parent / "docs"
ATOM, NODE, FORCE, GOOD = "0.55", "#1f4e79", "#b5382a", "#2e7d32"
DISK = (slice(108, 391), slice(492, 777))
"""Rows and columns of the model's displacement in docs/disk.png."""
H = 5.0
"""Spacing of the nodes of graphene's data [Å]."""
ARROW = {"arrowstyle": "<->", "color": "k", "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}


def honeycomb(cells: int) -> np.ndarray:
    """Atoms of a graphene-like sheet with bonds of length 1 around the origin."""
    first, second = np.array([1.5, np.sqrt(3) / 2]), np.array([1.5, -np.sqrt(3) / 2])
    i, j = np.meshgrid(np.arange(-cells, cells + 1), np.arange(-cells, cells + 1))
    corners = i.reshape(-1, 1) * first + j.reshape(-1, 1) * second
    return np.concatenate([corners, np.add(corners, [1.0, 0.0])])


def within(x: np.ndarray, half: float) -> np.ndarray:
    return x[(np.abs(x) <= half).all(axis=1)]


def atoms_under_a_wave(ax: Axes) -> None:
    atoms = within(honeycomb(8), 5.6)
    ax.scatter(atoms[:, 0], atoms[:, 1], s=5, color=ATOM, linewidths=0)
    x, y = np.meshgrid(np.linspace(-5, 5, 7), np.linspace(-5, 5, 5))
    force = np.sin(2 * np.pi * x / 10)
    ax.quiver(x, y, force, 0 * x, color=FORCE, scale=9, width=0.016, headwidth=4)
    ax.set(xlim=(-6, 6), ylim=(-6, 6), aspect="equal")


def smoothing_on_nodes(ax: Axes) -> None:
    atoms = within(honeycomb(8), 5.6)
    ax.scatter(atoms[:, 0], atoms[:, 1], s=5, color="0.8", linewidths=0)
    for radius in np.linspace(3.2, 0.2, 12):
        ax.add_patch(Circle((0, 0), radius, color=NODE, alpha=0.05, linewidth=0))
    line = np.arange(-2, 3) * 2.6
    x, y = np.meshgrid(line, line)
    ax.scatter(x, y, s=16, marker="s", color=NODE, linewidths=0, zorder=3)
    ax.set(xlim=(-6, 6), ylim=(-6, 6), aspect="equal")


def kernel_that_changes_sign(ax: Axes) -> None:
    r = np.linspace(0.6, 4.2, 300)
    lengths = np.sqrt([1, 2, 4, 5, 8, 9, 10, 13, 16])

    def kernel(r: np.ndarray) -> np.ndarray:
        return np.cos(3.6 * (r - 1.1)) * np.exp(-0.55 * r)

    ax.axhline(0, color="0.6", linewidth=0.8)
    ax.plot(r, kernel(r), color=NODE, linewidth=1.2)
    ax.plot(lengths, kernel(lengths), "o", color=NODE, markersize=3.5)
    ax.text(4.35, -0.06, "r", ha="right", va="top")
    ax.text(1.75, 0.42, "K(r) > 0", color=NODE)
    ax.text(2.15, -0.4, "K(r) < 0", color=FORCE)
    ax.fill_between(r, kernel(r), 0, where=kernel(r) < 0, color=FORCE, alpha=0.25, linewidth=0)
    ax.set(xlim=(0.4, 4.4), ylim=(-0.55, 0.65))


def waves_above_a_bound(ax: Axes) -> None:
    k = np.linspace(0, 1, 200)
    ax.plot(k, 0.98 - 0.33 * k**2 + 0.06 * np.sin(9 * k) * k, color=NODE, linewidth=1.2)
    ax.axhline(0.52, color=GOOD, linewidth=1.2, linestyle="--")
    ax.axhspan(-0.25, 0.0, color=FORCE, alpha=0.18, linewidth=0)
    ax.text(0.5, -0.135, "unstable", color=FORCE, ha="center", va="center")
    ax.text(0.5, 0.47, "proven bound", color=GOOD, ha="center", va="top")
    ax.text(0.5, 1.02, "stiffness of waves", color=NODE, ha="center", fontsize=8.5)
    ax.text(0.5, 0.13, "✓", color=GOOD, ha="center", fontsize=13)
    ax.set(xlim=(0, 1), ylim=(-0.25, 1.25))


def unseen_disk(ax: Axes) -> None:
    ax.imshow(plt.imread(DOCS / "disk.png")[DISK], interpolation="nearest")


STATIONS = (
    (atoms_under_a_wave, "atoms under\na body force", "simulate"),
    (smoothing_on_nodes, "means on nodes,\na cone each", "coarse-grain"),
    (kernel_that_changes_sign, "a nonlocal model,\nits kernel K(r)", "fit"),
    (waves_above_a_bound, "exactly one\nequilibrium", "certify"),
    (unseen_disk, "an unseen disk,\nerror 1 %", "solve, evaluate"),
)


def from_atoms_to_answer(path: Path) -> None:
    figure, axes = plt.subplots(1, 5, figsize=(7.2, 1.95))
    figure.subplots_adjust(0.015, 0.11, 0.985, 0.83, wspace=0.22)
    for ax, (draw, title, verb) in zip(axes, STATIONS, strict=True):
        draw(ax)
        ax.set(xticks=[], yticks=[], box_aspect=1)
        ax.set_title(title, fontsize=9)
        ax.text(
            0.5, -0.09, verb, family="monospace", fontsize=9, ha="center", va="top",
            transform=ax.transAxes,
        )  # fmt: skip
    middle = (axes[0].get_position().y0 + axes[0].get_position().y1) / 2
    for left, right in pairwise(axes):
        a, b = left.get_position(), right.get_position()
        arrow = FancyArrowPatch(
            (a.x1 + 0.003, middle), (b.x0 - 0.003, middle), arrowstyle="-|>", mutation_scale=9,
            color="0.2", transform=figure.transFigure,
        )  # fmt: skip
        figure.add_artist(arrow)
    figure.savefig(path)
    plt.close(figure)


def measure(ax: Axes, start: tuple, end: tuple, text: str, at: tuple, **options: Any) -> None:
    ax.annotate("", end, start, arrowprops=ARROW)
    ax.text(at[0], at[1], text, **options)


def interior_collar_horizon(path: Path) -> None:
    """In spacings: δ = 3, a = 4, L = a + 2 δ = 10."""
    delta, a, reach = 3.0, 4.0, 10.0
    centre = np.array([-3.0, 3.0])
    line = np.arange(-reach, reach + 1)
    nodes = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    inside = (np.abs(nodes) <= a).all(axis=1)
    family = np.linalg.norm(nodes - centre, axis=1) <= delta + 1e-9
    figure, ax = plt.subplots(figsize=(7.2, 4.3))
    ax.add_patch(Rectangle((-10.5, -10.5), 21, 21, color="#e8e8e8", linewidth=0))
    ax.add_patch(Rectangle((-4.5, -4.5), 9, 9, color="#cfe2f3", linewidth=0))
    for node in nodes[family]:
        ax.plot(*np.transpose([centre, node]), color=FORCE, linewidth=0.6, alpha=0.7)
    ax.add_patch(Circle(tuple(centre), delta, fill=False, color=FORCE, linewidth=1.2))
    ax.scatter(nodes[~inside, 0], nodes[~inside, 1], s=5, color="0.5", linewidths=0, zorder=3)
    ax.scatter(nodes[inside, 0], nodes[inside, 1], s=7, color=NODE, linewidths=0, zorder=3)
    ax.scatter(centre[0], centre[1], s=22, color=FORCE, zorder=4)
    measure(ax, (0, -5.3), (4, -5.3), "a", (2, -6.1), ha="center", va="center")
    measure(ax, (4, 1), (10, 1), "2 δ", (7, 1.7), ha="center", va="center", weight="bold")
    measure(ax, (0, -11.3), (10, -11.3), "L", (5, -12.2), ha="center", va="center")
    measure(ax, (-10, -11.3), (-9, -11.3), "h", (-9.5, -12.2), ha="center", va="center")
    ax.add_patch(Polygon([(0, -4.6), (0, -11.6)], closed=False, color="0.4", linewidth=0.7))
    for x, y, text, color, ground in (
        (1, -2, "interior", NODE, "#cfe2f3"),
        (0, 8, "collar", "0.2", "#e8e8e8"),
        (-3, 7, "horizon δ", FORCE, "#e8e8e8"),
    ):
        box = {"facecolor": ground, "pad": 0.8, "linewidth": 0}
        ax.text(x, y, text, color=color, ha="center", va="center", weight="bold", bbox=box)
    rows = (
        ("interior", "Displacement is solved for.\nThe load is known.", NODE),
        ("collar", "Two horizons wide.\nDisplacement is given here.", "0.2"),
        ("family", "All nodes within the horizon.\nEach line is a bond.", FORCE),
    )
    for i, (name, text, color) in enumerate(rows):
        ax.text(13, 9.6 - 4.3 * i, name, color=color, weight="bold")
        ax.text(13, 9.1 - 4.3 * i, text, va="top")
    letters = (
        ("a", "--interior", "half width of the interior"),
        ("δ", "--horizon", "radius of a family"),
        ("h", "--spacing", "distance of nodes"),
        ("L", "--reach", "half width with nodes"),
    )
    for i, (letter, option, text) in enumerate(letters):
        ax.text(13, -4.2 - 1.9 * i, letter, weight="bold")
        ax.text(14.2, -4.2 - 1.9 * i, option, family="monospace")
        ax.text(20.4, -4.2 - 1.9 * i, text)
    ax.text(13, -12.2, "L ≥ a + 2 δ", weight="bold")
    ax.set(xlim=(-10.8, 32.5), ylim=(-13, 10.8), aspect="equal")
    ax.axis("off")
    figure.subplots_adjust(0.005, 0.005, 0.995, 0.995)
    figure.savefig(path)
    plt.close(figure)


def mesh(ax: Axes, line: np.ndarray, moved: Callable[[np.ndarray], np.ndarray]) -> None:
    """A square grid, moved."""
    for c in line:
        for x in (np.stack([line, 0 * line + c], axis=1), np.stack([0 * line + c, line], axis=1)):
            ax.plot(*moved(x).T, color=NODE, linewidth=0.9)


def stretched_sheet(ax: Axes) -> None:
    mesh(ax, np.linspace(-0.5, 0.5, 6), lambda x: x * [1.7, 0.75])
    for sign in (-1, 1):
        ax.annotate("", (1.25 * sign, 0), (0.9 * sign, 0), arrowprops={"arrowstyle": "-|>"})


def sheet_with_a_crack(ax: Axes) -> None:
    x = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 9), np.linspace(-0.5, 0.5, 5)), -1)
    x = x.reshape(-1, 2)
    x[:, 1] += np.where(x[:, 0] < 0.1, 0.09 * np.sign(x[:, 1] + 0.1), 0)
    ax.scatter(x[:, 0], x[:, 1], s=7, color=NODE, linewidths=0)
    ax.plot([-1, -0.4, 0.1], [-0.13, -0.1, -0.13], color=FORCE, linewidth=1.4)


def softening_stress(ax: Axes) -> None:
    strain = np.linspace(0, 1, 50)
    ax.plot(2 * strain - 1, 1.25 * strain - 0.6, color="0.6", linewidth=0.9, linestyle="--")
    ax.plot(2 * strain - 1, 1.25 * strain - 0.55 * strain**2 - 0.6, color=NODE, linewidth=1.4)
    ax.text(0.95, -0.5, "strain", ha="right", va="center")
    ax.text(-0.95, 0.52, "stress", ha="left", va="center")


def bonds_with_matrices(ax: Axes) -> None:
    for turn, length in enumerate((0.5, 0.72) * 4):
        angle = np.pi / 4 * turn
        end = length * np.array([np.cos(angle), np.sin(angle)]) * [1.15, 0.8]
        ax.plot([0, end[0]], [0, end[1]], color="0.5", linewidth=0.8)
        ellipse = Ellipse(tuple(end), 0.34, 0.16, angle=np.rad2deg(angle) + 25, color=NODE)
        ellipse.set_alpha(0.75)
        ax.add_patch(ellipse)
    ax.scatter(0, 0, s=14, color=FORCE, zorder=3)


def family_in_a_circle(ax: Axes) -> None:
    line = np.arange(-4, 5) * 0.2
    x = np.stack(np.meshgrid(line, line[1:-1]), -1).reshape(-1, 2)
    near = np.hypot(*x.T) <= 0.5
    for node in x[near]:
        ax.plot([0, node[0]], [0, node[1]], color=FORCE, linewidth=0.5)
    ax.scatter(x[:, 0], x[:, 1], s=5, color=NODE, linewidths=0)
    ax.add_patch(Circle((0, 0), 0.52, fill=False, color=FORCE, linewidth=1.1))


QUESTIONS = (
    ("Does it stretch by more\nthan 10 %?", stretched_sheet, "sheet energy model",
     "tissue.Dictionary"),
    ("Will bonds break?", sheet_with_a_crack, "LPS, positive kernel", "damage.BrittleSolid"),
    ("Do strains exceed 1 %?", softening_stress, "third-order model",
     "ThirdOrder(Micromodulus(…))"),
    ("Is it anisotropic, in space,\nor are phonons the data?", bonds_with_matrices,
     "crystal model", "Micromodulus"),
    ("None of these", family_in_a_circle, "linear peridynamic solid", "LPS"),
)  # fmt: skip
"""Question, thumbnail, model, and its name in the code."""


def which_model(path: Path) -> None:
    height = 0.92
    tall = height * len(QUESTIONS) + 0.08
    figure = plt.figure(figsize=(7.2, tall))
    whole = figure.add_axes((0, 0, 1, 1))
    whole.set(xlim=(0, 7.2), ylim=(0, tall))
    whole.axis("off")
    for number, (question, thumbnail, name, code) in enumerate(QUESTIONS):
        last = number == len(QUESTIONS) - 1
        y = tall - height * (number + 0.5) - 0.04
        box = {"facecolor": "#eef3f8" if not last else "#f2f2f2", "edgecolor": NODE, "pad": 5}
        whole.text(1.15, y, question, ha="center", va="center", bbox=box)
        arrow = {"arrowstyle": "-|>", "color": "0.25", "linewidth": 1.0}
        whole.annotate("", (3.02, y), (2.25, y), arrowprops=arrow)
        if not last:
            whole.text(2.6, y + 0.07, "yes", ha="center", va="bottom", color=GOOD)
            whole.annotate("", (1.15, y - 0.67), (1.15, y - 0.27), arrowprops=arrow)
            whole.text(1.22, y - 0.46, "no", ha="left", va="center", color=FORCE)
        ax = figure.add_axes((3.1 / 7.2, (y - 0.4) / tall, 1.3 / 7.2, 0.8 / tall))
        thumbnail(ax)
        ax.set(xlim=(-1.3, 1.3), ylim=(-0.8, 0.8), aspect="equal")
        ax.axis("off")
        whole.text(4.6, y + 0.12, name, va="center", weight="bold")
        whole.text(4.6, y - 0.14, code, va="center", family="monospace")
    figure.savefig(path)
    plt.close(figure)


def transverse(model: wp.Model, k: np.ndarray) -> np.ndarray:
    """Stiffness of transverse waves along an axis over that of local elasticity, at k [1/Å]."""
    D = model.stencil(H).symbol(H * np.stack([k, 0 * k], axis=1))
    return np.asarray(D[:, 1, 1].real / (model.mu * k**2))


def transverse_of_atoms(train: wp.Samples, mu: float) -> tuple[np.ndarray, np.ndarray]:
    """k [1/Å] of the loads that push across an axis, and load over displacement, as above."""
    found = []
    for k, u, b in zip(train.arrays["wave_vector"], train.u, train.loads, strict=True):
        along, across = int(abs(k[1]) > 0), int(abs(k[1]) == 0)
        if np.count_nonzero(k) == 1 and np.abs(b[:, across]).max() > np.abs(b[:, along]).max():
            waves = np.stack([np.cos(train.x @ k), np.sin(train.x @ k)], axis=1)
            size = [np.linalg.norm(np.linalg.lstsq(waves, f[:, across])[0]) for f in (b, u)]
            found.append((abs(k[along]), size[0] / size[1] / (mu * k[along] ** 2)))
    k, stiffness = np.array(sorted(found)).T
    return k, stiffness


def cut_family(ax: Axes, model: wp.Model) -> None:
    """Bonds of a node near an edge, with the signs of a fitted kernel."""
    classes = bond_classes(H, model.horizon)
    weight = bond_weights(model, classes)
    low = weight < 0
    for bond, negative in zip(classes.xi / H, low, strict=True):
        there = bond[1] <= 2
        (line,) = ax.plot([0, bond[0]], [0, bond[1]], "-" if there else ":")
        line.set(color=FORCE if negative else NODE, linewidth=1.3 if there else 0.6)
    nodes = np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-4, 3)), -1).reshape(-1, 2)
    ax.scatter(nodes[:, 0], nodes[:, 1], s=6, color="0.45", linewidths=0, zorder=3)
    ax.axhline(2.4, color="k", linewidth=1.4)
    ax.add_patch(Circle((0, 0), 4.15, fill=False, color="0.5", linewidth=0.8))
    ax.text(0, 5.0, "free edge, bonds missing", ha="center", va="center")
    ax.text(-4.6, -5.9, "K > 0", color=NODE, va="center", weight="bold")
    ax.text(4.6, -5.9, "K < 0", color=FORCE, va="center", ha="right", weight="bold")
    ax.set(xlim=(-5.6, 5.6), ylim=(-6.7, 5.7), aspect="equal")
    ax.axis("off")


SHARES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Of bonds that are broken."""


def without_conditions(train: wp.Samples, horizon: float, degree: int) -> wp.Model:
    """The least residual of kernels of a degree, enough for all bond lengths, and nothing else."""
    grid = reduce(train, horizon, sample_weights([train], normalise=False)[0])
    (i, j), space = grid.pairs, Coordinates([grid.classes], 1.0, degree)

    def residual(y: np.ndarray) -> np.ndarray:
        point = space.point(y)
        v = point.v[0]
        return np.asarray(grid.R @ np.concatenate([v, point.kappa * v[i] * v[j], [1.0]]))

    start = space.start(Parameters(-0.2, 0.7, 1.0, np.ones(degree + 1)))
    found = space.parameters(least_squares(residual, start, x_scale="jac", xtol=1e-12).x, [])
    return wp.Model(found.lam, found.mu, found.alpha, found.D, horizon)


def broken_at_random(body: LatticeBody, share: float) -> np.ndarray:
    """Neighbours with a share of the bonds near the middle broken, both directions at once."""
    random, neighbour = np.random.default_rng(0), body.neighbour.copy()
    near = np.linalg.norm(body.x, axis=1) < 8 * body.spacing
    node, bond = np.nonzero((neighbour >= 0) & near[:, None])
    far = neighbour[node, bond]
    kept = (node < far) & near[far]
    kept[kept] = random.random(int(kept.sum())) < share
    node, bond, far = node[kept], bond[kept], far[kept]
    neighbour[node, bond], neighbour[far, body.opposite[bond]] = -1 - far, -1 - node
    return neighbour


def negative_as_broken(
    solids: Mapping[str, wp.Model], cells: int, h: float
) -> dict[str, list[int]]:
    """Negative eigenvalues of each model on a square as bonds break."""
    side, horizon = cells * h, next(iter(solids.values())).horizon
    body = lattice_body(rectangle(side, side, h), h, horizon)
    free = np.repeat((np.abs(body.x) < side / 2 - horizon).all(axis=1), 2)
    counts: dict[str, list[int]] = {}
    for name, solid in solids.items():
        w = bond_weights(solid, body.classes)
        cut = (broken_at_random(body, share) for share in SHARES)
        found = (cut_matrix(body, w, table, solid.mu, solid.lam - solid.mu) for table in cut)
        counts[name] = [negative_eigenvalues(matrix[free][:, free]) for matrix in found]
    return counts


def sign_and_its_price(data: wp.Dataset, path: Path) -> None:
    """Waves of smoothed atoms against two kernels; a cut family; what breaking bonds does."""
    lps = wp.LPS(20.0, wp.Bernstein(10), Optimum(moduli=None))
    fitted = wp.fit(data["train"], lps).material
    positive = positive_kernel(fitted, fitted.horizon)
    figure, axes = plt.subplots(1, 3, figsize=(7.2, 2.75), width_ratios=[1.15, 0.95, 1.05])
    figure.subplots_adjust(0.075, 0.17, 0.985, 0.82, wspace=0.27)
    k, atoms = transverse_of_atoms(data["train"], data.provenance["truth"]["mu"])
    fine = np.linspace(0.05, k.max() * 1.03, 100)
    axes[0].plot(fine, transverse(fitted, fine), color=FORCE)
    axes[0].plot(fine, transverse(positive, fine), color=NODE)
    axes[0].plot(k, atoms, "o", color="k", markersize=4)
    axes[0].text(0.06, 1.045, "atoms (dots)", va="bottom")
    axes[0].text(fine[-1], 0.945, "K of either sign", color=FORCE, va="top", ha="right")
    axes[0].text(0.06, 0.62, "K = 1/r > 0", color=NODE, va="bottom")
    ticks = (100, 50, 30, 20)
    axes[0].set_xticks([2 * np.pi / length for length in ticks], [str(t) for t in ticks])
    axes[0].set(xlabel="wavelength [Å]", ylim=(0, 1.2), ylabel="stiffness / local elasticity")
    axes[0].set_title("Short waves of atoms\nneed K of either sign", fontsize=9)
    cut_family(axes[1], fitted)
    axes[1].set_title("An edge removes bonds;\nnegative ones remain", fontsize=9)
    counts = negative_as_broken({"either": fitted, "positive": positive}, 28, H)
    share = 100 * np.array(SHARES)
    axes[2].plot(share, counts["either"], "o-", color=FORCE, markersize=3.5)
    axes[2].plot(share, counts["positive"], "s-", color=NODE, markersize=3.5)
    axes[2].text(20, 80, "K of\neither sign", color=FORCE, ha="right", va="center")
    axes[2].text(39, 5, "K = 1/r > 0", color=NODE, ha="right")
    axes[2].set(xlabel="bonds broken [%]", ylabel="unstable directions")
    axes[2].set_title("Then the body becomes\nunstable", fontsize=9)
    for ax in (axes[0], axes[2]):
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
    plt.close(figure)


def softest(model: wp.Model, k: np.ndarray) -> np.ndarray:
    """Smallest eigenvalue of the symbol over that of the 5-point Laplacian [TPa], at k h."""
    D = model.stencil(H).symbol(k)
    laplacian = 4 / H**2 * (np.sin(k / 2) ** 2).sum(axis=1)
    return np.asarray(np.linalg.eigvalsh(D)[:, 0] / laplacian)


def waves_proven(data: wp.Dataset, path: Path) -> None:
    """The softest wave along a path through the zone, fitted with conditions and without."""
    horizon, degree = 4.5 * H, 15
    train = data["train"]
    loose = without_conditions(train, horizon, degree)
    law = wp.LPS(horizon, wp.Bernstein(degree), Optimum(moduli=None))
    kept = wp.fit(train, law).material
    corners = np.pi * np.array([[0.02, 0.02], [1.0, 0.0], [1.0, 1.0], [0.02, 0.02]])
    corners[0, 1] = 0.0
    steps = np.linspace(0, 1, 120)[:, None]
    k = np.concatenate([(1 - steps) * a + steps * b for a, b in pairwise(corners)])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(k, axis=0), axis=1))])
    figure, ax = plt.subplots(figsize=(7.2, 2.9))
    figure.subplots_adjust(0.09, 0.16, 0.935, 0.89)
    ax.axhspan(-9, 0, color=FORCE, alpha=0.12, linewidth=0)
    ax.axhline(0, color="0.4", linewidth=0.8)
    low = high = 0.0
    for model, colour in ((kept, NODE), (loose, FORCE)):
        stiffness = softest(model, k)
        ax.plot(way, stiffness, color=colour)
        low, high = min(low, stiffness.min()), max(high, stiffness.max())
    ax.text(way[250], 0.6 * high, "with conditions", color=NODE)
    ax.text(way[272], 0.8 * low, "without conditions", color=FORCE)
    ax.text(0.05, 0.6 * low, "unstable", color=FORCE, weight="bold")
    ticks = way[[0, 119, 239, 359]]
    edge, corner = "edge of the zone\n(10 Å, along an axis)", "corner\n(7 Å, diagonal)"
    names = ("long waves", edge, corner, "long waves")
    ax.set_xticks(ticks, names)
    ax.set(ylabel="smallest stiffness [TPa]", xlim=(0, way[-1]), ylim=(1.15 * low, 1.15 * high))
    ax.set_title("Conditions keep every wave stable", fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
    plt.close(figure)


NAMED = {
    "transferred, h = 10, δ = 25, LU": ("transferred to nodes 10 Å apart", (2, 6)),
    "FEM Q1, h = 5, true constants": ("finite elements", (-2, 7)),
    "crystal model, 20 bonds, h = 5": ("crystal model", (-8, -13)),
    "LPS, h = 5, δ = 20, LU": ("LPS", (-3, 7)),
    "third order on a crystal model, 28 bonds, h = 5": ("third order on a crystal", (7, 3)),
    "local third order, FEM Q1, h = 5": ("local third order", (7, 2)),
    "prediction at 1 %": ("prediction at 1 %", (-94, -4)),
    "neural operator, δ = 20": ("neural operator", (-74, -3)),
}
"""Rows of the table of speeds that are drawn: their names, and where these stand [points]."""


def fronts(path: Path) -> None:
    """Error of disks against time, set-up and one load, by the table that the library keeps."""
    table = json.loads((Path(__file__).parent / "speed_accuracy.json").read_text("utf-8"))
    rows = [row for row in table["rows"] if row["label"] in NAMED]
    where = {
        row["label"]: (1e3 * (row["disks_setup"] + row["disks_solve"]), 100 * row["disks_error"])
        for row in rows
    }
    (atoms,) = (row for row in table["rows"] if row["kind"] == "atoms")
    exact = 1e3 * (atoms["disks_setup"] + atoms["disks_solve"])
    best: list[tuple[float, float]] = []
    for at in sorted(where.values()):
        if not best or at[1] < best[-1][1]:
            best.append(at)
    figure, ax = plt.subplots(figsize=(7.2, 3.4))
    figure.subplots_adjust(0.085, 0.145, 0.985, 0.9)
    ax.step(*np.transpose([*best, (exact, best[-1][1])]), color="0.6", linewidth=1, where="post")
    for label, at in where.items():
        name, shift = NAMED[label]
        colour = NODE if at in best else FORCE
        ax.plot(*at, "o", color=colour, markersize=5)
        ax.annotate(name, at, shift, textcoords="offset points", color=colour)
    ax.axvline(exact, color="k", linestyle="--", linewidth=1)
    ax.text(0.95 * exact, 4.2, "atoms: exact", ha="right", va="top")
    ax.set(xscale="log", yscale="log", xlim=(2.5, 3000), ylim=(0.05, 5))
    ax.set_xticks([3, 10, 30, 100, 300, 1000], ["3", "10", "30", "100", "300", "1000"])
    ax.set_yticks([0.1, 0.2, 0.5, 1, 2, 4], ["0.1", "0.2", "0.5", "1", "2", "4"])
    ax.minorticks_off()
    ax.set(xlabel="set-up and one load [ms]", ylabel="error of displacement [%]")
    ax.set_title(
        "Third order, local or not, takes the error from 1 % to a quarter or less", fontsize=9
    )
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
    plt.close(figure)


PART_NAMES = {
    "left": "left over", "waves": "waves", "data": "loads",
    "strain": "strain",
}  # fmt: skip


def error_bar(data: wp.Dataset, path: Path) -> None:
    """A held-out disk: the answer along its diameter, its likely and its true error, its parts."""
    family = wp.fit(data["train"], Family(rich_law()), validation=data["val"]).material
    disk = data["test"]
    inside, truth = disk.points.interior, disk.u[0]
    collar = np.where(inside[:, None], 0.0, truth)
    answer: Any = wp.predict(
        family, wp.Dirichlet(disk.points, disk.loads[0], collar), tolerance=None
    )
    line = np.flatnonzero(inside & (np.abs(disk.x[:, 1]) < 1e-6))
    line = line[np.argsort(disk.x[line, 0])]
    x = disk.x[line, 0]
    at = answer.of(lambda u: u[line, 0])
    true = float(np.linalg.norm((answer.u - truth)[inside]) / np.linalg.norm(truth[inside]))
    figure, axes = plt.subplots(1, 3, figsize=(7.2, 2.6), width_ratios=[1, 1.05, 0.9])
    figure.subplots_adjust(0.105, 0.185, 0.985, 0.82, wspace=0.62)
    axes[0].plot(x, at.value, color=NODE)
    axes[0].plot(x, truth[line, 0], "o", color="k", markersize=3)
    axes[0].set(xlabel="x [Å]", ylabel="displacement [Å]")
    axes[0].text(0.04, 0.96, "answer", color=NODE, va="top", transform=axes[0].transAxes)
    axes[0].text(0.04, 0.85, "atoms (dots)", va="top", transform=axes[0].transAxes)
    axes[0].set_title("The answer along\na diameter", fontsize=9)
    axes[1].fill_between(x, -1e3 * at.bar, 1e3 * at.bar, color=NODE, alpha=0.25, linewidth=0)
    axes[1].plot(x, 1e3 * (truth[line, 0] - at.value), "o", color="k", markersize=3)
    axes[1].axhline(0, color=NODE, linewidth=1)
    axes[1].set(xlabel="x [Å]", ylabel="atoms − answer [0.001 Å]")
    axes[1].set_title("The band of likely error\ncontains the true error", fontsize=9)
    names = [name for name in PART_NAMES if answer.parts[name] > 1e-5]
    sizes = [100 * answer.parts[name] for name in names] + [100 * answer.error]
    rows = np.arange(len(sizes))[::-1]
    axes[2].barh(rows, sizes, color=["#8fb0d0"] * len(names) + [NODE], height=0.6)
    axes[2].axvline(100 * true, color="k", linewidth=1.2, linestyle="--")
    axes[2].text(100 * true + 0.01, len(sizes) - 0.75, "true error", va="center")
    axes[2].set_yticks(rows, [PART_NAMES[name] for name in names] + ["together"])
    axes[2].set(xlabel="error [%]", ylim=(-0.5, len(sizes) - 0.4))
    axes[2].set_title("Where the likely\nerror comes from", fontsize=9)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
    plt.close(figure)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS / "pictures", help="folder to write to")
    parser.add_argument("--data", type=Path, help="graphene's data set; default: the main job's")
    given = parser.parse_args(argv)
    out = given.out
    out.mkdir(parents=True, exist_ok=True)
    data = wp.load(given.data or (DATA if DATA.exists() else make_data(-1, SMOOTHING_RADIUS)))
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        matplotlib.rc("font", size=9)
        matplotlib.rc("figure", dpi=200)
        from_atoms_to_answer(out / "atoms_to_answer.png")
        interior_collar_horizon(out / "collar.png")
        which_model(out / "which_model.png")
        fronts(out / "front.png")
        sign_and_its_price(data, out / "sign.png")
        waves_proven(data, out / "proof.png")
        error_bar(data, out / "error_bar.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
