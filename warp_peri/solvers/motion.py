"""What a motion leaves, whatever the law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arguments import typed_methods
from warp_peri.protocols import is_tensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@typed_methods
@dataclass(frozen=True, eq=False)
class Motion:
    """A motion, or a load that rises slowly.

    Attributes:
        time: of the records (of slow loads their factor), shape [R].
        u: displacement at the end [length], shape [N, d].
        v: velocity at the end [length/time], shape [N, d]; None of what has none.
        history: what was written down at these times, by name, first dimension R.
        details: what only this material knows: the state at the end, the body.

    >>> start = wp.Dirichlet(points, None, u[0])
    >>> wp.simulate(model, start, density=2200.0, step=0.005, steps=4).time.shape
    (4,)
    """

    time: np.ndarray
    u: np.ndarray
    v: np.ndarray | None = None
    history: dict[str, np.ndarray] = field(default_factory=dict)
    details: Any = None

    def __getitem__(self, name: str) -> np.ndarray:
        """One history by its name; InputError lists those there are."""
        if name not in self.history:
            known = ", ".join(self.history) or "none"
            raise InputError(f"motion: expected one of {known}, got {name!r}")
        return self.history[name]

    @property
    def energy(self) -> np.ndarray:
        """What a conservative motion keeps, shape [R]."""
        return self["energy"]

    @property
    def drift(self) -> float:
        """Largest departure of the energy from its first value, relative.

        Raises InputError for a motion that records no energy, as that of a body that breaks, whose
        books are `missing`.
        """
        energy = self.energy
        gone = float(np.abs(energy - energy[0]).max())
        return gone / float(np.abs(energy[0])) if gone else 0.0

    @property
    def missing(self) -> float:
        """Largest part of the largest work so far that the ledger does not account for."""
        if len(self.time) == 0:
            raise InputError("motion: expected a run of some steps, nothing has been recorded")
        work, parts = self["work"], ("kinetic", "elastic", "dissipated")
        missing = np.abs(work - sum(self[name] for name in parts))
        return float(missing.max() / np.abs(work).max()) if work.any() else 0.0

    def plot(self, name: str = "", *, ax: Axes | None = None) -> Axes:
        """One history over time, of every record; the first one where none is named."""
        import matplotlib.pyplot as plt

        name = name or next(iter(self.history), "")
        values = self[name]
        ax = plt.figure(layout="constrained").add_subplot() if ax is None else ax
        ax.plot(self.time, values.reshape(len(values), -1))
        ax.set(xlabel="time", ylabel=name)
        return ax

    def __repr__(self) -> str:
        names = ", ".join(self.history) or "none"
        span = f"{self.time[0]:.4g} to {self.time[-1]:.4g}" if len(self.time) else "no time"
        return f"Motion\n  records    {len(self.time)}, {span}\n  histories  {names}"


def refuse_learning(problem: Any, options: dict[str, Any], verb: str) -> None:
    """InputError for tensors that ask for a gradient which a problem does not have."""
    if asks_for_gradient((vars(problem), options)) or "parameters" in options:
        raise InputError(
            f"{verb}: expected tensors without a gradient, which only {LEARNS[verb]} have; got a "
            f"{type(problem).__name__}"
        )


LEARNS = {
    "solve": "a Dirichlet, a Periodic and a Cracked",
    "simulate": "waves, what flows, and pulls of bonds that soften, of one process",
}


def asks_for_gradient(given: Any) -> bool:
    """Whether a tensor is among values, mappings and sequences that a gradient is asked for."""
    if isinstance(given, Mapping):
        return any(map(asks_for_gradient, given.values()))
    if isinstance(given, list | tuple):
        return any(map(asks_for_gradient, given))
    return is_tensor(given) and bool(given.requires_grad)
