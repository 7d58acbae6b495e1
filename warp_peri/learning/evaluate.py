"""Errors of a model on data: equation residual and displacement (theory.md, 30–31)."""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.models.nonlinear import NonlinearModel
from warp_peri.operator.nonlinear import NonlinearOperator
from warp_peri.points.samples import Samples
from warp_peri.statics.nonlinear import NonlinearRecord, solve_nonlinear
from warp_peri.statics.solve import solve
from warp_peri.transfer.nonlinear import nonlinear_for
from warp_peri.transfer.operator import LPSOperator
from warp_peri.transfer.points import model_for


def residual_errors(
    model: Model | NonlinearModel, points: Samples, *, allow_uncertified: bool = False
) -> np.ndarray:
    """‖L u − b‖₂ and ‖b‖₂ of each sample on the interior [TPa/Å], shape [2, S]."""
    operator: LPSOperator | NonlinearOperator
    if isinstance(model, NonlinearModel):
        operator = NonlinearOperator(model, points, allow_uncertified=allow_uncertified)
    else:
        operator = LPSOperator(model, points, allow_uncertified=allow_uncertified)
    b = points.loads[:, points.interior]
    return np.array([_norms(operator(points.u) - b), _norms(b)])


def evaluate(
    model: Model | NonlinearModel,
    points: Samples,
    *,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> dict[str, Any]:
    """Errors on every sample of a set and their means.

    Args:
        model: linear or nonlinear, certified on some lattice; on others it is transferred, which
            is said once.
        points: samples with displacement and load.
        transfer: False refuses lattices that the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.

    Returns:
        E_res = mean ‖L u − b‖₂/‖b‖₂, E_u = mean ‖u_solved − u‖₂/‖u‖₂ on interior nodes, u solved
        with b on the interior and u given on the collar; E_res_rms and E_u_rms, their
        root-mean-square variants; E_res_abs = mean ‖L u − b‖₂ [TPa/Å]; the lists of
        per-sample values E_res_samples, E_res_abs_samples, E_u_samples; and of a transferred model
        transferred_from, the spacing [Å] of the lattice that it comes from. For a nonlinear model
        also linear_solves and largest_gradient, the most linear solves that a sample took and its
        largest |H|, and unique, whether all answers are proven to be the only ones.

    Raises InputError for a set without samples, with a sample that has no load or displacement on
    its interior, or that the model cannot be used on.
    """
    if len(points) == 0:
        raise InputError("the set has no samples to evaluate")
    if isinstance(model, Model) and not allow_uncertified:
        model = model_for(model, points, transfer=transfer)
    elif isinstance(model, NonlinearModel):
        asked = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        model = nonlinear_for(model, points, **asked)
    residual, load = residual_errors(model, points, allow_uncertified=allow_uncertified)
    fields = (points.loads, points.u)
    records: list[NonlinearRecord] = []
    if isinstance(model, NonlinearModel):
        options: dict[str, Any] = {"allow_uncertified": allow_uncertified, "records": records}
        solved = solve_nonlinear(model, points, *fields, **options)
    else:
        solved = solve(model, points, *fields, allow_uncertified=allow_uncertified)
    size = _norms(points.u[:, points.interior])
    for name, norm in (("b", load), ("u", size)):
        if not (norm > 0).all():
            raise InputError(f"{name}: sample {int(np.argmin(norm))} is zero on the interior")
    relative = residual / load
    displacement = _norms((solved - points.u)[:, points.interior]) / size
    table: dict[str, Any] = {"E_res": relative.mean(), "E_res_abs": residual.mean()}
    table |= {"E_u": displacement.mean(), "E_res_rms": np.sqrt((relative**2).mean())}
    table |= {"E_u_rms": np.sqrt((displacement**2).mean())}
    table = {key: float(value) for key, value in table.items()}
    for key, values in (("E_res", relative), ("E_res_abs", residual), ("E_u", displacement)):
        table[f"{key}_samples"] = values.tolist()
    linear = model.linear if isinstance(model, NonlinearModel) else model
    if linear.transferred_from is not None:
        table["transferred_from"] = linear.transferred_from
    if records:
        table["linear_solves"] = max(record.solves for record in records)
        table["largest_gradient"] = max(record.largest_gradient for record in records)
        table["unique"] = all(record.unique for record in records)
    return table


def _norms(fields: np.ndarray) -> np.ndarray:
    norms: np.ndarray = np.linalg.norm(fields.reshape(len(fields), -1), axis=1)
    return norms
