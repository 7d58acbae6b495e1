"""A nonlinear model on lattices of other spacings: its linear part transferred, proven anew."""

from __future__ import annotations

import dataclasses

import numpy as np

from warp_peri.models.lps import Model
from warp_peri.models.nonlinear import NonlinearModel
from warp_peri.models.smoothing import fitted_weights
from warp_peri.models.uniqueness import Uniqueness, uniqueness
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import PointsLike
from warp_peri.transfer.lattice import home_of
from warp_peri.transfer.points import model_for

TAIL = 1.2
"""Beyond the zone at home the gradient falls off to nothing at so many times its half width."""
WAVES, DIRECTIONS = 200, 19
"""Wave numbers and directions that the response of the gradient at home is read at."""

_known: dict[tuple[object, ...], Uniqueness] = {}


def nonlinear_for(
    model: NonlinearModel,
    points: PointsLike,
    *,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> NonlinearModel:
    """The model for the spacing of the points and the horizon that their collar carries.

    t3, tq2, q3 and the smoothing belong to the material and go along; the weights of Ψ follow the
    lattice, those of the energy form by (N21) on finer ones, and on any other one once they have;
    the proven strain is that of the model there.

    Args:
        model: certified on some lattice.
        points: a lattice.
        transfer: False refuses other spacings.
        allow_uncertified: the linear part's own numbers, with a warning.

    Raises InputError as model_for does.
    """
    options = {"transfer": transfer, "allow_uncertified": allow_uncertified}
    linear = model_for(model.linear, points, **options)
    if linear is model.linear:
        return model
    spacing = linear.nominal_spacing(points.spacing)
    home = home_of(model.linear, spacing).spacing
    gradient = None
    if model.smoothing is None and (spacing < home or model.gradient is not None):
        gradient = _gradient(model, home, linear, spacing)  # else no wave is shorter than at home
    transferred = dataclasses.replace(model, linear=linear, proven={}, gradient=gradient)
    smoothing = None if model.smoothing is None else dataclasses.astuple(model.smoothing)
    key = (linear.content()["sha256"], *model.numbers.tolist(), smoothing, gradient, spacing)
    if key not in _known:
        _known[key] = uniqueness(transferred, spacing=spacing)
    return dataclasses.replace(transferred, proven={f"{spacing:g}": _known[key].figures()})


def _gradient(
    model: NonlinearModel, home: float, there: Model, spacing: float
) -> tuple[float, ...]:
    """Weights that give waves on a finer lattice the gradient they have at home (N21).

    The dilatation's own would not do: of short waves, which the transfer does not look at, they may
    take many times the gradient, and little would be proven.
    """
    classes = bond_classes(home, model.horizon)
    p, _ = model.weights(classes)
    edge = np.pi / home
    size = edge * (np.arange(WAVES) + 1) / WAVES
    angle = np.linspace(0, np.pi / 4, DIRECTIONS)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    phase = np.einsum("n,da,ba->ndb", size, along, classes.xi, optimize=True)
    longitudinal = 2 * np.einsum(
        "ndb,b,da,ba->nd", np.sin(phase), p[classes.bond_class], along, classes.xi, optimize=True
    )
    factor = (longitudinal / size[:, None]).mean(axis=1)
    known, response = np.append(size, TAIL * edge), np.append(factor, 0.0)
    classes = bond_classes(spacing, there.horizon)
    weights = fitted_weights(classes, lambda k: np.interp(k, known, response), np.pi / spacing)
    return tuple(weights.tolist())
