"""An answer and how wrong it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.unit_names import symbols
from warp_peri.prediction.guarantee import Guarantee, guarantee
from warp_peri.prediction.members import Factors
from warp_peri.prediction.placed import Parts, PlacedMembers
from warp_peri.shown import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WORDS = {
    "left": "what is left to correct",
    "waves": "waves",
    "data": "data",
    "strain": "strain beyond third order",
    "axis": "the direction of the crystal, which is not stated, or not that of the data",
    "noise": "noise of what is given",
}


@dataclass(frozen=True)
class Quantity:
    """A quantity of an answer.

    Attributes:
        value: of the answer's displacement.
        correction: signed; value + correction is what the rich member says.
        bar: likely error of the value, same shape.
    """

    value: np.ndarray
    correction: np.ndarray
    bar: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Answer(Shown):
    """A body at rest, and how wrong it may be.

    Attributes:
        u: displacement [length] on all nodes, shape [N, d].
        error: likely error of u on the interior over u, a fraction: with the factors as they were
            calibrated nine of ten answers are closer (theory.md, Q4).
        parts: the same by origin: left, waves, data, strain, noise, and axis where the direction of
            a crystal is not stated; error is the root of the sum of their squares.
        kept: whether the error is within the tolerance and nothing is uncovered.
        why: in one sentence.
        uncovered: what the error does not speak of.
        corrections: times that the rich member was asked to correct.
        tolerance: that was asked for; None for the best.
    """

    u: np.ndarray
    error: float
    parts: dict[str, float]
    kept: bool
    why: str
    uncovered: tuple[str, ...]
    corrections: int
    tolerance: float | None
    operator: PlacedMembers | None = field(default=None, repr=False)
    load: np.ndarray | None = field(default=None, repr=False)
    known: Parts | None = field(default=None, repr=False)

    @cached_property
    def fields(self) -> Parts:
        """Errors by origin as fields on the interior; computed now where a screen sufficed."""
        if self.known is not None:
            return self.known
        placed, load = self._placed()
        left = placed.correction(load, self.u)
        return placed.doubts(self.u, left, placed.recorded(self.u)[0])

    @property
    def corrected(self) -> np.ndarray:
        """The next answer, u and the correction that is left, on all nodes."""
        return self._plus(self.fields.left)

    def of(self, quantity: Callable[[np.ndarray], Any]) -> Quantity:
        """A quantity with its error (Q4).

        Args:
            quantity: of a displacement on all nodes, [N, d] → numbers; prediction.quantities has
                strain, stress, means and forces.
        """
        at, factors, fields = np.asarray(quantity(self.u), float), self._factors, self.fields

        def change(part: np.ndarray | None) -> np.ndarray:
            if part is None:
                return np.zeros_like(at)
            return np.asarray(np.asarray(quantity(self._plus(part)), float) - at)

        left = change(fields.left)
        changes = Parts(
            left,
            change(fields.waves),
            change(fields.data),
            None if fields.strain is None else change(fields.strain),
            change(fields.axis),
            fields.pull,
        )
        squares = combined(changes, factors, np.abs)
        return Quantity(at, left, np.sqrt(sum(value**2 for value in squares.values())))

    def map(self) -> np.ndarray:
        """Likely error of the displacement at each node [length], shape [N]; 0 on the collar."""
        found = combined(self.fields, self._factors, lambda part: np.linalg.norm(part, axis=-1))
        bar = np.zeros(len(self.u))
        bar[self._placed()[0].points.interior] = np.sqrt(sum(v**2 for v in found.values()))
        return bar

    @cached_property
    def guarantee(self) -> Guarantee | None:
        """How far the rich member's own solution is at most, proven; None where nothing is (Q9).

        It speaks of the model, not of the atoms.
        """
        placed, load = self._placed()
        return guarantee(placed, load, self.u)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The map of the likely error over the nodes."""
        import matplotlib.pyplot as plt

        placed, _ = self._placed()
        ax = plt.figure(layout="constrained").add_subplot() if ax is None else ax
        x, inside = placed.points.x, placed.points.interior
        shown = ax.scatter(x[inside, 0], x[inside, 1], c=self.map()[inside], s=12, linewidths=0)
        ax.figure.colorbar(shown, ax=ax, label=f"likely error [{symbols(placed.points.units)[0]}]")
        ax.set(aspect="equal", xlabel="x", ylabel="y")
        return ax

    @property
    def _factors(self) -> Factors:
        return self._placed()[0].family.factors

    def _placed(self) -> tuple[PlacedMembers, np.ndarray]:
        if self.operator is None or self.load is None:
            raise InputError("answer: of a body only u, error and parts are known")
        return self.operator, self.load

    def _plus(self, part: np.ndarray) -> np.ndarray:
        u = self.u.copy()
        u[self._placed()[0].points.interior] += part
        return u

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        parts = ", ".join(f"{name} {value:.2%}" for name, value in self.parts.items() if value)
        rows = [("likely error", f"{self.error:.2%}"), ("of it", parts or "nothing")]
        if self.operator is not None and getattr(self.operator.points, "axis", None) is not None:
            rows.append(("axis", "stated, believed"))
        rows += [("not covered", one) for one in self.uncovered]
        return [*rows, ("why", self.why)]


def combined(parts: Parts, factors: Factors, size: Callable[[np.ndarray], Any]) -> dict[str, Any]:
    """Likely errors by origin, of fields of errors or what was made of them (Q4)."""
    share = parts.pull * factors.floor / np.sqrt(2)
    found = {"left": factors.left * size(parts.left), "waves": share * size(parts.waves)}
    found["data"] = share * size(parts.data)
    if parts.strain is not None:
        found["strain"] = factors.floor * size(parts.strain)
    if parts.axis is not None:
        found["axis"] = size(parts.axis)
    return found
