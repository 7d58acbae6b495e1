"""`solve --body`: a mesh, what holds and pulls it, to displacement and stress."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

import warp_peri
from warp_peri.cli.settings_file import keep
from warp_peri.errors import InputError
from warp_peri.files.atomic import locked
from warp_peri.statics.solution import Coupling
from warp_peri.storage import load

OF_DATA: dict[str, Any] = {"method": "auto", "axis": None, "set": "test", "transfer": True}
OF_BODY: dict[str, Any] = {"hold": [], "pull": [], "spacing": None, "overlap": None, "units": None}
"""Options of the two kinds of problem that mean nothing to the other, and their defaults."""


def run_solve_body(given: argparse.Namespace) -> dict[str, Any]:
    """A body in equilibrium: a VTU file of its mesh.

    Raises InputError for a data file beside the body, or neither, options of a data file, a
    material that bodies are not of, and another ending than .vtu.
    """
    if given.body is None or given.data is not None:
        raise InputError("data, body: expected one of DATA.h5 and --body MESH")
    refuse_options(given, OF_DATA, "loads of a data file, not of a body")
    if given.out.suffix != ".vtu":
        raise InputError(f"out: expected a .vtu file for a body, got {given.out.name}")
    material = load(given.model)
    if given.units is not None:
        material = material.in_units(tuple(given.units))
    problem = warp_peri.Body(
        load(given.body),
        _vectors("hold", given.hold),
        _vectors("pull", given.pull),
        coupling=Coupling(spacing=given.spacing, overlap=given.overlap),
    )
    asked: dict[str, Any] = {"allow_uncertified": True} if given.allow_uncertified else {}
    solution = warp_peri.solve(material, problem, **asked).details
    with locked(given.out):
        largest = warp_peri.export.write_body(given.out, solution)
        keep(given, given.out.with_suffix(".solve.toml"))
    exchange = solution.exchange
    return {
        "file": str(given.out),
        **largest,
        "units": list(material.units),
        "spacing": solution.spacing,
        "horizon": solution.model.horizon,
        "lattice_nodes": 0 if solution.points is None else int(solution.points.interior.sum()),
        "exchanges": exchange.exchanges,
        "mismatch": exchange.mismatch,
        "rim_residual": exchange.rim_residual,
        "bulk_residual": exchange.bulk_residual,
        "overlap": solution.overlap,
    }


def refuse_options(given: argparse.Namespace, of: dict[str, Any], whose: str) -> None:
    """InputError for options that are set, apart from their defaults, and would do nothing."""
    if idle := [name for name, default in of.items() if getattr(given, name) != default]:
        words = ", ".join("no-transfer" if name == "transfer" else name for name in idle)
        raise InputError(f"{words}: expected with {whose}")


def _vectors(option: str, words: Sequence[str]) -> dict[str, np.ndarray]:
    """PART=a,b or PART=a,b,c as vectors by part; "-" is no number."""
    vectors: dict[str, np.ndarray] = {}
    for word in words:
        name, _, numbers = word.rpartition("=")
        try:
            pair = [np.nan if part == "-" else float(part) for part in numbers.split(",")]
        except ValueError:
            pair = []
        if not name or len(pair) not in (2, 3):
            raise InputError(
                f"{option}: expected PART=number,number (,number in space), got {word!r}"
            )
        if name in vectors:
            raise InputError(f"{option}: expected each part once, got {name!r} twice")
        vectors[name] = np.array(pair)
    return vectors
