"""Errors of a hyperelastic solid on samples: of the equation, and of the solved displacement."""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_peri.points.samples import Samples, seen_of
from warp_peri.points.unit_names import check_same
from warp_peri.tissue.equilibrium import StaticProblem
from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import HyperelasticSolid
from warp_peri.tissue.stretch_range import warn_beyond


def hyperelastic_errors(
    solid: HyperelasticSolid,
    samples: Samples,
    *,
    truth: np.ndarray | None = None,
    solve: bool = True,
    thickness: np.ndarray | None = None,
    operator: HyperelasticOperator | None = None,
) -> dict[str, Any]:
    """Relative ℓ2 errors on the interior, (30) and (31), as means over samples and one by one.

    Args:
        solid: a material, of the same spacing or another.
        samples: with loads or, for E_u alone, without.
        truth: displacement that the solved one is held against, shape [S, N, 2]; that of the
            samples where none is given. Displacement on the collar is read from the samples.
        solve: whether E_u is asked for.
        thickness: of every node of the samples, shape [N]; an even sheet where none is given.
        operator: of the solid's dictionary on these samples, where there is one already.

    Returns:
        E_res where there are loads; E_u over the samples that were solved, not_solved, their
        number, and left_branch, the number of those that (Equilibrium.followed) another branch may
        hold; residuals and displacements with the errors of every sample, NaN where not solved.

    Raises InputError for samples in other units than the solid.

    Warns of fields, solved where that is asked for, that are stretched beyond the data that the
    solid was learned from.
    """
    check_same(solid.units, samples.points.units)
    op = operator or HyperelasticOperator(solid.dictionary, samples, thickness=thickness)
    inner, errors_of, fields = op.interior, {}, samples.u
    if samples.b is not None:
        left = op.force(samples.u, solid.coefficients) - samples.b[:, inner]
        residuals = _size(np.asarray(left)) / _size(samples.b[:, inner])
        errors_of = {"E_res": float(residuals.mean()), "residuals": residuals}
    if solve:
        truth = samples.u if truth is None else truth
        seen = seen_of(samples)[:, inner, None]
        problem, errors, left_branch = StaticProblem(op), np.full(len(samples), np.nan), 0
        fields = np.zeros_like(samples.u)
        for n in range(len(samples)):
            b = None if samples.b is None else samples.b[n]
            solved = problem.find(solid.coefficients, b, samples.u[n])
            if solved is not None:
                fields[n] = solved.u
                gap, size = (f[inner] * seen[n] for f in (solved.u - truth[n], truth[n]))
                errors[n] = np.linalg.norm(gap) / np.linalg.norm(size)
                left_branch += not solved.followed
        missing = int(np.isnan(errors).sum())
        mean = float(np.nanmean(errors)) if missing < len(errors) else float("nan")
        errors_of |= {
            "E_u": mean,
            "not_solved": missing,
            "left_branch": left_branch,
            "displacements": errors,
        }
    warn_beyond(solid, op, fields)
    return errors_of


def _size(field: np.ndarray) -> np.ndarray:
    sizes: np.ndarray = np.linalg.norm(field.reshape(len(field), -1), axis=1)
    return sizes
