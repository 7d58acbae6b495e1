"""Two drawings that explain: from atoms to an answer; interior, collar and horizon.

Both are sketches, but the disk of the first is computed: docs/disk.png, by `make graphene`.
"""

import argparse
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle

DOCS = Path(__file__).resolve().parent.parent.parent / "docs"
ATOM, NODE, FORCE, GOOD = "0.55", "#1f4e79", "#b5382a", "#2e7d32"
DISK = (slice(108, 391), slice(492, 777))
"""Rows and columns of the model's displacement in docs/disk.png."""
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


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS / "pictures", help="folder to write to")
    out = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context():
        matplotlib.rc("font", size=9)
        matplotlib.rc("figure", dpi=200)
        from_atoms_to_answer(out / "atoms_to_answer.png")
        interior_collar_horizon(out / "collar.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
