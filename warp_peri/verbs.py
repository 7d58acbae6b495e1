"""The one verb that learns a material from samples."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from inspect import signature
from typing import TYPE_CHECKING, Any, overload

from warp_peri.fitting.diagnose import warn_of_kind
from warp_peri.fitting.result import Fit
from warp_peri.fitting.training_data import listed
from warp_peri.points.dataset import Dataset
from warp_peri.points.points import Samples
from warp_peri.protocols import offered, taken

if TYPE_CHECKING:
    from warp_peri.materials.crystal_fit import Crystal
    from warp_peri.materials.lps_fit import LPS
    from warp_peri.materials.third_order_fit import ThirdOrder

Sets = Samples | Dataset | Sequence[Samples]


@overload
def fit(samples: Sets, law: LPS | Crystal | ThirdOrder, **options: Any) -> Fit: ...
@overload
def fit(samples: Any, law: Any, **options: Any) -> Any: ...
def fit(samples: Any, law: Any = None, **options: Any) -> Any:
    """Learn a material model from samples.

    Args:
        samples: one set or several; of a Dataset `train`, or its only set.
        law: what may be learned, and how: LPS(horizon, …), ThirdOrder(Crystal(…)),
            hyperelastic.Hyperelastic(…).
        options: of its `learn`; all take `progress`, linear solids `noise`: fields of noise
            alone on the nodes of each training set.

    Returns:
        A fit with `material`, and with `certificate` and `history` where the model has them.

    Raises InputError for input that cannot be used, RuntimeError where a search fails. A
    UserWarning says where data ask for another kind of solid, and for which.

    >>> round(wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).material.mu, 3)
    0.7
    """
    learned = offered(
        law, "learn", "fit", "a model: LPS(…), ThirdOrder(…), hyperelastic.Hyperelastic(…)"
    )
    if not any(one.kind is one.VAR_KEYWORD for one in signature(learned).parameters.values()):
        (options,) = taken(options, "fit", learned)
    found = learned(samples, **options)
    if isinstance(found, Fit):
        sets, noise = listed(samples, space=True), listed(options.get("noise"), "noise")
        for each, quiet in itertools.zip_longest(sets, noise):
            warn_of_kind(found.material, each, quiet)
    return found
