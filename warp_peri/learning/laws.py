"""What may be learned from fields, and the one verb that learns it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from inspect import signature
from typing import Any, overload

from warp_peri.contract import offered, taken
from warp_peri.errors import InputError
from warp_peri.learning.fit import learn
from warp_peri.learning.in_space import learn_in_space
from warp_peri.learning.methods import Bernstein, Kernel, Method
from warp_peri.learning.result import Fit
from warp_peri.learning.training_data import listed
from warp_peri.micromodulus.learning import Micromodulus, one_set
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import check_lattice
from warp_peri.points.samples import Samples
from warp_peri.regression.optimum import Conditions
from warp_peri.regression.settings import Optimum
from warp_peri.third_order.fit import ThirdOrderFit, fit_third_order
from warp_peri.third_order.material import FORMS
from warp_peri.third_order.smoothing import Smoothing

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

    `fit` raises InputError for a horizon below one spacing and for settings of other kinds;
    RuntimeError where no start of the search keeps the conditions.

    >>> wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).certificate.holds
    True
    """

    horizon: float
    kernel: Kernel = Bernstein(10)  # noqa: RUF009 (frozen values)
    method: Method = Optimum()  # noqa: RUF009
    conditions: Conditions = Conditions()  # noqa: RUF009
    loss: str = "auto"
    normalise: bool = False

    def learn(
        self,
        samples: Sets,
        *,
        noise: Samples | Sequence[Samples] | None = None,
        progress: bool | None = None,
    ) -> Any:
        """The Fit, of a set in space a SpaceFit; arguments and errors as for learning.fit.learn.

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
        how = {"degree": kernel.degree, "moduli": method.held}
        return how | {"zeta": asked.zeta, "normalise": self.normalise}


@dataclass(frozen=True)
class ThirdOrder:
    """A crystal with third-order elastic constants t3, tq2, q3 (theory, N1–N6, N22–N29).

    Attributes:
        linear: Micromodulus(…), whose tensors are learned with the constants by one least squares;
            its "auto" symmetry is "isotropic" here.
        smoothing: of the data, which the weights of the gradient undo.
        form: "filtered", closer to the data, or "energy", whose force has an energy and can move.

    The direction of the crystal is stated by the samples' points (Points.axis). `fit` raises
    InputError for another linear part, form or smoothing, and where no moduli are held.

    >>> law = wp.ThirdOrder(wp.Micromodulus(10.0), wp.methods.Smoothing(10.0, 0.2), "energy")
    >>> wp.fit(samples, law).material.proven_strain(5.0) > 0
    True
    """

    linear: Micromodulus
    smoothing: Smoothing
    form: str = "filtered"

    def learn(
        self,
        samples: Sets,
        *,
        noise: Samples | Sequence[Samples] | None = None,
        progress: bool | None = None,
    ) -> ThirdOrderFit:
        """The fit; a UserWarning says where training data reach beyond the proven strain."""
        linear, smoothing = self.linear, self.smoothing
        if not isinstance(linear, Micromodulus):
            raise InputError(
                "linear: expected Micromodulus(horizon); an LPS goes in by "
                f"ThirdOrderCrystal(tensors_of(model, spacing), …), got {linear!r:.60}"
            )
        if self.form not in FORMS:
            raise InputError(f"form: expected 'filtered' or 'energy', got {self.form!r:.50}")
        if noise:
            raise InputError("noise: expected none for a crystal model")
        if not isinstance(smoothing, Smoothing):
            raise InputError(f"smoothing: expected Smoothing(…), got {smoothing!r:.60}")
        if linear.moduli is None:
            raise InputError("moduli: expected some that are held, beside third-order constants")
        auto = isinstance(linear.symmetry, str) and linear.symmetry == "auto"
        found = fit_third_order(
            one_set(samples),
            linear.horizon,
            smoothing,
            form=self.form,
            symmetry="isotropic" if auto else linear.symmetry,
            orientation=linear.orientation,
            moduli=linear.moduli,
        )
        proven = found.material.proven_strain(found.material.spacing)
        if found.largest_gradient > proven:
            warnings.warn(
                f"strain: solutions are proven unique up to |H| = {proven:.2%}, the training data "
                f"reach {found.largest_gradient:.2%}; a larger ridge of the smoothing than "
                f"{smoothing.ridge:g} may prove more",
                stacklevel=4,
            )
        return found


@overload
def fit(samples: Sets, law: LPS, **options: Any) -> Fit: ...
@overload
def fit(samples: Sets, law: ThirdOrder, **options: Any) -> ThirdOrderFit: ...
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

    Raises InputError for input that cannot be used, RuntimeError where a search fails.

    >>> round(wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).material.mu, 3)
    0.7
    """
    learned = offered(law, "learn", "fit", "a model: LPS(…), ThirdOrder(…), tissue.Dictionary(…)")
    if not any(one.kind is one.VAR_KEYWORD for one in signature(learned).parameters.values()):
        (options,) = taken(options, "fit", learned)
    return learned(samples, **options)
