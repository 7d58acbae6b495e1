"""Bodies of several materials: bond-wise μ and node-wise λ − μ (theory, C15)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri import InputError, Model
from warp_peri.damage import LatticeBody
from warp_peri.points.arrays import mean_inverse
from warp_peri.points.unit_names import USUAL, Units

Field = Callable[[np.ndarray], np.ndarray]

MEANS = ("series", "harmonic", "arithmetic")


@dataclass(frozen=True, eq=False)
class Mixed:
    """Several materials in one body: moduli as fields, one positive influence function (C15).

    Attributes:
        horizon: δ [length].
        lam, mu: λ and μ [stress] as functions of positions [..., d], shape [...].
        mean: of μ along a bond: "series" adds compliances, "harmonic" and "arithmetic" take the two
            ends.
        balls: λ − μ of a node adds the compliances of its ball; False takes the node's own.
        alpha, D: of the influence function, as a Model's.
        units: names of the units of length and stress.
        dimension: d, 2 or 3.

    Raises InputError for another mean, a horizon or an influence function as of Model. No file is
    made of it: fields are functions.
    """

    horizon: float
    lam: Field
    mu: Field
    mean: str = "series"
    balls: bool = True
    alpha: float = 1.0
    D: ArrayLike = (1.0,)
    units: Units = USUAL
    dimension: int = 2

    def __post_init__(self) -> None:
        if self.mean not in MEANS:
            raise InputError(f"mean: expected one of {', '.join(MEANS)}, got {self.mean!r}")
        _ = self.linear

    @property
    def linear(self) -> Model:
        """The influence function, with moduli of one."""
        return Model(
            1.0,
            1.0,
            self.alpha,
            np.asarray(self.D),
            self.horizon,
            units=self.units,
            dimension=self.dimension,
        )

    def moduli(self, body: LatticeBody, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """μ of each bond, shape [N, B], and λ − μ of each node, shape [N]."""

        def excess(x: np.ndarray) -> np.ndarray:
            difference: np.ndarray = np.asarray(self.lam(x)) - np.asarray(self.mu(x))
            return difference

        values = ball_excess(body, weights, excess) if self.balls else excess(body.x)
        return bond_modulus(body, self.mu, self.mean), values

    def content(self) -> dict[str, Any]:
        """Raises InputError: no file is made of functions."""
        raise InputError("save: the moduli of a Mixed are functions, of which no file is made")


def bond_modulus(
    body: LatticeBody, mu: np.ndarray | Callable[[np.ndarray], np.ndarray], mean: str = "series"
) -> np.ndarray:
    """μ of each bond, the same in both directions, shape [N, B].

    Args:
        body: the body.
        mu: a function of positions [..., d]; or, other than for "series", by node, shape [N].
        mean: "series" reads the function along the bond and adds compliances; "harmonic" and
            "arithmetic" take the two ends.

    Raises InputError for another mean, for values by node with "series", which must know what lies
    between them, and where moduli that are read, at nodes or between, are not finite and > 0.
    """
    if mean not in MEANS:
        raise InputError(f"mean: expected one of {', '.join(MEANS)}, got {mean!r}")
    at_nodes = np.asarray(mu(body.x) if callable(mu) else mu, dtype=float)
    if at_nodes.shape != (len(body.x),):
        raise InputError(f"mu: expected shape [{len(body.x)}], got {list(at_nodes.shape)}")
    _check_sign("mu: expected values > 0 that are finite", at_nodes, 1)
    far = np.maximum(body.neighbour, 0)
    near, other = at_nodes[:, None], at_nodes[far]
    if mean == "arithmetic":
        return np.asarray((near + other) / 2)
    if mean == "harmonic":
        return np.asarray(2 * near * other / (near + other))
    if not callable(mu):
        raise InputError(
            'mu: mean="series" reads a function of positions along the bonds, got values by node; '
            'mean="harmonic" takes these'
        )
    words = "mu: expected values > 0 that are finite all along the bonds"
    return 1 / _compliance(body, mu, words, 1, body.neighbour >= 0)


def _compliance(
    body: LatticeBody,
    field: Callable[[np.ndarray], np.ndarray],
    words: str,
    sign: float,
    read: np.ndarray,
) -> np.ndarray:
    """Mean of 1/field along each bond of the ball, 1 where it is not read, shape [N, B].

    Raises InputError with these words where a value that is read has not this sign.
    """

    def values(place: float) -> np.ndarray:
        along = np.asarray(field(body.x[:, None] + place * body.xi), dtype=float)
        along = np.where(read, along, sign)
        _check_sign(words, along, sign)
        return along

    return mean_inverse(values)


def _check_sign(words: str, values: np.ndarray, sign: float) -> None:
    if not (np.isfinite(values).all() and (np.sign(values) == sign).all()):
        wrong = values[~(np.isfinite(values) & (np.sign(values) == sign))]
        raise InputError(f"{words}, got {wrong[0]:g}")


def ball_excess(
    body: LatticeBody, weights: np.ndarray, excess: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """λ − μ of each node, [Σ_b w r² (mean of 1/(λ−μ) along b)]⁻¹, shape [N] (C15).

    Raises InputError where λ − μ, at nodes or between, has both signs, is zero or not finite; take
    it node by node there.
    """
    at_nodes = np.asarray(excess(body.x), dtype=float)
    sign = float(np.sign(at_nodes[0])) or 1.0  # zero is refused
    words = (
        "excess: expected λ − μ of one sign everywhere in the balls, finite; its values at the "
        "nodes are the way where it changes"
    )
    _check_sign(words, at_nodes, sign)
    compliance = _compliance(body, excess, words, sign, np.ones(body.neighbour.shape, bool))
    excess_of_balls: np.ndarray = 1 / (compliance @ (weights * body.r**2))
    return excess_of_balls
