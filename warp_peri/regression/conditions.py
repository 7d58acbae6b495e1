"""The solvability conditions on the symbol that a fit must keep (theory.md, 20–24)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.lps.symbol import Symbol, symbol, zone_wedge
from warp_peri.points.families import BondClasses

CONDITIONS = {"direct": ("D",), "paper": ("D", "gamma", "gamma_minus_2phi")}
"""What each choice asks for: D ≥ ζ s; with `paper` also μΓ ≥ ζ s and μ(Γ − 2φφᵗ) ≥ 0."""

SEARCH_INTERVALS = 120
"""Intervals of the zone grid on which a fit looks for violations."""


@dataclass(frozen=True)
class Conditions:
    """What a fit must keep on every lattice.

    Attributes:
        kind: "direct", D(k) ≥ ζ s(k); "paper" asks for (i) and (iii) of (4.6) besides.
        zeta: ζ [TPa]; None takes 0.0161 of the stiffness that the data of a fit show, which is
            0.0100 TPa on graphene.

    Raises InputError for another kind, or a ζ that is not above zero.
    """

    kind: str = "direct"
    zeta: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in CONDITIONS:
            raise InputError(
                f"conditions: expected one of {', '.join(CONDITIONS)}, got {self.kind!r}"
            )
        if self.zeta is not None and not (np.isfinite(self.zeta) and self.zeta > 0):
            raise InputError(f"zeta: expected a stiffness > 0, got {self.zeta}")


@dataclass(frozen=True)
class LatticeConditions:
    """Conditions on one lattice.

    Attributes:
        classes: bond classes of the lattice.
        asked: what is to be kept on it.
    """

    classes: BondClasses
    asked: Conditions

    @property
    def kind(self) -> str:
        """Which conditions: "direct" or "paper"."""
        return self.asked.kind

    @property
    def zeta(self) -> float:
        """ζ [stress]; InputError where none is given, for it is a part of a stiffness."""
        if self.asked.zeta is None:
            raise InputError("zeta: expected a stiffness > 0, a small part of the shear modulus")
        return self.asked.zeta

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the conditions, in the order of the margins."""
        return CONDITIONS[self.kind]

    def _forms(self, v: np.ndarray, kappa: float) -> list[tuple[float, np.ndarray, float]]:
        """For each condition: κ of its form Γ + κφφᵗ, its derivative to (κ, v), and the level."""
        sigma = self.classes.count * self.classes.r**2
        mu = sigma @ v  # Σ w r² = 1
        by_kappa = np.zeros(1 + len(v))
        by_kappa[0] = 1.0
        schwarz = np.concatenate([[0.0], 2 * sigma / mu**2])
        forms = {
            "D": (kappa, by_kappa, self.zeta),
            "gamma": (0.0, 0 * by_kappa, self.zeta),
            "gamma_minus_2phi": (-2 / mu, schwarz, 0.0),
        }
        return [forms[name] for name in self.names]

    def margins(self, table: Symbol, v: np.ndarray, z: np.ndarray, kappa: float) -> np.ndarray:
        """Λmin / s minus the level [TPa] of each condition, shape [J, K]; ≥ 0 where it holds."""
        return np.array(
            [table.ratio(v, z, form) - level for form, _, level in self._forms(v, kappa)]
        )

    def gradients(self, table: Symbol, v: np.ndarray, z: np.ndarray, kappa: float) -> np.ndarray:
        """Derivatives of the margins to (κ, v, z), shape [J, K, 1 + 2 C]."""
        out = []
        for form, chain, _ in self._forms(v, kappa):
            by_v, by_z, by_form = table.ratio_gradient(v, z, form)
            gradient = by_form[:, None] * chain
            gradient[:, 1:] += by_v
            out.append(np.concatenate([gradient, by_z], axis=1))
        return np.array(out)


class ZoneSearch:
    """Looks for the smallest margins over the whole zone: a grid, then zooms into its minima."""

    def __init__(self, conditions: LatticeConditions, intervals: int = SEARCH_INTERVALS) -> None:
        self.conditions = conditions
        self.k = zone_wedge(conditions.classes.spacing, intervals)
        self.table = symbol(conditions.classes, self.k)
        self.step = np.pi / conditions.classes.spacing / intervals

    def worst(
        self, v: np.ndarray, z: np.ndarray, kappa: float, candidates: int = 8
    ) -> tuple[np.ndarray, np.ndarray]:
        """Smallest margin of each condition, shape [J], and wave vectors near the minima.

        The wave vectors [1/Å], shape [J · candidates, 2], are the ones to add to a fit.
        """
        margins = self.conditions.margins(self.table, v, z, kappa)
        smallest, minima = [], []
        for number, values in enumerate(margins):
            best = values.min()
            for start in self._apart(values, candidates):
                k, value = self._zoom(start, number, v, z, kappa)
                minima.append(k)
                best = min(best, value)
            smallest.append(best)
        return np.array(smallest), np.array(minima)

    def _apart(self, values: np.ndarray, count: int) -> list[np.ndarray]:
        """The lowest waves of the grid that are no neighbours of one another: narrow dips too."""
        found: list[np.ndarray] = []
        for k in self.k[np.argsort(values)]:
            if all(np.abs(k - other).max() > 2.5 * self.step for other in found):
                found.append(k)
                if len(found) == count:
                    break
        return found

    def _zoom(
        self, k: np.ndarray, number: int, v: np.ndarray, z: np.ndarray, kappa: float
    ) -> tuple[np.ndarray, float]:
        """Follow one minimum down through three grids, each ten times finer."""
        patch = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 11)]), axis=-1).reshape(-1, 2)
        reach, edge = self.step, np.pi / self.conditions.classes.spacing
        value = np.inf
        for _ in range(3):
            near = np.append(k[None], np.clip(k + reach * patch, 1e-6 * edge, edge), axis=0)
            table = symbol(self.conditions.classes, near)
            values = self.conditions.margins(table, v, z, kappa)[number]
            k, value = near[np.argmin(values)], float(values.min())
            reach /= 5
        return k, value
