"""Figures of a model and its fit, each drawn on the Axes it is given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter, MaxNLocator

from warp_peri.fitting.result import Stage
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import symbols
from warp_peri.points.families import bond_classes


def influence_function(model: LPSMaterial, *, spacing: float, ax: Axes) -> Axes:
    """Plot K(r), scaled to unit weighted volume, and its values at a lattice's bond lengths.

    Args:
        model: the model.
        spacing: of the lattice [length].
        ax: where to draw.
    """
    classes = bond_classes(spacing, model.horizon, dimension=model.dimension)
    r = np.linspace(0.5 * spacing, model.horizon, 1000)
    volume = classes.count @ (model.influence(classes.r) * classes.weight * classes.r**2)
    values = model.influence(classes.r) / volume
    ax.axhline(0, color="0.7", linewidth=0.8)
    ax.plot(r, model.influence(r) / volume, color="C0", linewidth=1, alpha=0.6, label="K(r)")
    unit = symbols(model.units)[0]
    label = f"at the bonds of the {spacing:g} {unit} lattice"
    ax.plot(classes.r, values, "o", color="C0", label=label)
    room = 1.5 * np.abs(values).max()
    ax.set(xlim=(0, 1.03 * model.horizon), ylim=(-room, room))
    ax.set(xlabel=f"bond length r [{unit}]", ylabel=f"K / m  [{unit}⁻{'⁴⁵'[model.dimension - 2]}]")
    ax.legend(frameon=False)
    return ax


def loss_by_stage(history: Sequence[Stage], *, ax: Axes) -> Axes:
    """Plot √loss (a relative residual, in stage 4 of displacement) over the steps of each stage.

    Args:
        history: stages of a fit.
        ax: where to draw.
    """
    begin = 0
    for number, stage in enumerate(history):
        residual = 100 * np.sqrt(stage.loss)
        steps = begin + np.arange(1, len(residual) + 1)
        name = f"{stage.name.lstrip('0123456789 ')}, {len(residual)} rounds"
        style = "-D" if len(residual) < 100 else "-"
        ax.plot(steps, residual, style, color=f"C{number}", label=name, markersize=5)
        begin = int(steps[-1])
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))  # "4", not a power of ten
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="rounds of the fit", ylabel="relative misfit of the training set [%]")
    ax.legend(frameon=False)
    return ax
