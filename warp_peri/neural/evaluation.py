"""How far a neural operator is from samples: E_res of forces, E_u of solved displacements."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.neural.equilibrium import NeuralEquilibrium
from warp_peri.neural.frames import affine
from warp_peri.neural.material import NeuralOperator
from warp_peri.points.samples import Samples

TOLERANCE = {torch.float64: 1e-8, torch.float32: 1e-5}
"""Of the solves that an error is told of, by precision."""


def evaluate(
    material: NeuralOperator,
    samples: Samples,
    *,
    solve: bool = True,
    most: int | None = None,
    tolerance: float | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Errors on one set, means over samples and by sample ("samples"), relative ℓ2 norms.

    E_res_abs is ‖force − b‖ [stress/length], E_u the error of the displacement that is solved for
    from zero or, without loads, from the affine motion of the collar, "converged" the share of the
    samples whose equilibrium was found; an E_u is told of all, found or not. A sample without a
    load has no E_res, and nodes that are all interior, as of a periodic sheet, have no E_u. With
    `most`, only the first so many samples are solved.
    """
    placed = material.on(samples.points)
    inside = samples.interior
    loads = np.zeros_like(samples.u) if samples.b is None else samples.loads
    search = NeuralEquilibrium(placed) if solve and not inside.all() else None
    enough = TOLERANCE[placed.dtype] if tolerance is None else tolerance
    rows: dict[str, list[float]] = {"E_res": [], "E_res_abs": [], "E_u": [], "converged": []}
    pairs = tqdm(list(zip(samples.u, loads)), disable=not progress, leave=False)
    for number, (u, b) in enumerate(pairs):
        with torch.no_grad():
            miss = float(np.linalg.norm(placed(u) - b[inside]))
        size = float(np.linalg.norm(b[inside]))
        rows["E_res_abs"].append(miss)
        rows["E_res"].append(miss / size if size else np.nan)
        if search is not None and (most is None or number < most):
            if samples.b is None:
                found = search.solve(b, affine(samples, u), tolerance=enough)
            else:
                found = search.from_rest(b, u, tolerance=enough)
            gap = np.linalg.norm((found.u - u)[inside])
            rows["E_u"].append(float(gap / np.linalg.norm(u[inside])))
            rows["converged"].append(float(found.converged))
    kept = {key: values for key, values in rows.items() if values and np.isfinite(values).all()}
    if not kept:
        raise InputError("samples: expected at least one")
    return {key: float(np.mean(values)) for key, values in kept.items()} | {"samples": kept}
