"""Figures of the page on polymer flow by Gaussian processes: see paper_polymer_gp.py."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examples.figures import headline, name_lines, note, panels, save_figure, ticks

COUNTS = (1000, 10_000, 100_000)
"""Dumbbells of an ensemble, as printed."""
TRAINING = (1000, 3000, 6000)
"""Training points in the channel, as printed."""
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
    printed, known = (np.median(law[name]["errors"][0]) for name in LAWS)
    headline(figure, f"Near its data (dots), known kinematics err {printed / known:.0f} times less")
    save_figure(figure, path)


def draw_stress(path: Path, plates: Mapping[tuple[Any, ...], Mapping[str, Any]]) -> None:
    """Figure 5, above: stress over time."""
    figure, axes = panels(10, 3.2, count=2)
    for ax, De in zip(axes, sorted({De for De, *_ in plates})):
        for label, name, key, style in (
            ("coupled, 10⁴ dumbbells", "coupled", "stress", "C7"),
            ("learned, kinematics known", LAWS[1], "stress", "C1"),
            ("exact model", LAWS[1], "exact", "k:"),
        ):
            one = plates[De, name, 10_000]
            drawn = ax.plot(one["t"], np.array(one[key]), style, linewidth=1)
            drawn[0].set_label(label)
        ax.set(title=f"Deborah number {De:g}", xlabel="time t / t₀")
        ax.set_ylabel("shear stress at five heights")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    headline(figure, "The learned fluid's stress follows the exact model at every height")
    save_figure(figure, path)


def draw_plates(path: Path, rows: Mapping[str, Mapping[str, Sequence[Sequence[float]]]]) -> None:
    """Figure 5, below: median, least and largest error of u / U for each number of dumbbells."""
    figure, axes = panels(9.5, 4.2, count=2, sharey=True)
    for ax, (De, fluids) in zip(axes, rows.items()):
        for color, (name, errors) in enumerate(fluids.items()):
            median, least, most = 100 * np.array([(e[0], min(e), max(e)) for e in errors]).T
            spread = [median - least, most - median]
            label = "dumbbells in every cell" if name == "coupled" else name
            ax.plot(COUNTS, median, "o-", color=f"C{color}", label=label)
            ax.errorbar(COUNTS, median, spread, ecolor=f"C{color}", capsize=3, fmt="none")
        ax.set(title=f"Deborah number {De}", xlabel="dumbbells in an ensemble")
        ax.set(xscale="log", yscale="log", xlim=(700, 4e6))
        ticks(ax, COUNTS, ["10³", "10⁴", "10⁵"])
        name_lines(ax)
    axes[0].set_ylabel("largest error of the velocity [% of the wall's]")
    figure.suptitle("With the kinematics known, a learned fluid errs least")
    save_figure(figure, path)


def draw_rates(path: Path, fits: Mapping[int, Mapping[str, Any]]) -> None:
    """Figure 6: learned against exact rates, by the printed pairing."""
    figure, axes = panels(8, 4, count=2)
    for color, (n, fit) in enumerate(fits.items()):
        truth, rate = np.array(fit["truth"]), np.array(fit[RECIPES[0]]["rate"])
        for place, ax in enumerate(axes):
            ax.plot(truth[:, place], rate[:, place], f"C{color}x", ms=3, label=f"{n} points")
    for ax, name in zip(axes, ("xx", "xy")):
        ax.axline((0, 0), slope=1, color="k", linewidth=0.8)
        ax.set(xlabel=f"exact rate of s_{name}", ylabel=f"learned rate of s_{name}")
    axes[0].legend(frameon=False, fontsize=9)
    headline(figure, "Rates learned by the printed pairing err by most of their size")
    save_figure(figure, path)


def draw_training(path: Path, rows: Mapping[str, Mapping[int, float]]) -> None:
    """Figure 9: largest error of u / U for each number of training points, where a run ended."""
    figure, ax = panels(7.5, 4.2)
    for color, (name, errors) in enumerate(rows.items()):
        ax.plot([*errors], 100 * np.array([*errors.values()]), f"C{color}o-", label=name)
    ax.set(xscale="log", yscale="log", xlim=(800, 30_000), xlabel="training points")
    ticks(ax, TRAINING)
    ax.set_ylabel("largest error of the velocity [% of the mean]")
    ax.set_title("Only with the kinematics known is the error below 3 %")
    name_lines(ax)
    lost = [name for name, errors in rows.items() if TRAINING[0] not in errors]
    if lost:
        away = "\n".join([f"with {TRAINING[0]} points run away:", *lost])
        ax.annotate(away, (0.03, 0.96), xycoords="axes fraction", va="top", color="0.4")
    save_figure(figure, path)


def draw_channel(path: Path, channels: Mapping[float, Mapping[str, Any]]) -> None:
    """Figure 7."""
    figure, ax = panels(8, 3.8)
    for color, (De, found) in enumerate(channels.items()):
        ax.plot(found["t"], found["centre"]["law"], f"C{color}", label=f"De = {De:g}, exact")
        ax.plot(found["t"], found["centre"]["learned"], f"C{color}o", ms=4, fillstyle="none")
    ax.plot(found["t"], found["newton"], "k--", label="Newtonian")
    ax.set(xlabel="time t / t₀ (circles: learned)", ylabel="velocity in the middle u / U")
    name_lines(ax)
    ax.set_title("The learned fluid follows the exact model at each Deborah number")
    save_figure(figure, path)


def draw_forces(path: Path, costs: Mapping[str, Mapping[str, Any]]) -> None:
    """Figure 8."""
    figure, axes = panels(10.5, 3.4, count=3, sharey=True)
    learned = "learned, exact rates", "learned, 100000 dumbbells"
    shown = ("exact law", *learned, "coupled, 100000 dumbbells")
    for i, (ax, height) in enumerate(zip(axes, HEIGHTS)):
        for name, style in zip(shown, ("k-", "C0--", "C1:", "C2-.")):
            ax.plot(costs[name]["t"], np.array(costs[name]["force"])[:, i], style)
            ax.lines[-1].set_label(name.replace("law", "model"))
        ax.set(title=f"height {height:g} of the channel", xlabel="time t / t₀")
    figure.axes[0].set_ylabel("force along the channel")
    figure.axes[0].legend(frameon=False, fontsize=9)
    headline(figure, "Exact, learned and coupled fluids push alike")
    save_figure(figure, path)


def draw_costs(path: Path, costs: Mapping[str, Mapping[str, Any]]) -> None:
    """Error against the time of a whole run."""
    figure, ax = panels(8.5, 3.6)
    for name, run in costs.items():
        if run["error"] > 0:
            learned, at = run["learned"], (run["seconds"], run["error"])
            ax.loglog(*at, "C0o" if learned else "C1o")
            note(ax, name, at, (0, 7), "C0" if learned else "C1")
            if learned:
                ax.plot([at[0], at[0] + learned], [at[1]] * 2, "C0:o", fillstyle="none")
    exact = costs["exact law"]["seconds"]
    ax.axvline(exact, color="k", linestyle=":")
    ax.margins(y=0.15)
    ax.set(xlim=(exact / 8, 2e4 * exact), ylabel="error of velocity [%]")
    note(ax, "exact model", (exact, run["error"]), (-5, -20), "k", ha="right")
    ax.set_xlabel("processor seconds of a run (open: with learning)")
    headline(figure, "A model from 10⁵ dumbbells runs in a second, as many coupled in minutes")
    save_figure(figure, path)
