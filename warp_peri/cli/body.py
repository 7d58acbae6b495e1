"""`solve --body`: a mesh, what holds and pulls it, to displacement and stress."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from warp_peri.cli.settings_file import keep
from warp_peri.errors import InputError
from warp_peri.files.atomic import locked
from warp_peri.storage import load


def run_solve_body(given: argparse.Namespace) -> dict[str, Any]:
    """A body in equilibrium: a VTU file of its mesh.

    Raises InputError for a data file beside the body, or neither, and another ending than .vtu.
    """
    from warp_peri.export import write_body
    from warp_peri.statics.body import Coupling, solve_body

    if given.body is None or given.data is not None:
        raise InputError("data, body: expected one of DATA.h5 and --body MESH")
    if given.out.suffix != ".vtu":
        raise InputError(f"out: expected a .vtu file for a body, got {given.out.name}")
    solution = solve_body(
        load(given.model),
        load(given.body),
        displacement=_vectors("hold", given.hold),
        traction=_vectors("pull", given.pull),
        coupling=Coupling(spacing=given.spacing, overlap=given.overlap),
        allow_uncertified=given.allow_uncertified,
    )
    with locked(given.out):
        largest = write_body(given.out, solution)
        keep(given, given.out.with_suffix(".solve.toml"))
    exchange = solution.exchange
    return {
        "file": str(given.out),
        **largest,
        "spacing": solution.spacing,
        "horizon": solution.model.horizon,
        "lattice_nodes": 0 if solution.points is None else int(solution.points.interior.sum()),
        "exchanges": exchange.exchanges,
        "mismatch": exchange.mismatch,
        "rim_residual": exchange.rim_residual,
        "bulk_residual": exchange.bulk_residual,
        "overlap": solution.overlap,
    }


def _vectors(option: str, words: Sequence[str]) -> dict[str, np.ndarray]:
    """PART=a,b or PART=a,b,c as vectors by part; "-" is no number."""
    vectors = {}
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
        vectors[name] = np.array(pair)
    return vectors
