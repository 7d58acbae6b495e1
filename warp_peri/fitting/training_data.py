"""Training sets made ready: which they are, and what each sample counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_peri.errors import InputError
from warp_peri.fitting.rows import load_sizes
from warp_peri.points.dataset import Dataset
from warp_peri.points.points import Samples
from warp_peri.points.unit_names import check_units


def listed(
    samples: Samples | Dataset | Sequence[Samples] | None,
    name: str = "samples",
    *,
    space: bool = False,
) -> list[Samples]:
    """One set, several or none as a list; of a data set the one called train, or the only one.

    Sets in space are for those who ask for them.

    Raises InputError, which begins with the name, for anything else.
    """
    if samples is None:
        return []
    if isinstance(samples, Dataset):
        samples = samples.obvious("train")
    sets = [samples] if isinstance(samples, Samples) else samples
    if not isinstance(sets, Sequence) or not all(isinstance(each, Samples) for each in sets):
        raise InputError(
            f"{name}: expected Samples (nodes with u and b), or a list of them, got "
            f"{type(samples).__name__}"
        )
    if not space and any(each.points.dimension != 2 for each in sets):
        raise InputError(f"{name}: expected a sheet; in space LPS and Crystal are learned")
    return list(sets)


def sample_weights(sets: Sequence[Samples], *, normalise: bool) -> list[np.ndarray]:
    """Weight of each sample's ‖L u − b‖² in the loss, one array of shape [S] a set.

    The loss is Σ f² ‖L u − b‖² / Σ f² ‖b‖² over the samples of all sets, f = 1, or 1/‖b‖ with
    `normalise`. Raises InputError for a set without samples or loads, or a sample without load
    that is to be normalised.
    """
    if not sets:
        raise InputError("points: expected at least one training set, got none")
    named = {" and ".join(check_units(points.points.units)) for points in sets}
    if len(named) > 1:
        raise InputError(f"units: expected the same for all sets, got {', '.join(sorted(named))}")
    factors, total = [], 0.0
    for points in sets:
        if len(points) == 0:
            raise InputError("the training set has no samples")
        load = load_sizes(points)
        if not load.any():
            raise InputError("the training set has no loads on its interior")
        if normalise and not load.all():
            raise InputError(f"sample {int(np.argmin(load))} has no load and cannot be normalised")
        factors.append(1 / load if normalise else np.ones(len(points)))
        total += float(((factors[-1] * load) ** 2).sum())
    return [factor**2 / total for factor in factors]


def check_noise(noise: Samples, points: Samples) -> None:
    """Raise InputError when noise does not belong to a training set."""
    if len(noise) == 0:
        raise InputError("noise: expected at least one field, got none")
    mine, its = points.points, noise.points
    if its.units != mine.units:
        raise InputError(
            f"units: expected the same for all sets, got {its.units} of noise and {mine.units}"
        )
    near = its.x.shape == mine.x.shape and np.allclose(its.x, mine.x, 0, 1e-6 * mine.spacing)
    if not (near and np.array_equal(its.interior, mine.interior)):
        raise InputError(
            f"noise: expected the {len(mine.x)} nodes of the training set, got {len(its.x)} others"
        )
