"""What a material, an operator, a problem and a law are: what one must offer to be taken as such.

Nothing derives from these. A new law is whatever offers the same, and passes the conformance test
(tests/conformance).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from warp_peri.errors import InputError


class Operator(Protocol):
    """A material on points: what is resolved and built once, and then used.

    In equilibrium ``op(u)`` equals ``op.load(b)``: b itself on the interior nodes, or on scattered
    points a node's share of the load around it.
    """

    model: Any
    """The material's numbers as they are used on these points."""
    points: Any

    def __call__(self, u: Any) -> Any:
        """Minus the internal force density [stress/length] on the interior nodes, [..., I, d]."""

    def load(self, b: np.ndarray) -> np.ndarray:
        """What the operator equals in equilibrium with b, shape [..., N, d] to [..., I, d]."""

    def product(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The derivative of the operator at u along v, shape [..., I, d]."""

    def energy(self, u: np.ndarray) -> np.ndarray | None:
        """What the operator is the derivative of: ∂(energy)/∂u_i = h^d op(u)_i; None without."""

    def stress(self, u: np.ndarray) -> np.ndarray | None:
        """At the interior nodes, shape [..., I, d, d]; None where a law has none."""

    def rest(self, b: Any, u: Any, solver: Any) -> Any:
        """The Solution in equilibrium with b on the interior, u given on the collar."""


class Material(Protocol):
    """A law with its numbers."""

    units: tuple[str, str]
    horizon: float
    dimension: int

    def on(self, points: Any) -> Operator:
        """The material on points: transferred there, certified, with its bonds."""

    def content(self) -> dict[str, Any]:
        """What its file holds; `load` reads it again."""


class Problem(Protocol):
    """What is given of a body, and what is asked."""

    def solved(self, material: Any, solver: Any, options: dict[str, Any]) -> Any:
        """The Solution for a material, or for its operator on the problem's points."""


class Law(Protocol):
    """What may be learned: a family of materials, and how its numbers are found."""

    def learn(self, samples: Any, **options: Any) -> Any:
        """The Fit: material, certificate, history."""


def offered(given: Any, name: str, verb: str, kinds: str) -> Any:
    """The method `name` of what was given; InputError that says what `verb` is for otherwise."""
    method = getattr(given, name, None)
    if method is None or isinstance(given, type):
        what = given.__name__ if isinstance(given, type) else type(given).__name__
        raise InputError(f"{verb}: expected {kinds}, got {what}")
    return method


def placed(material: Any, points: Any, **options: Any) -> Any:
    """The operator of a material on points; what is an operator on these points already, as it is.

    Raises InputError for an operator on other points, and for what is neither.
    """
    if hasattr(material, "rest") and not hasattr(material, "on"):
        mine = material.points
        same = mine is points or (
            mine.spacing == points.spacing
            and np.array_equal(mine.x, points.x)
            and np.array_equal(mine.interior, points.interior)
        )
        if not same:
            raise InputError("operator: expected one on the points of the problem, got another's")
        return material
    return offered(material, "on", "solve", "a material, as fit(…).material or load(…)")(
        points, **options
    )
