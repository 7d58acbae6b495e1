"""How sure a fit is: bands from fits to other choices of the loads."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import stdtrit
from tqdm import tqdm

from warp_peri.contract import offered
from warp_peri.errors import InputError
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples, part

LEAST_LOADS, DRAWS = 4, 40
ONE_DEVIATION = (0.1587, 0.8413)
"""Of normal numbers, the parts below minus and plus one standard deviation."""
REDRAWN = 0.2
"""Of the draws, that may determine no law and are drawn again."""


@dataclasses.dataclass(frozen=True)
class Resampled:
    """Materials learned from other choices of the loads.

    Attributes:
        materials: one of each choice.
        loads: how many there were.
        spread: what the materials' standard deviation is multiplied by.
        drawn: whether they are draws. Their deviation then is half of what lies between 16 and
            84 % of them: a draw that hardly determines a law does not widen the band.
        knows: what the bands hold and what they do not, in a sentence.
    """

    materials: list[Any]
    loads: int
    spread: float
    knows: str
    drawn: bool = False

    def deviation(self, quantity: Callable[[Any], np.ndarray | float]) -> np.ndarray:
        """Standard deviation of anything a material determines, of the shape of the quantity."""
        values = np.array([np.asarray(quantity(material)) for material in self.materials])
        if not self.drawn:
            return np.asarray(self.spread * values.std(axis=0))
        low, high = np.quantile(values, ONE_DEVIATION, axis=0)
        return np.asarray(self.spread * (high - low) / 2)

    def band(
        self, material: Any, quantity: Callable[[Any], np.ndarray | float], level: float = 0.9
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the band that holds a quantity with probability `level`.

        About the material learned from all loads, by Student's distribution of their number.
        Raises InputError for a level that is no probability.
        """
        if not 0 < level < 1:
            raise InputError(f"level: expected a probability between 0 and 1, got {level}")
        half = stdtrit(self.loads - 1, (1 + level) / 2) * self.deviation(quantity)
        middle = np.asarray(quantity(material))
        return middle - half, middle + half


def resample_loads(
    samples: Samples | Dataset,
    law: Any,
    *,
    leave_one_out: bool = False,
    draws: int = DRAWS,
    seed: int = 0,
    progress: bool = False,
    **options: Any,
) -> Resampled:
    """The same fit to other choices of the loads: bootstrap, or each load left out in turn.

    Args:
        samples: that the law is learned from; of a Dataset `train`, or its only set.
        law: as for `fit`; one with symmetry="auto" is given the symmetry that all loads have.
        leave_one_out: as many fits as loads, instead of `draws` choices with repetition.
        draws, seed: of the bootstrap.
        progress: show a progress bar.
        options: of `fit`.

    Raises InputError for fewer than four loads or ten draws, and what `fit` raises: for a load left
    out always, of a bootstrap where a fifth of the draws determine no law.
    """
    one = samples.obvious("train") if isinstance(samples, Dataset) else samples
    count, rng = len(one), np.random.default_rng(seed)
    if count < LEAST_LOADS:
        raise InputError(f"samples: expected at least {LEAST_LOADS} loads, got {count}")
    if not leave_one_out and draws < 10:
        raise InputError(f"draws: expected at least 10, got {draws}")
    offered(law, "learn", "resample_loads", "a model: LPS(…), Micromodulus(…)")
    if getattr(law, "symmetry", None) == "auto":
        law = dataclasses.replace(law, symmetry=law.learn(one, **options).material.symmetry)
    wanted, again = count if leave_one_out else draws, 0
    materials: list[Any] = []
    with tqdm(total=wanted, desc="fits", unit="fit", disable=not progress) as bar:
        while len(materials) < wanted:
            kept = np.delete(np.arange(count), len(materials))
            choice = kept if leave_one_out else rng.integers(count, size=count)
            try:
                with warnings.catch_warnings():  # the fit to all loads warns
                    warnings.simplefilter("ignore", UserWarning)
                    materials.append(law.learn(part(one, choice), **options).material)
            except InputError:
                again += 1
                if leave_one_out or again > REDRAWN * draws:
                    raise
                continue
            bar.update()
    how = "each load left out in turn"
    if not leave_one_out:
        how = f"{draws} choices of the loads with repetition"
        how += f" ({again} more told of no model)" if again else ""
    knows = (
        f"{how}, of {count}: what differs from load to load, noise among it; not an error that all "
        "loads share"
    )
    spread = float(np.sqrt(count - 1 if leave_one_out else count / (count - 1)))
    return Resampled(materials, count, spread, knows, drawn=not leave_one_out)
