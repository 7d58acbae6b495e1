"""Pictures of the page on Jafarzadeh et al. (2024), from this library's own data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from examples.figures import headline, name_lines, note, outer, panels, save_figure
from tools.make_hgo import NODES
from tools.make_leaflet import PROTOCOLS, SIDE, TINE, TINES_AT
from warp_peri import Samples

BINS = 60


def shown(figure: Figure, ax: Axes, x: Any, value: Any, label: str, limit: float | None) -> None:
    """Contours of a field on its nodes: with a limit around zero, else from zero on."""
    points, field = np.array(x, float), np.array(value, float)
    most = 1.001 * (limit or max(field.max(), 1e-12))
    levels = np.linspace(-most, most, 21) if limit else np.linspace(0, most, 15)
    drawn: Any = ax.tricontourf(
        points[:, 0],
        points[:, 1],
        field,
        levels=levels.tolist(),
        cmap="RdBu_r" if limit else "magma_r",
    )
    short = ScalarFormatter()
    short.set_powerlimits((-3, 4))
    bar = figure.colorbar(drawn, ax=ax, label=label, shrink=0.85, format=short)
    bar.locator = MaxNLocator(5)
    bar.update_ticks()
    ax.set_aspect("equal")
    ax.locator_params(axis="x", nbins=4)


def prediction(path: Path, field: Mapping[str, Any], length: str, load: str) -> None:
    """u₁ and b₁: truth, network, and the size of the difference."""
    figure, grid = panels(11, 6, count=3, rows=2)
    off = []
    for row, (name, unit) in zip(grid, (("u", length), ("b", load))):
        true, found = (np.array(part)[:, 0] for part in field[name])
        limit = max(np.abs(true).max(), np.abs(found).max())
        whole, wrong = np.array(field[name][0]), np.subtract(field[name][1], field[name][0])
        off.append(f"{100 * np.linalg.norm(wrong) / np.linalg.norm(whole):.2g} %")
        shown(figure, row[0], field["x"], true, f"{name}₁ [{unit}]", limit)
        shown(figure, row[1], field["x"], found, f"{name}₁ [{unit}]", limit)
        shown(figure, row[2], field["x"], np.abs(found - true), f"difference [{unit}]", None)
        for ax, title in zip(row, ("truth", "network", "difference")):
            ax.set_title(f"{title}, {name}₁")
    outer(grid, f"x₁ [{length}]", f"x₂ [{length}]")
    headline(figure, f"On an unseen disk displacement errs by {off[0]}, the load by {off[1]}")
    save_figure(figure, path)


def square(path: Path, samples: Samples, number: int) -> None:
    """Figure 6: the mesh, its held edge, and a displacement."""
    figure, (left, right) = panels(9.5, 4, count=2)
    x = samples.x
    cells = np.arange(NODES**2).reshape(NODES, NODES)
    first = np.stack([cells[:-1, :-1], cells[1:, :-1], cells[1:, 1:]], axis=-1).reshape(-1, 3)
    second = np.stack([cells[:-1, :-1], cells[1:, 1:], cells[:-1, 1:]], axis=-1).reshape(-1, 3)
    left.triplot(*x.T, np.concatenate([first, second]), color="0.7", linewidth=0.6)
    edge = np.isclose(np.abs(x - 0.5).max(axis=1), 0.5)
    left.plot(*x[edge].T, "s", color="C3", markersize=4, label="held")
    left.plot(*x[samples.interior].T, ".", color="C0", label="equations, δ = 3 spacings")
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    left.set(aspect="equal", title="Held at the edge", xlabel="x₁ [mm]", ylabel="x₂ [mm]")
    u = samples.u[number, :, 0]
    shown(figure, right, x, u, "u₁ [mm]", np.abs(u).max())
    right.set(title="and displaced by a load", xlabel="x₁ [mm]")
    save_figure(figure, path)


def gradients(path: Path, sizes: np.ndarray) -> None:
    """Figure 7: how many nodes have which |∇u|."""
    figure, ax = panels(6, 3.6)
    ax.hist(sizes, bins=BINS, weights=np.full(len(sizes), 100 / len(sizes)), color="C0")
    ax.set(xlabel="size of the displacement gradient", ylabel="nodes [%]", yscale="log")
    ax.set_title(f"Strains are large: above {np.median(sizes):.2g} at half of the nodes")
    save_figure(figure, path)


def mirror(path: Path, wide: Samples) -> None:
    """Figure 8: a sample continued by the mirror rule."""
    figure, ax = panels(5.4, 4.4)
    u = wide.u[0, :, 0]
    shown(figure, ax, wide.x, u, "u₁ [mm]", np.abs(u).max())
    ax.plot([0, 1, 1, 0, 0], [0, 0, 1, 1, 0], color="k", linewidth=1.2)
    ax.set(xlabel="x₁ [mm]", ylabel="x₂ [mm]", title="Mirrored beyond the line, data go on")
    save_figure(figure, path)


def loads(path: Path, sets: Mapping[str, Samples]) -> None:
    """Figure 9: load and displacement of a training and a validation sample."""
    figure, grid = panels(13, 5.6, count=4, rows=2)
    titles = {"train": "training", "val": "validation"}
    for row, (name, samples) in zip(grid, sets.items()):
        parts = [(f"b{'₁₂'[n]} [MPa/mm]", samples.loads[0, :, n]) for n in (0, 1)]
        parts += [(f"u{'₁₂'[n]} [mm]", samples.u[0, :, n]) for n in (0, 1)]
        for ax, (label, field) in zip(row, parts):
            shown(figure, ax, samples.x, field, label, np.abs(field).max())
            ax.set_title(f"{titles[name]}, {label[:2]}")
    outer(grid, "x₁ [mm]", "x₂ [mm]")
    headline(figure, "Loads at random in training and in validation, and what they displace")
    save_figure(figure, path)


def omega(ax: Axes, material: Any) -> Any:
    """ω over the bond, divided by its largest value, whose sign means nothing."""
    line = np.linspace(-1, 1, 161) * material.horizon
    grid = np.stack(np.meshgrid(line, line, indexing="xy"), axis=-1).reshape(-1, 2)
    with torch.no_grad():
        value = material.double().omega(torch.as_tensor(grid)).numpy()
    value[np.linalg.norm(grid, axis=1) > material.horizon] = np.nan
    value = value.reshape(161, 161) / value[np.nanargmax(np.abs(value))]
    drawn = ax.imshow(value, origin="lower", extent=(-1, 1, -1, 1), cmap="RdBu_r", vmin=-1, vmax=1)
    ax.set_xlabel("ξ₁/δ")
    return drawn


def influence(path: Path, material: Any) -> None:
    """Figures 5 and 13, right: ω as an image."""
    figure, ax = panels(4.6, 3.8)
    drawn = omega(ax, material)
    figure.colorbar(drawn, ax=ax, shrink=0.85, label="ω over its largest value")
    does = "changes" if drawn.get_array().min() < 0 else "keeps"
    ax.set(ylabel="ξ₂/δ", title=f"The influence function {does} sign")
    save_figure(figure, path)


def roses(path: Path, laws: Mapping[int, Any], roses: Mapping[int, Mapping[str, float]]) -> None:
    """Figure 11, right: ω at each horizon, and under it the dictionary's energy by direction."""
    figure, shown = Figure(figsize=(12, 7), layout="constrained"), []
    for column, (reach, material) in enumerate(laws.items(), 1):
        ax = figure.add_subplot(2, len(laws), column)
        drawn = omega(ax, material)
        shown.append(ax)
        ax.set_title(f"network, δ = {reach} spacings")
        ax = figure.add_subplot(2, len(laws), len(laws) + column, projection="polar")
        angles = np.array([float(angle) for angle in roses[reach]])
        energy = np.array(list(roses[reach].values()))
        for turn in (0.0, np.pi):
            for sign, colour in ((1, "C3"), (-1, "C0")):
                kept = sign * energy > 0
                ax.bar(angles[kept] + turn, sign * energy[kept], width=0.15, color=colour)
        ax.set_yticklabels([])
        ax.set_title(f"dictionary, δ = {reach} spacings")
    shown[0].set_ylabel("ξ₂/δ")
    headline(
        figure, "At every horizon the dictionary finds the fibres; the network differs each time"
    )
    figure.colorbar(drawn, ax=shown, shrink=0.85, label="ω over its largest value")
    save_figure(figure, path, dpi=100)


def leaflet(path: Path, sets: Mapping[str, Samples]) -> None:
    """Figure 12: the sheet and its tines, a stretched frame, the protocols."""
    figure, (sheet, stretched, ratios) = panels(12, 3.8, count=3)
    samples = sets["train"]
    half = SIDE / 2
    sheet.plot(half * np.array([-1, 1, 1, -1, -1]), half * np.array([-1, -1, 1, 1, -1]), color="k")
    along = np.linspace(-0.5, 0.5, 5)
    for sign in (-1, 1):
        place = np.stack([np.full(5, sign * TINES_AT), along])
        for tines, pull in ((place, (sign, 0)), (place[::-1], (0, sign))):
            sheet.plot(*tines, "o", color="C3", markersize=100 * TINE)
            sheet.quiver(*tines, *np.outer(pull, np.ones(5)), color="C3", scale=6, width=0.008)
    sheet.plot(*samples.x.T, ".", color="0.7", markersize=1.5)
    sheet.plot(*samples.x[samples.interior].T, ".", color="C0", markersize=3)
    sheet.set(title="Tines that pull (red), nodes seen\n(grey), equations (blue)")
    most = int(np.argmax(np.abs(samples.u).max(axis=(1, 2))))
    y = samples.x + samples.u[most]
    stretched.plot(*samples.x.T, ".", color="0.8", markersize=1.5)
    stretched.plot(*y.T, ".", color="C0", markersize=2)
    stretched.set(title="Its nodes unloaded (grey)\nand pulled most")
    for ax in (sheet, stretched):
        ax.set(xlabel=f"x₁ (side of the sheet: {SIDE})", ylabel="x₂", aspect="equal")
        ax.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
    for number, (a, b) in enumerate(PROTOCOLS, 1):
        ratios.plot([0, a], [0, b], color="0.8", linewidth=0.8)
        note(ratios, f"{number}", (a, b))
        ratios.plot(a, b, "o", color="C0")
    ratios.set(aspect="equal", xlim=(0, 1.15), ylim=(0, 1.15), title="Seven protocols of pulling")
    ratios.set(xlabel="pull along x₁ over the largest", ylabel="pull along x₂ over the largest")
    headline(figure, "A square of leaflet is pulled by its tines in seven proportions")
    save_figure(figure, path)


def frames(path: Path, errors: Mapping[str, Sequence[float]], samples: Samples) -> None:
    """Figure 14: the error of every held-out frame, in the order of the protocols."""
    figure, ax = panels(9.5, 4.2)
    order = np.lexsort((samples.arrays["level"], samples.arrays["protocol"]))
    protocols = samples.arrays["protocol"][order]
    for name, values in errors.items():
        known = [np.nan if value is None else 100 * value for value in np.array(values)[order]]
        ax.plot(known, "o-", markersize=4, linewidth=1, label=name)
    for place in np.flatnonzero(np.diff(protocols)):
        ax.axvline(place + 0.5, color="0.85", linewidth=0.8)
    ax.set(xlabel="held-out frame, protocols one after the other", yscale="log")
    ax.set_ylabel("error of displacement [%]")
    mean = {name: np.nanmean(np.array(values, float)) for name, values in errors.items()}
    ax.set_title(f"Least error on unseen frames: {min(mean, key=mean.__getitem__)}")
    ax.set_xticks(range(0, len(order), 2))
    name_lines(ax)
    save_figure(figure, path)
