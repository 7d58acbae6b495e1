"""The chart and the table of speed_accuracy.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from warp_peri.files.atomic import whole_file


def front(rows: list[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Rows that no other beats in both error and solve time, fastest first."""
    best, unbeaten = np.inf, []
    for row in sorted(rows, key=lambda row: (row[f"{name}_solve"], row[f"{name}_error"])):
        # The same model by another solver is no better.
        if row[f"{name}_error"] < best * (1 - 1e-3):
            best = row[f"{name}_error"]
            unbeaten.append(row)
    return unbeaten


def chart(rows: list[dict[str, Any]], file: Path) -> None:
    """Error against the time of a solve, the Pareto front drawn and labelled."""
    figure, axes = plt.subplots(2, 1, figsize=(8, 11), layout="constrained")
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    for ax, name, title in zip(
        axes, ("disks", "waves"), ("held-out disks", "held-out short waves, periodic sheet")
    ):
        floor = min(row[f"{name}_error"] for row in rows if row[f"{name}_error"] > 0) / 3
        for kind, marker in zip(kinds, "oPXsDv^*<>"):
            some = [row for row in rows if row["kind"] == kind]
            y = [100 * max(row[f"{name}_error"], floor) for row in some]
            ax.loglog([1e3 * row[f"{name}_solve"] for row in some], y, marker, label=kind)
        best = front(rows, name)
        x = [1e3 * row[f"{name}_solve"] for row in best]
        y = [100 * max(row[f"{name}_error"], floor) for row in best]
        ax.step(x, y, "k--", lw=0.8, where="post", label="Pareto front")
        for n, (a, b) in enumerate(zip(x, y), start=1):
            ax.annotate(str(n), (a, b), (-4, -14), textcoords="offset points", size=10)
        names = [f"{n}  {row['label']}" for n, row in enumerate(best, start=1)]
        ax.text(0.02, 0.02, "\n".join(names), transform=ax.transAxes, size=9.5)
        ax.set(xlabel="time of one solve [ms]", ylabel="displacement error [%]", title=title)
        ax.margins(0.1, 0.4)
    axes[0].legend(fontsize=9, loc="upper right")
    figure.suptitle("Atoms have error 0 and stand on the floor of the chart", fontsize=10)
    with whole_file(file) as path:
        figure.savefig(path, dpi=100, format="png")
    plt.close(figure)


NAMES = ("disks", "smooth", "waves")
WAYS = ("learned", "two functions", "from δ = 25", "from two functions")
"""Of coming to a model on nodes 5 Å apart."""


def equal_cost(rows: list[dict[str, Any]]) -> list[str]:
    """Errors of models with the same bonds: fitted to data, or to a model that is richer."""
    lines = [
        "| 5 Å: disks, smooth, short waves % | " + " | ".join(WAYS) + " |",
        "|---" * (len(WAYS) + 1) + "|",
    ]
    some = {
        (row["kind"], row["horizon"]): row
        for row in rows
        if row["spacing"] == 5 and row["method"] == "lu"
    }
    for horizon in (12.5, 15.0, 20.0):
        cells = [
            ", ".join(f"{100 * some[way, horizon][f'{name}_error']:.2f}" for name in NAMES)
            for way in WAYS
        ]
        lines.append(f"| δ = {horizon:g} Å | " + " | ".join(cells) + " |")
    return lines


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table and what it says."""
    lines = [
        "| model | disks % | smooth % | short waves % | set-up ms (disk) | solve ms (disk) |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        numbers = [100 * row[f"{name}_error"] for name in NAMES]
        numbers += [1e3 * row["disks_setup"], 1e3 * row["disks_solve"]]
        lines.append(f"| {row['label']} | " + " | ".join(f"{n:.3g}" for n in numbers) + " |")
    lines += ["", *equal_cost(rows)]
    by = {(row["kind"], row["spacing"], row["horizon"], row["method"]): row for row in rows}
    learned, Q1 = by["learned", 5.0, 20.0, "lu"], by["FEM Q1", 5.0, 0.0, "Q1"]
    lines += ["", "| on the same nodes, h = 5 Å | disks | short waves |", "|---|---|---|"]
    ratios = [Q1[f"{name}_error"] / learned[f"{name}_error"] for name in ("disks", "waves")]
    lines.append(f"| error of Q1 over that of δ = 20 Å | {ratios[0]:.2f} | {ratios[1]:.2f} |")
    for name, said in (("disks", "disks"), ("waves", "short waves")):
        best = ", ".join(row["label"] for row in front(rows, name))
        lines += ["", f"Pareto front, {said}, fastest first: {best}."]
    return "\n".join(lines) + "\n"
