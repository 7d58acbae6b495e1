"""The chart and the table of speed_accuracy.py."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from examples.figures import panels, save_figure
from examples.prose import table

Row = dict[str, Any]
PANELS: dict[str, tuple[str, Callable[[Row], float | None]]] = {
    "held-out disks: one solve": ("disks", lambda row: row["disks_solve"]),
    "disks: set-up and one load": ("disks", lambda row: row["disks_setup"] + row["disks_solve"]),
    "disks: set-up and a hundred loads": ("disks", lambda row: row.get("hundred")),
    "held-out short waves: one solve": ("waves", lambda row: row["waves_solve"]),
}
"""Title: which errors, and which seconds."""


def front(rows: list[Row], name: str, seconds: Callable[[Row], float | None]) -> list[Row]:
    """Rows that no other beats in both error and time, fastest first."""
    best, unbeaten = np.inf, []
    timed = [(seconds(row), row[f"{name}_error"], n) for n, row in enumerate(rows)]
    for _, error, n in sorted(one for one in timed if one[0] is not None):
        # The same model by another solver is no better.
        if error < best * (1 - 1e-3):
            best = error
            unbeaten.append(rows[n])
    return unbeaten


def short(label: str) -> str:
    """A label without what most rows share."""
    return label.removesuffix(", LU").replace(", h = 5", "")


def chart(rows: list[Row], file: Path) -> None:
    """Error against time, for one load and for a hundred, the Pareto fronts drawn and labelled."""
    figure, axes = panels(8, 12, count=2, rows=2)
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    floor = min(row["disks_error"] for row in rows if row["disks_error"] > 0) / 4
    for ax, (title, (name, seconds)) in zip(axes.flat, PANELS.items()):
        for number, kind in enumerate(kinds):
            some = [row for row in rows if row["kind"] == kind and seconds(row) is not None]
            y = [100 * max(row[f"{name}_error"], floor) for row in some]
            x = [1e3 * float(seconds(row) or 0) for row in some]
            color = plt.get_cmap("tab20")(number % 20)
            ax.loglog(x, y, "oPXsDv^*<>dph8"[number % 14], color=color, label=kind, ms=7)
        best = front(rows, name, seconds)
        x = [1e3 * float(seconds(row) or 0) for row in best]
        y = [100 * max(row[f"{name}_error"], floor) for row in best]
        ax.step(x, y, "k--", lw=0.8, where="post")
        for n, (a, b) in enumerate(zip(x, y), start=1):
            ax.annotate(str(n), (a, b), (-4, -14), textcoords="offset points", size=9)
        names = [f"{n}  {short(row['label'])}" for n, row in enumerate(best, start=1)]
        ax.text(0.02, 0.02, "\n".join(names), transform=ax.transAxes, size=8)
        ax.set(xlabel="milliseconds", title=title)
        ax.margins(0.1, 0.05)
        ax.set_ylim(bottom=100 * floor / 40)
    for ax in axes[:, 0]:
        ax.set_ylabel("displacement error [%]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8)
    save_figure(figure, file, dpi=88, bbox_inches=None)


BESIDE = {
    "neural operator": (-140, -4), "crystal model": (-40, 26), "dressed elements": (-40, 12),
    "LPS with two influence functions": (8, 1), "LPS": (8, -3),
    "LPS from two designed loads": (-6, -24),
}  # fmt: skip
"""Where names stand beside their point that would cover others [points]."""


def training_chart(rows: list[Row], file: Path) -> None:
    """Error on the disks against what a law cost: seconds of atoms, and of its fit."""
    atoms = next(row for row in rows if row["kind"] == "atoms")
    figure, ax = panels(9, 5.5)
    some = [row for row in rows if row.get("fit_seconds", 0) > 0]
    some = [
        row
        for row in some
        if row["kind"] not in ("predict", "λ, μ, α only") or "at 1 %" in row["label"]
    ]
    best: dict[str, Row] = {}
    for row in sorted(some, key=lambda row: row["disks_error"]):
        best.setdefault(row["label"].split(", ")[0], row)
    for name, row in best.items():
        both = 2 if row["kind"] == "designed" else 1  # each both ways
        loads = atoms["waves_setup"] + both * row["loads"] * atoms["waves_solve"]
        where = (loads + row["fit_seconds"], 100 * row["disks_error"])
        text, shift = f"{name} ({row['loads']} loads)", BESIDE.get(name, (6, -4))
        ax.loglog(*where, "o", color="C0")
        ax.annotate(text, where, shift, textcoords="offset points", size=9)
    ax.set(xlabel="seconds of atoms and fit", ylabel="error of displacement on disks [%]")
    save_figure(figure, file, dpi=110, bbox_inches=None)


def error_chart(rows: list[Row], file: Path, error: str) -> None:
    """Error [%] against seconds of rows with label, kind, seconds and error; 0 is drawn below."""
    figure, ax = panels(8.5, 4)
    floor = min(row["error"] for row in rows if row["error"] > 0) / 3
    for kind, mark in zip(dict.fromkeys(row["kind"] for row in rows), "osD^vP*X"):
        some = [(n, row) for n, row in enumerate(rows, start=1) if row["kind"] == kind]
        where = np.array([[r["seconds"], 100 * max(r["error"], floor)] for _, r in some])
        names = "\n".join(f"{n}  {r['label']}{'' if r['error'] else ' (0 %)'}" for n, r in some)
        ax.loglog(*where.T, mark, ms=8, label=names)
        for (n, _), at in zip(some, where):
            ax.annotate(str(n), at, (6, 4), textcoords="offset points", size=9)
    ax.set(xlabel="seconds in all", ylabel=error)
    ax.grid(alpha=0.3)
    ax.margins(0.1)
    figure.legend(loc="outside right center", fontsize=8)
    save_figure(figure, file, dpi=110, bbox_inches=None)


NAMES = ("disks", "smooth", "waves")
WAYS = ("LPS", "LPS with two influence functions", "transferred from δ = 25",
        "transferred from two influence functions")  # fmt: skip
"""Of coming to a model on nodes 5 Å apart."""


def equal_cost(rows: list[dict[str, Any]]) -> str:
    """Errors of models with the same bonds: fitted to data, or to a model that is richer."""
    some = {
        (row["kind"], row["horizon"]): row
        for row in rows
        if row["spacing"] == 5 and row["method"] == "lu"
    }

    def cell(way: str, horizon: float) -> str:
        return ", ".join(f"{100 * some[way, horizon][f'{name}_error']:.2f}" for name in NAMES)

    lines = ([f"δ = {d:g} Å", *(cell(way, d) for way in WAYS)] for d in (12.5, 15.0, 20.0))
    return table(["5 Å: disks, smooth, short waves %", *WAYS], lines)


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table and what it says."""
    head = "model", "disks %", "at 10 % strain", "smooth %", "short waves %"
    cells = []
    for row in rows:
        strained = row.get("strained", [[0, None]])[-1][1]
        numbers = [row["disks_error"], strained, row.get("smooth_error"), row["waves_error"]]
        numbers = [None if n is None else 100 * n for n in numbers]
        numbers += [1e3 * row["disks_setup"], 1e3 * row["disks_solve"]]
        numbers += [row.get("hundred"), row.get("fit_seconds")]
        cells.append([row["label"], *("" if n is None else f"{n:.3g}" for n in numbers)])
    lines = [table([*head, "set-up ms", "solve ms", "hundred s", "fit s"], cells)]
    by = {(row["kind"], row["spacing"], row["horizon"], row["method"]): row for row in rows}
    learned, Q1 = by["LPS", 5.0, 20.0, "lu"], by["FEM Q1", 5.0, 0.0, "Q1"]
    ratios = [Q1[f"{name}_error"] / learned[f"{name}_error"] for name in ("disks", "waves")]
    cells = [["error of Q1 over that of δ = 20 Å", *(f"{ratio:.2f}" for ratio in ratios)]]
    lines += ["", equal_cost(rows), ""]
    lines.append(table(["on the same nodes, h = 5 Å", "disks", "short waves"], cells))
    for title, (name, seconds) in PANELS.items():
        best = ", ".join(row["label"] for row in front(rows, name, seconds))
        lines += ["", f"Pareto front, {title}, fastest first: {best}."]
    return "\n".join(lines) + "\n"
