"""Figures: panels, curves of a table's rows over one axis, files, and the main of an example."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tools.options import Options
from warp_peri.files.atomic import whole_file

matplotlib.use("Agg")


def panels(*size: float, count: int = 1, rows: int = 1, **how: Any) -> tuple[Figure, Any]:
    """A figure of this size, 6.4 × 4.2 by default, and its axes, one or several in rows."""
    width, height = size or (6.4, 4.2)
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, count, **how)


def headline(figure: Figure, message: str) -> None:
    """The message of a figure above all its panels, in lines that are not wider than they are."""
    figure.suptitle(fill(message, round(11 * figure.get_figwidth())))


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

    Rows are multiplied by `scale`; names stand at the lines, or in a legend with the options
    `legend`; `labels` are options of the axes.
    """
    for number, (name, row) in enumerate(rows.items()):
        style = styles[number % len(styles)] if styles else "-"
        getattr(ax, kind)(x, scale * np.asarray(row, float), style, label=name)
    ax.set(**labels)
    if legend is None:
        name_lines(ax)
    else:
        ax.legend(**{"frameon": False} | legend)


def ticks(ax: Axes, at: Any, labels: Any = None) -> None:
    """These ticks along x, and no others."""
    ax.set_xticks(at, labels or [f"{x:g}" for x in at])
    ax.minorticks_off()


def note(ax: Axes, text: str, at: Any, shift: Any = (4, 4), color: str = "0.4", **how: Any) -> None:
    """A word beside a place, so many points away."""
    ax.annotate(text, at, shift, textcoords="offset points", size=9, color=color, **how)


def name_lines(ax: Axes, size: float = 9) -> None:
    """Write the label of each line at its rightmost point in sight, apart from one another.

    Lines whose label begins with an underscore have no name.
    """
    ax.autoscale_view()
    to_axes, height = ax.transData - ax.transAxes, ax.get_window_extent().height
    gap = 1.3 * size * ax.figure.dpi / 72 / height  # of lines of text, in axes
    ends = []
    for line in ax.get_lines():
        at = to_axes.transform(np.column_stack(line.get_data()).astype(float))
        at = at[np.isfinite(at).all(axis=1) & (np.abs(at - 0.5) < 0.5 + 1e-6).all(axis=1)]
        if len(at) and not str(line.get_label()).startswith("_"):
            x, y = at[np.argmax(at[:, 0])]
            inside = min(max(y, gap / 2), 1 - gap / 2)
            ends.append([inside, 1.0 if x > 0.8 else x, line])  # no name lies across the frame
    ends.sort(key=lambda end: end[0])
    for _ in range(100):
        for lower, upper in pairwise(ends):
            short = max(0.0, gap - (upper[0] - lower[0])) / 2
            lower[0], upper[0] = lower[0] - short, upper[0] + short
    for y, x, line in ends:
        ax.annotate(
            line.get_label(), (x, y), (7, 0), "axes fraction", "offset points", va="center",
            color=line.get_color(), size=size, annotation_clip=False,
        )  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """Curves by name over x, with a title and labels of both axes."""

    title: str
    x: Any
    xlabel: str
    ylabel: str
    curves: Mapping[str, Any]


def draw_panels(drawn: Sequence[Panel], path: Path) -> None:
    """Numbered panels in three columns at the width of a page, the first curves red, then blue."""
    rows = -(-len(drawn) // 3)
    with matplotlib.rc_context({"font.size": 7.5}):
        figure, axes = panels(7.2, 1.9 * rows, count=3, rows=rows, squeeze=False)
        for number, (ax, one) in enumerate(zip(axes.flat, drawn), 1):
            labels = {"xlabel": one.xlabel, "ylabel": one.ylabel, "legend": {"fontsize": 7}}
            curves(ax, "plot", one.x, one.curves, "C3.-", "C0.-", **labels)
            for axis, values in ("x", [*one.x]), ("y", [*one.curves.values()]):
                if np.min(values) > 0 and np.max(values) > 50 * np.min(values):
                    ax.set(**{f"{axis}scale": "log"})
            ax.set_title(f"{number} {one.title}", fontsize=8, loc="left", weight="bold")
        save_figure(figure, path, dpi=105)


def field(ax: Axes, x: Any, values: Any, unit: str = "", most: Any = None, **how: Any) -> None:
    """A field over its nodes [N, 2] without gaps, with a colour bar; `most`: least and most."""
    least, largest = most or (np.min(values), np.max(values))
    first, second = np.asarray(x).T
    levels: Any = np.linspace(least, largest, 25)
    drawn: Any = ax.tricontourf(first, second, values, levels=levels, **how)
    ax.figure.colorbar(drawn, ax=ax, label=unit).locator = MaxNLocator(6)
    ax.set_aspect("equal")


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
