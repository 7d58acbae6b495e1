"""What the page on the slides of Trask shows: see papers.py."""

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from examples import diffusion, pressurised_crack
from examples.figures import headline, name_lines, panels, save_figure, ticks
from examples.prose import rows_of
from examples.studies import paper_slides_incompressible as stiff
from examples.studies import paper_slides_rates as study

NEEDED: dict[str, str] = {}
TEMPLATE = Path(__file__).with_suffix(".md")
NAMES = {
    "bond": "bond-based, λ = μ",
    "state": "state-based, λ = 3μ",
    "quintic": "bond-based, degree 5 throughout",
    "cells": "bond-based, cells as weights",
}
EDGES = {"bond-based, the printed field": 1.0, "state-based, λ = −0.27μ": -0.27, "λ = 3μ": 3.0}
"""λ/μ below a free edge."""
SIDES = (8, 16, 32)
"""Nodes per unit length of diffusion and pressure."""


def parts(runs: Path, kept: Callable[..., Any], figures: Path) -> dict[str, Callable[[], str]]:
    """The parts of the page, by the names that its template gives them."""
    del runs

    def rates() -> str:
        found = kept("rates", lambda: [study.pointwise(*case) for case in study.asked()])
        draw_rates(figures / "slides_rates.png", found)
        return rows_of(map(study.rate_row, found))

    def limits(one: str) -> str:
        far, near = (
            kept("fixed_horizon", study.fixed_horizon),
            kept("fixed_ratio", study.fixed_ratio),
        )
        draw_limits(figures / "slides_limits.png", far, near)
        if one == "nonlocal":
            rows = [["degree", *(f"{degree}" for degree in far["degree"])]]
            return rows_of(rows + [errors(NAMES[name], far[name]) for name in NAMES])
        return rows_of(
            [*errors(NAMES[name], row), study.order(study.CELLS, row)] for name, row in near.items()
        )

    return {
        "functionals": lambda: rows_of(map(study.functional_row, kept("functionals", functionals))),
        "rates": rates,
        "nonlocal_limit": lambda: limits("nonlocal"),
        "local_limit": lambda: limits("local"),
        "stretches": lambda: rows_of(study.stretches()),
        "edges": lambda: rows_of(kept("edges", edges)),
        "incompressible": lambda: rows_of(
            map(stiff.incompressible_row, kept("incompressible", stiff.incompressible))
        ),
        "free_edge": lambda: rows_of(
            map(stiff.incompressible_row, kept("free_edge", stiff.free_edge))
        ),
        "inclusion": lambda: rows_of(map(stiff.inclusion_row, kept("inclusion", stiff.inclusion))),
        "diffusion": lambda: rows_of(kept("diffusion", conduction)),
        "coupled": lambda: rows_of(kept("coupled", coupling)),
        "pressure": lambda: rows_of(kept("pressure", pressure)),
        "fluxes": lambda: rows_of(kept("fluxes", fluxes)),
    }


def errors(name: str, row: Sequence[float]) -> list[str]:
    """A row of relative errors."""
    return [name, *(f"{error:.1e}" for error in row)]


def functionals() -> list[dict[str, Any]]:
    """All functionals, by dimension, derivative and degree."""
    return [
        study.functional(d, name, m) for d, name, m in product((2, 3), study.FUNCTIONALS, (2, 3, 4))
    ]


def edges() -> list[list[str]]:
    """Largest errors below a free edge, the dilatation renormalised and not, and their order."""
    rows = []
    for (name, ratio), corrected in product(EDGES.items(), (True, False)):
        if ratio == 1 and not corrected:
            continue  # no dilatation in it
        found = [study.free_edge(n, ratio, corrected=corrected) for n in study.CELLS]
        end = "" if ratio == 1 else ", renormalised" if corrected else ", not renormalised"
        rows.append([*errors(f"{name}{end}", found), study.order(study.CELLS, found)])
    return rows


def conduction() -> list[list[str]]:
    """Errors of diffusion by nodes per unit length, and their orders."""
    cases = {
        "even, lattice": lambda n: diffusion.smooth(n, 0.0),
        "even, scattered": lambda n: diffusion.smooth(n, 0.2),
        "κ jumps 1:10, in series along bonds": diffusion.jump,
        "the same, mean of the ends": lambda n: diffusion.jump(n, along=False),
    }
    rows = []
    for name, error in cases.items():
        found = [error(n) for n in SIDES]
        rows.append([*errors(name, found), study.order(SIDES, found)])
    return rows


def coupling() -> list[list[str]]:
    """Errors of displacement and potential where each drives the other."""
    found = [diffusion.coupled(n) for n in SIDES]
    return [
        [*errors(name, row), study.order(SIDES, list(row))]
        for name, row in zip(("u", "φ"), zip(*found))
    ]


def fluxes() -> list[list[str]]:
    """Errors where the flux jumps, in one material and between two, and their orders."""
    rows = []
    for name, right in (("κ the same", 1.0), ("κ jumps 1:10 there", 10.0)):
        found = [diffusion.flux_jump(n, right) for n in SIDES]
        rows.append([*errors(name, found), study.order(SIDES, found)])
    return rows


def pressure() -> list[list[str]]:
    """Opening and volume of a crack under pressure over Sneddon's."""
    rows = []
    for n in SIDES:
        found = pressurised_crack.opening(n)[0]
        rows.append([f"L/{n}", f"{found['opening']:.3f}", f"{found['volume']:.4f}"])
    return rows


def draw_rates(path: Path, rates: Sequence[Mapping[str, Any]]) -> None:
    """Errors over the horizon, degree 4."""
    figure, axes = panels(11, 3.6, count=2)
    headline(figure, "The quadrature converges at the claimed rates (in brackets)")
    for ax, d in zip(axes, (2, 3)):
        for color, found in enumerate(
            one for one in rates if one["dimension"] == d and one["degree"] == 4
        ):
            label = f"α = {found['exponent']:g}: {found['rate']:.1f} ({found['claimed']:.1f})"
            ax.loglog(study.RADII, found["errors"], "o-", color=f"C{color}", label=label)
        ax.set(xlabel="horizon δ", ylabel="error of the integral", title=f"{d} dimensions")
        name_lines(ax)
    save_figure(figure, path)


def draw_limits(path: Path, far: Mapping[str, Any], near: Mapping[str, Any]) -> None:
    """Both limits over the spacing."""
    figure, (left, right) = panels(9.5, 3.8, count=2)
    shown = (
        (left, far, study.PERIOD, study.PARTS, "at a fixed horizon, δ = 12.5 Å", " [Å]"),
        (right, near, study.LENGTH, study.CELLS, "at a fixed ratio, δ = 3h", ", side 2"),
    )
    for ax, found, length, numbers, title, unit in shown:
        h = [length / number for number in numbers]
        for color, name in enumerate(NAMES):
            if name in found:
                style = "s--" if name == "state" else "o-"
                ax.loglog(h, found[name], style, color=f"C{color}", label=NAMES[name])
        ax.set(xlabel=f"spacing h{unit}", ylabel="relative error of displacement", title=title)
        if ax is right:
            second = [near["bond"][0] * (x / h[0]) ** 2 for x in h]
            ax.loglog(h, second, "k:", linewidth=1, label="second order")
        ticks(ax, h, [f"{x:.2g}" for x in h])
    lines = [*left.get_lines(), right.get_lines()[-1]]
    figure.legend(handles=lines, loc="outside lower center", ncols=3, frameon=False)
    headline(figure, "Errors of exact weights fall, at a fixed horizon with a growing degree")
    save_figure(figure, path)
