"""How sure a fit is: bands from fits to other choices of the loads."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from scipy.special import stdtrit
from tqdm import tqdm

from warp_peri.errors import InputError, quietly
from warp_peri.points.arguments import Bound, Natural, Share, typed, typed_methods
from warp_peri.points.dataset import Dataset
from warp_peri.points.points import Samples
from warp_peri.protocols import offered

LEAST_LOADS, LEAST_DRAWS, DRAWS = 4, 10, 40
ONE_DEVIATION = (0.1587, 0.8413)
"""Of normal numbers, the parts below minus and plus one standard deviation."""
Draws = Annotated[int, Bound(f"at least {LEAST_DRAWS}", lambda draws: draws >= LEAST_DRAWS)]
REDRAWN = 0.2
"""Of the draws, that may determine no law and are drawn again."""


@typed_methods
@dataclasses.dataclass(frozen=True)
class BootstrapResult:
    """Materials learned from other choices of the loads.

    Attributes:
        materials: one of each choice.
        loads: how many there were.
        knows: what the bands hold and what they do not, in a sentence.
    """

    materials: list[Any]
    loads: int
    knows: str

    def deviation(self, quantity: Callable[[Any], np.ndarray | float]) -> np.ndarray:
        """Standard deviation of anything a material determines, of the shape of the quantity.

        Half of what lies between 16 and 84 % of the draws: one that hardly determines a law does
        not widen the band.
        """
        values = np.array([np.asarray(quantity(material)) for material in self.materials])
        low, high = np.quantile(values, ONE_DEVIATION, axis=0)
        return np.asarray(np.sqrt(self.loads / (self.loads - 1)) * (high - low) / 2)

    def band(
        self, material: Any, quantity: Callable[[Any], np.ndarray | float], level: Share = 0.9
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the band that holds a quantity with probability `level`.

        About the material learned from all loads, by Student's distribution of their number.
        Raises InputError for a level that is no probability.
        """
        half = stdtrit(self.loads - 1, (1 + level) / 2) * self.deviation(quantity)
        middle = np.asarray(quantity(material))
        return middle - half, middle + half


@typed
def bootstrap(
    samples: Samples | Dataset,
    law: Any,
    *,
    draws: Draws = DRAWS,
    seed: Natural = 0,
    progress: bool = False,
    **options: Any,
) -> BootstrapResult:
    """The same fit to other choices of the loads, with repetition (bootstrap).

    Args:
        samples: that the law is learned from; of a Dataset `train`, or its only set.
        law: as for `fit`; the symmetry or the degree that all loads ask for is kept.
        draws, seed: how many choices, and of which random numbers.
        progress: show a progress bar.
        options: of `fit`.

    Raises InputError for fewer than four loads or ten draws, what `fit` raises, and where a fifth
    of the draws determine no law.
    """
    one = samples.obvious("train") if isinstance(samples, Dataset) else samples
    count, rng, again = len(one), np.random.default_rng(seed), 0
    if count < LEAST_LOADS:
        raise InputError(f"samples: expected at least {LEAST_LOADS} loads, got {count}")
    offered(law, "learn", "bootstrap", "a model: LPS(…), Crystal(…)")
    if getattr(law, "symmetry", None) == "auto":
        law = dataclasses.replace(law, symmetry=law.learn(one, **options).material.symmetry)
    if getattr(law, "kernel", law) is None:
        law = dataclasses.replace(law, kernel=law.learn(one, **options).law.kernel)
    materials: list[Any] = []
    with tqdm(total=draws, desc="fits", unit="fit", disable=not progress) as bar:
        while len(materials) < draws:
            try:
                with quietly():  # the fit to all loads warns
                    chosen = one[rng.integers(count, size=count)]
                    materials.append(law.learn(chosen, **options).material)
                bar.update()
            except InputError:
                again += 1
                if again > REDRAWN * draws:
                    raise
    more = f" ({again} more told of no model)" if again else ""
    knows = (
        f"{draws} choices of the loads with repetition{more}, of {count}: what differs from load "
        "to load, noise among it; not an error that all loads share"
    )
    return BootstrapResult(materials, count, knows)
