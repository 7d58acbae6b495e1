"""What may be learned from fields, and the one verb that learns it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from inspect import signature
from typing import Any, overload

from warp_peri.contract import MaterialFit, offered, taken
from warp_peri.errors import InputError
from warp_peri.fitting.diagnose import warn_of_kind
from warp_peri.fitting.result import Fit
from warp_peri.fitting.settings import Bernstein, Conditions, Kernel, Method, Optimum
from warp_peri.fitting.training_data import listed
from warp_peri.learning.fit import learn
from warp_peri.learning.in_space import learn_in_space
from warp_peri.materials.crystal_fit import Micromodulus
from warp_peri.materials.third_order_fit import ThirdOrder
from warp_peri.points.arrays import check_positive
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import check_lattice
from warp_peri.points.samples import Samples

Sets = Samples | Dataset | Sequence[Samples]


@dataclass(frozen=True)
class LPS:
    """The linear peridynamic solid, its influence function learned (theory, 4–9).

    Attributes:
        horizon: δ [Å], at least one spacing.
        kernel: Bernstein polynomials, or on lattices a function of the bond length whose parameters
            are learned, from the values it has. Several functions are several starts, and the best
            is kept.
        method: Optimum() starts at the constrained optimum, from plain kernels; TwoStage() is
            Algorithm 1 of You et al. (2021); Constrained() takes Adam there, and checks it.
        conditions: what must hold on every lattice.
        loss: "residual" is (10); "corrected" takes off what noise adds to it; "output" goes on to
            fit displacement; "auto" takes the residual where noise does not matter, unless local
            elasticity of the same moduli has the better training displacement.
        normalise: divide each sample by ‖b‖ in the residual.

    Raises InputError for a horizon that is no number > 0. `fit` does for one below a spacing and
    for settings of other kinds, and RuntimeError where no start of the search keeps the conditions.

    >>> wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).certificate.holds
    True
    """

    horizon: float
    kernel: Kernel = Bernstein(10)  # noqa: RUF009 (frozen values)
    method: Method = Optimum()  # noqa: RUF009
    conditions: Conditions = Conditions()  # noqa: RUF009
    loss: str = "auto"
    normalise: bool = False

    def __post_init__(self) -> None:
        check_positive("horizon", self.horizon)

    def learn(
        self,
        samples: Sets,
        *,
        noise: Samples | Sequence[Samples] | None = None,
        progress: bool | None = None,
    ) -> Any:
        """The Fit, of a set in space a MaterialFit; arguments and errors as for learning.fit.learn.

        In space it takes one set on a cubic lattice, Bernstein polynomials, Optimum() with its
        moduli, "direct" conditions and the residual, without noise; InputError for others.
        """
        sets = listed(samples, space=True)
        if any(each.points.dimension == 3 for each in sets):
            check_lattice(sets[0])
            return learn_in_space(sets[0], self.horizon, **self._in_space(sets, noise))
        return learn(samples, **vars(self), noise=noise, progress=progress)

    def _in_space(self, sets: list[Samples], noise: Any) -> dict[str, Any]:
        """What is asked for in space; InputError for what is for sheets alone."""
        kernel, method, asked = self.kernel, self.method, self.conditions
        if (
            not isinstance(kernel, Bernstein)
            or not isinstance(method, Optimum)
            or asked.kind != "direct"
            or self.loss not in ("auto", "residual")
            or noise
            or len(sets) != 1
        ):
            raise InputError(
                'samples: in space expected one set, Bernstein(degree), Optimum(), "direct" '
                "conditions, and the residual without noise"
            )
        how = {"degree": kernel.degree, "method": method}
        return how | {"zeta": asked.zeta, "normalise": self.normalise}


@overload
def fit(samples: Sets, law: LPS, **options: Any) -> Fit: ...
@overload
def fit(samples: Sets, law: Micromodulus | ThirdOrder, **options: Any) -> MaterialFit: ...
@overload
def fit(samples: Any, law: Any, **options: Any) -> Any: ...
def fit(samples: Any, law: Any = None, **options: Any) -> Any:
    """Learn a material model from samples.

    Args:
        samples: one set or several; of a Dataset `train`, or its only set.
        law: what may be learned, and how: LPS(horizon, …), ThirdOrder(Micromodulus(…)),
            tissue.Dictionary(…).
        options: of its `learn`; all take `progress`, linear solids `noise`: fields of noise
            alone on the nodes of each training set.

    Returns:
        A fit with `material`, and with `certificate` and `history` where the model has them.

    Raises InputError for input that cannot be used, RuntimeError where a search fails. A
    UserWarning says where data ask for another kind of solid, and for which.

    >>> round(wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).material.mu, 3)
    0.7
    """
    learned = offered(law, "learn", "fit", "a model: LPS(…), ThirdOrder(…), tissue.Dictionary(…)")
    if not any(one.kind is one.VAR_KEYWORD for one in signature(learned).parameters.values()):
        (options,) = taken(options, "fit", learned)
    found = learned(samples, **options)
    if isinstance(law, LPS | Micromodulus | ThirdOrder):
        sets, noise = listed(samples, space=True), listed(options.get("noise"), "noise")
        for each, quiet in itertools.zip_longest(sets, noise):
            warn_of_kind(found.material, each, quiet)
    return found
