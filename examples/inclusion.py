"""A round inclusion of another material under equal strain: errors against the exact field.

    python examples/inclusion.py

Moduli are functions of position. Bonds add the compliances of μ along them, balls those of λ − μ
(theory, C15); the exact field is given on the collar. Prints errors and their order by pair.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import warp_peri as wp
from warp_peri.fracture import LatticeBody, box_nodes
from warp_peri.points.arguments import mean_inverse

Field = Callable[[np.ndarray], np.ndarray]
RADIUS, RATIO = 0.5, {2: 3.0, 3: 2.0}
"""Radius, and horizon over spacing by dimension."""
UNITS = ("sigma", "epsilon/sigma^3")  # of numbers that have none
CASES = {
    "stiff in soft": ((30.0, 10.0), (1.5, 1.0)),
    "soft in stiff": ((1.5, 1.0), (30.0, 10.0)),
    "nearly incompressible inside": ((500.0, 1.0), (1.5, 1.0)),
    "nearly incompressible outside": ((1.5, 1.0), (500.0, 1.0)),
    "nearly incompressible both": ((500.0, 1.0), (500.0, 2.0)),
}
"""(λ, μ) inside and outside."""


@dataclass(frozen=True, eq=False)
class Mixed:
    """Several materials in one body: λ and μ [stress] as functions of positions [..., d].

    Any object with `linear` and `moduli` can be solved in a Cracked.
    """

    horizon: float
    lam: Field
    mu: Field
    units: Any = ("angstrom", "TPa")
    dimension: int = 2

    @property
    def linear(self) -> wp.LPSMaterial:
        """The influence function, 1/r, with moduli of one."""
        how = {"units": self.units, "dimension": self.dimension}
        return wp.LPSMaterial(1.0, 1.0, 1.0, np.ones(1), self.horizon, **how)

    def moduli(self, body: LatticeBody, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """μ of each bond, shape [N, B], and λ − μ of each node, shape [N], from its whole ball."""

        def compliance(field: Field, there: Any, sign: float) -> np.ndarray:
            """Mean of 1/field along each bond that is there, 1 along others."""

            def along(share: float) -> np.ndarray:
                values = np.where(there, field(body.x[:, None] + share * body.xi), sign)
                if not (np.isfinite(values).all() and (np.sign(values) == sign).all()):
                    raise wp.InputError("lam, mu: expected μ > 0 and λ − μ of one sign, finite")
                return values

            return mean_inverse(along)

        def excess(x: np.ndarray) -> np.ndarray:
            return np.asarray(self.lam(x) - self.mu(x))

        of_bonds = 1 / compliance(self.mu, body.neighbour >= 0, 1.0)
        sign = float(np.sign(excess(body.x[:1])[0])) or 1.0
        balls = compliance(excess, np.ones(body.neighbour.shape, bool), sign)
        return of_bonds, 1 / (balls @ (weights * body.r**2))


def inclusion(cells: int, inside: tuple, outside: tuple, d: int = 2) -> float:
    """Relative error of the displacement at spacing 1/cells, in the plane or in space."""
    h, ratio = 1 / cells, RATIO[d]
    x = box_nodes(d * (2 * (1 + 2 * ratio * h),), h)
    points = wp.Points(x, (np.abs(x) <= 1).all(axis=1), h, units=UNITS)

    def field(a: float, b: float) -> Field:
        return lambda place: np.where(np.linalg.norm(place, axis=-1) < RADIUS, a, b)

    lam, mu = (field(*pair) for pair in zip(inside, outside))
    bulk_in, bulk_out = (d * pair[0] + 2 * pair[1] for pair in (inside, outside))
    shear = 2 * (d - 1) * outside[1]
    core = (bulk_out + shear) / (bulk_in + shear)
    r = np.linalg.norm(x, axis=1)
    exact = x * np.where(r < RADIUS, core, 1 + (core - 1) * (RADIUS / r) ** d)[:, None]
    u = wp.solve(Mixed(ratio * h, lam, mu, UNITS, d), wp.Cracked(points, u=exact)).u
    free = points.interior
    return float(np.linalg.norm((u - exact)[free]) / np.linalg.norm(exact[free]))


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    cells = [8, 16, 32]
    for name, materials in CASES.items():
        errors = [inclusion(n, *materials) for n in cells]
        order = -np.polyfit(np.log(cells), np.log(errors), 1)[0]
        print(f"{name:30}", *(f"{100 * e:.2f} %" for e in errors), f"order {order:.2f}")
