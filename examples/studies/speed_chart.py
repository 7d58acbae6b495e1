"""The chart and the table of speed_accuracy.py."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from examples.figures import note, panels, save_figure
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


ROOM, WIDE = 1.2, 0.4
"""For names left of a front, over the width of the points: in a small chart, and in a wide one."""
APART = 1.35
"""Errors of names on a front differ by this factor, so that they can be read."""


def draw_front(
    ax: Any, some: list[tuple[float, float, str]], exact: dict[str, float], *, every: bool = False
) -> None:
    """Time, error [%] and name of each: the front with names, the others grey.

    `exact`: times of what has no error, by name, drawn as vertical lines; `every`: name all.
    """
    best: list[tuple[float, float, str]] = []
    for at in sorted(some):
        if not best or at[1] < best[-1][1] * (1 - 1e-3):
            best.append(at)
    ax.loglog([x for x, *_ in some], [y for _, y, _ in some], "o", color="0.8", ms=4)
    x, y, _ = zip(*best)
    ax.step([*x, *exact.values()], [*y, *[y[-1]] * len(exact)], color="C0", lw=0.8, where="post")
    ax.plot(x, y, "o", color="C0", ms=5)
    above, beside = np.inf, np.inf
    for here in best:
        if every or here[1] < above / APART:
            low = 16 if here[1] * APART > beside else 4  # below the name of the one before
            above, beside = here[1], here[1]
            note(ax, here[2], here[:2], (-5, -low), "C0", ha="right", va="top")
    for name, seconds in exact.items():
        ax.axvline(seconds, color="0.3", ls="--", lw=0.8)
        top = {"xycoords": ax.get_xaxis_transform(), "ha": "right", "va": "top"}
        ax.annotate(f"{name}: exact ", (seconds, 0.98), size=8, **top)
    low, high = ax.get_xlim()
    ax.set_xlim(low / (high / low) ** (WIDE if every else ROOM), high)
    ax.set_ylim(bottom=min(y) / 2)


def chart(rows: list[Row], file: Path) -> None:
    """Error against time, for one load and for a hundred, the Pareto fronts drawn and labelled."""
    figure, axes = panels(8, 13, count=1, rows=4)
    for ax, (title, (name, seconds)) in zip(axes.flat, PANELS.items()):
        timed = [(1e3 * s, row) for row in rows if (s := seconds(row)) is not None]
        exact = {row["kind"]: x for x, row in timed if row["kind"] == "atoms"}
        found = [
            (x, 100 * row[f"{name}_error"], short(row["label"]).split(", δ")[0])
            for x, row in timed
            if row["kind"] != "atoms"
        ]
        draw_front(ax, found, exact)
        ax.set(xlabel="time [ms] (h and δ in Å)", title=title)
    for ax in axes.flat:
        ax.set_ylabel("error of displacement [%]")
    figure.suptitle("Third order is the most accurate on disks, prediction on short waves")
    save_figure(figure, file, dpi=88, bbox_inches=None)


BESIDE = {
    "neural operator": (-140, -4), "crystal model": (-40, 26),
    "LPS": (8, -3), "third order on a crystal model": (6, 10),
    "LPS from two designed loads": (-6, -24),
}  # fmt: skip
"""Where names stand beside their point that would cover others [points]."""


def training_chart(rows: list[Row], file: Path) -> None:
    """Error on the disks against what a law cost: seconds of atoms, and of its fit."""
    atoms = next(row for row in rows if row["kind"] == "atoms")
    figure, ax = panels(9, 5.5)
    many, best = ("predict", "λ, μ, α only"), dict[str, Row]()
    for row in sorted(rows, key=lambda row: row["disks_error"]):
        if row.get("fit_seconds", 0) > 0 and (row["kind"] not in many or "at 1 %" in row["label"]):
            best.setdefault(row["label"].split(", ")[0], row)
    for name, row in best.items():
        both = 2 if row["kind"] == "designed" else 1  # each both ways
        loads = atoms["waves_setup"] + both * row["loads"] * atoms["waves_solve"]
        where = (loads + row["fit_seconds"], 100 * row["disks_error"])
        text, shift = f"{name} ({row['loads']} loads)", BESIDE.get(name, (6, -4))
        ax.loglog(*where, "o", color="C0")
        note(ax, text, where, shift, "k")
    ax.set(xlabel="seconds of simulation and fit", ylabel="error of displacement, free disks [%]")
    ax.set_title("Third order is the most accurate for the seconds it costs to learn")
    save_figure(figure, file, dpi=110, bbox_inches=None)


def error_chart(rows: list[Row], file: Path, error: str) -> None:
    """Error [%] against seconds of rows with label, seconds and error; those without are lines."""
    figure, ax = panels(8.5, 4)
    found = [(r["seconds"], 100 * r["error"], r["label"]) for r in rows if r["error"]]
    for x, y, name in found:
        if any(x > a and y >= b for a, b, _ in found):  # those on the front get their names there
            note(ax, name, (x, y), (-5, 4), ha="right")
    exact = {row["kind"]: row["seconds"] for row in rows if not row["error"]}
    draw_front(ax, found, exact, every=True)
    _, least, best = min(found, key=lambda one: one[1])
    ax.set(xlabel="seconds in all", ylabel=error, title=f"Least error, {least:.2g} %: {best}")
    ax.set_ylim(top=1.5 * max(y for _, y, _ in found))
    save_figure(figure, file, dpi=110, bbox_inches=None)


NAMES = ("disks", "smooth", "waves")
WAYS = ("LPS", "transferred from δ = 25")
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
