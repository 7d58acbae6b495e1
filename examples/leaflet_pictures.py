"""What a biomechanician reads: maps, stress–stretch curves, the fibre rose, errors by frame."""

import contextlib
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import warp_peri as wp
from warp_peri import Samples
from warp_peri.tissue import HyperelasticSolid, NoEquilibrium, PlacedSheet, rose_of


def draw(
    solid: HyperelasticSolid,
    test: Samples,
    truth: np.ndarray,
    report: dict[str, Any],
    folder: Path,
    thickness: np.ndarray | None = None,
) -> None:
    """Write the four figures, and the thickness of a sheet that is not even."""
    folder.mkdir(parents=True, exist_ok=True)
    sheet = solid.on(test, thickness=thickness)
    figures = {
        "maps": maps(sheet, test, truth),
        "curves": curves(sheet, test),
        "rose": fibre_rose(solid),
        "errors": errors_by_frame(report),
    }
    if thickness is not None:
        figures["thickness"] = thickness_map(test, thickness)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=130)
        plt.close(figure)


def maps(sheet: PlacedSheet, test: Samples, truth: np.ndarray) -> Figure:
    """Measured, predicted and difference of both components on the last held-out frame."""
    u = test.u[-1]
    with contextlib.suppress(NoEquilibrium):
        u = wp.solve(sheet, wp.Dirichlet(test, None, u)).u
    inner = test.interior
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.4), layout="constrained")
    for row, component in zip(axes, (0, 1)):
        fields = (truth[-1], u, u - truth[-1])
        for ax, field, title in zip(row, fields, ("measured", "predicted", "difference")):
            values = field[inner, component]
            drawn = ax.scatter(*test.x[inner].T, c=values, s=28, marker="s", cmap="viridis")
            figure.colorbar(drawn, ax=ax, shrink=0.8)
            ax.set(title=f"$u_{component + 1}$, {title}", aspect="equal", xlabel="x", ylabel="y")
    return figure


def thickness_map(test: Samples, thickness: np.ndarray) -> Figure:
    """Thickness over that at the centre."""
    figure, ax = plt.subplots(figsize=(4.6, 4.0), layout="constrained")
    x, y = test.x.T
    drawn = ax.scatter(x, y, c=thickness, s=22, marker="s", cmap="cividis")
    figure.colorbar(drawn, ax=ax, label="thickness / that at the centre")
    ax.set(aspect="equal", xlabel="x", ylabel="y", title="in the units of the frames")
    return figure


def curves(sheet: PlacedSheet, test: Samples) -> Figure:
    """Mean nominal stress against mean stretch by protocol; bands span the middle four fifths."""
    protocols = test.arrays.get("protocol", np.zeros(len(test), int))
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", sharey=True)
    for number in np.unique(protocols):
        points = []
        for n in np.flatnonzero(protocols == number):
            stretch = np.sqrt(1 + 2 * sheet.energies.strain(test.u[n])[test.interior, :2])
            P = sheet.stress(test.u[n])
            stress = P[:, [0, 1], [0, 1]]
            points.append(
                (stretch.mean(axis=0), stress.mean(axis=0), np.quantile(stress, (0.1, 0.9), axis=0))
            )
        for axis, ax in enumerate(axes):
            x = [1.0, *(p[0][axis] for p in points)]
            y = [0.0, *(p[1][axis] for p in points)]
            low, high = ([0.0, *(p[2][end][axis] for p in points)] for end in (0, 1))
            (line,) = ax.plot(x, y, "o-", ms=3, label=f"protocol {number}")
            ax.fill_between(x, low, high, color=line.get_color(), alpha=0.15)
    for ax, name in zip(axes, ("1", "2")):
        ax.set(xlabel=f"stretch $\\lambda_{name}$", title=f"direction {name}")
    axes[0].set_ylabel("stress / initial stiffness")
    axes[0].legend(fontsize=8)
    return figure


def fibre_rose(solid: HyperelasticSolid) -> Figure:
    """Energy of the fibres by direction at the largest stretch of the data."""
    figure, ax = plt.subplots(figsize=(4.2, 4.2), subplot_kw={"projection": "polar"})
    for angle, value in rose_of(solid).items():
        for turn in (0.0, np.pi):
            ax.bar(angle + turn, value, width=0.08, color="tab:red")
    ax.set(yticklabels=[], title="fibres")
    return figure


def errors_by_frame(report: dict[str, Any]) -> Figure:
    """Held-out errors of every frame, of the fits and their rivals."""
    figure, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    fits = {n: e["frames"] for n, e in report.items() if isinstance(e, dict) and "frames" in e}
    for name, frames in fits.items():
        ax.plot(100 * np.asarray(frames), "o-", ms=3, label=name)
    for number, (name, rival) in enumerate(report.get("rivals", {}).items()):
        errors = 100 * np.asarray(rival["frames"])
        ax.plot(errors, "x--", color=f"C{number + len(fits)}", lw=1, ms=3, label=name)
    ax.set(xlabel="held-out frame", ylabel="error of displacement [%]", yscale="log")
    ax.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    return figure
