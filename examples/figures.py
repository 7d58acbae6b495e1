"""Figures: panels, curves of a table's rows over one axis, files, and the main of an example."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tools.options import Options
from warp_peri.files.atomic import whole_file

matplotlib.use("Agg")

ABOVE = {"ncols": 2, "loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
"""A legend above the axes."""


def panels(*size: float, count: int = 1, rows: int = 1, **how: Any) -> tuple[Figure, Any]:
    """A figure of this size, 6.4 × 4.2 by default, and its axes, one or several in rows."""
    width, height = size or (6.4, 4.2)
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, count, **how)


def outer(grid: Any, xlabel: str, ylabel: str) -> None:
    """Label a grid of axes at its left and lower rim, where no colour bar is in the way."""
    for ax in grid[:, 0]:
        ax.set_ylabel(ylabel)
    for ax in grid[-1]:
        ax.set_xlabel(xlabel)


def curves(
    ax: Axes,
    kind: str,
    x: Any,
    rows: Mapping[Any, Any],
    *styles: str,
    scale: Any = 1.0,
    legend: Any = None,
    **labels: Any,
) -> None:
    """Draw rows by name over x with a method of the axes, such as "loglog", in turns of styles.

    Rows are multiplied by `scale`; `legend` has more options of it, `labels` those of the axes.
    """
    for number, (name, row) in enumerate(rows.items()):
        style = styles[number % len(styles)] if styles else "-"
        getattr(ax, kind)(x, scale * np.asarray(row, float), style, label=name)
    ax.legend(**{"frameon": False} | (legend or {}))
    ax.set(**labels)


def save_figure(
    figure: Figure, path: Path, dpi: float = 150, bbox_inches: str | None = "tight"
) -> None:
    """Write a figure whole or not at all, and close it."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=dpi, bbox_inches=bbox_inches)
    plt.close(figure)


def shown(
    doc: str | None,
    name: str,
    study: Callable[..., tuple[Any, Figure]],
    args: Any,
    **options: tuple[Any, str],
) -> int:
    """What a small example does: ask for options, print numbers, and draw; 0 at its end.

    Args:
        doc: of the module, as help.
        name: of the folder in runs/ and of the figure there.
        study: of the options in order; its numbers and its figure.
        args: of the command.
        options: by name what is taken by default, and the help.
    """
    asked = Options(doc, name, json=True)
    for option, (default, words) in options.items():
        asked.add(f"--{option}", type=type(default), default=default, help=words)
    given = vars(asked.parse_args(args))
    numbers, figure = study(*map(given.get, options))
    print(json.dumps(numbers, indent=None if given["json"] else 1))
    save_figure(figure, given["out"] / f"{name}.png")
    return 0
