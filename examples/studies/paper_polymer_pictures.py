"""Figures of the page on polymer flow by Gaussian processes: see paper_polymer_gp.py."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from examples.figures import panels, save_figure

COUNTS = (1000, 10_000, 100_000)
"""Dumbbells of an ensemble, as printed."""
HEIGHTS = (0.1, 0.25, 0.5)
"""Where forces are shown."""
LAWS = ("printed recipe", "kinematics known")
"""Of shear alone."""
RECIPES = (
    "printed pairing",
    "kinematics known",
    "exact rates, printed form",
    "exact rates, kinematics known",
)
"""Of the law of seven inputs."""


def draw_law(path: Path, law: Mapping[str, Any]) -> None:
    """Figure 4."""
    figure, axes = panels(10.5, 3.4, count=3, sharey=True)
    exact = np.array(law["exact"])
    size = np.sqrt(np.mean(exact**2))
    drawn = axes[0].contourf(law["K"], law["s"], exact / 1e3, levels=21, cmap="RdBu_r")
    figure.colorbar(drawn, ax=axes[0], label="ds_xy/dt / 1000")
    axes[0].set(title="exact", ylabel="s_xy / n k T")
    levels = np.linspace(-5, 5, 21)
    for ax, name in zip(axes[1:], LAWS):
        off = 100 * (np.array(law[name]["rate"]) - exact) / size
        drawn = ax.contourf(law["K"], law["s"], off, levels=levels, cmap="PuOr", extend="both")
        X = np.array(law[name]["X"])
        ax.plot(X[:, 1], X[:, 0], "k.", markersize=2)
        ax.set(title=name, ylim=axes[0].get_ylim())
    figure.colorbar(drawn, ax=axes[1:], label="error [% of the rms rate]")
    for ax in axes:
        ax.set(xlabel="shear rate × relaxation time")
    save_figure(figure, path)


def draw_plates(path: Path, plates: Mapping[tuple[Any, ...], Mapping[str, Any]]) -> None:
    """Figure 5."""
    figure, axes = panels(10, 6, count=2, rows=2)
    for column, De in enumerate(sorted({De for De, *_ in plates})):
        above, below = axes[:, column]
        run = plates[De, LAWS[1], 10_000]
        coupled = plates[De, "coupled", 10_000]
        for i in range(5):
            above.plot(coupled["t"], np.array(coupled["stress"])[:, i], "C7", linewidth=0.8)
            above.plot(run["t"], np.array(run["stress"])[:, i], "C1")
            above.plot(run["t"], np.array(run["exact"])[:, i], "k:", linewidth=1)
        above.set(title=f"De = {De:g}", xlabel="t / t0", ylabel="σ_xy at five heights")
        for color, n in enumerate(COUNTS):
            for name, style in zip((*LAWS, "coupled"), ("--", "-", ":")):
                run = plates[De, name, n]
                error = np.median(run["error"], axis=0)
                below.semilogy(run["t"][1:], error[1:], f"C{color}{style}", label=f"{name}, {n}")
        below.set(xlabel="t / t0", ylabel="largest error of u / U")
        above.plot([], [], "C7", label="coupled, 10⁴ dumbbells")
        above.plot([], [], "C1", label="learned, kinematics known")
        above.plot([], [], "k:", label="exact law")
    above.legend(frameon=False, fontsize=8)
    lines = below.get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", frameon=False, fontsize=8, ncols=3)
    save_figure(figure, path)


def draw_training(path: Path, fits: Mapping[int, Mapping[str, Any]]) -> None:
    """Figures 6 and 9."""
    figure, (left, middle, right) = panels(10.5, 4.4, count=3)
    for color, (n, fit) in enumerate(fits.items()):
        truth, rate = np.array(fit["truth"]), np.array(fit["printed pairing"]["rate"])
        for ax, place in ((left, 0), (middle, 1)):
            ax.plot(
                truth[:, place], rate[:, place], f"C{color}x", markersize=3, label=f"{n} points"
            )
        for name, style in zip(RECIPES, ("--", "-", "-.", ":")):
            if fit[name]["error"] is not None:  # else the flow ran away
                right.semilogy(
                    fit["t"], fit[name]["error"], f"C{color}{style}", label=f"{n}, {name}"
                )
    for ax, name in ((left, "xx"), (middle, "xy")):
        ax.axline((0, 0), slope=1, color="k", linewidth=0.8)
        ax.set(xlabel=f"exact ds_{name}/dt", ylabel=f"learned ds_{name}/dt, printed pairing")
    left.legend(frameon=False, fontsize=8)
    right.set(xlabel="t / t0", ylabel="largest error of u / U")
    lines = right.get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", frameon=False, fontsize=8, ncols=3)
    save_figure(figure, path)


def draw_channel(path: Path, channels: Mapping[float, Mapping[str, Any]]) -> None:
    """Figure 7."""
    figure, ax = panels(8, 3.8)
    for color, (De, found) in enumerate(channels.items()):
        ax.plot(found["t"], found["centre"]["law"], f"C{color}", label=f"De = {De:g}, exact law")
        open_marks = {"markersize": 4, "fillstyle": "none", "label": "learned"}
        ax.plot(found["t"], found["centre"]["learned"], f"C{color}o", **open_marks)
    ax.plot(found["t"], found["newton"], "k--", label="Newtonian")
    ax.set(xlabel="t / t0", ylabel="u / U in the middle")
    ax.legend(frameon=False, fontsize=8, ncols=2)
    save_figure(figure, path)


def draw_forces(path: Path, costs: Mapping[str, Mapping[str, Any]]) -> None:
    """Figure 8."""
    figure, axes = panels(10.5, 3.4, count=3, sharey=True)
    learned = "learned, exact rates", "learned, 100000 dumbbells"
    shown = ("exact law", *learned, "coupled, 100000 dumbbells")
    for i, (ax, height) in enumerate(zip(axes, HEIGHTS)):
        for name, style in zip(shown, ("k-", "C0--", "C1:", "C2-.")):
            ax.plot(costs[name]["t"], np.array(costs[name]["force"])[:, i], style, label=name)
        ax.set(title=f"y = {height:g}", xlabel="t / t0")
    figure.axes[0].set_ylabel("∂σ_xy/∂y")
    figure.axes[0].legend(frameon=False, fontsize=7)
    save_figure(figure, path)


def draw_costs(path: Path, costs: Mapping[str, Mapping[str, Any]]) -> None:
    """Error against the time of a whole run."""
    figure, ax = panels(7, 3.6)
    for color, (name, run) in enumerate(costs.items()):
        if run["error"] > 0:
            ax.loglog(run["seconds"], run["error"], f"C{color}o", label=name)
            if run["learned"]:
                ax.plot(
                    run["seconds"] + run["learned"], run["error"], f"C{color}o", fillstyle="none"
                )
    ax.axvline(costs["exact law"]["seconds"], color="k", linestyle=":", label="exact law")
    ax.set(xlabel="processor seconds of a run (open: with learning)", ylabel="error of v [%]")
    ax.legend(frameon=False, fontsize=8)
    save_figure(figure, path)
