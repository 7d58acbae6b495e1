"""Learning a family: its members from one data set, and how large their doubts are (Q4–Q6)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_peri.contract import offered
from warp_peri.errors import InputError
from warp_peri.points.samples import Samples
from warp_peri.points.strain import largest_strain
from warp_peri.prediction.members import Factors, Members
from warp_peri.prediction.placed import PlacedMembers
from warp_peri.prediction.predict import MOST
from warp_peri.prediction.spectrum import KNOTS, recorded

COVERED, SCREENED = 0.9, 0.95
"""Shares of the samples that the factors are set to cover, and that of the screen."""
SHORT = 5.0
"""Wavelengths below so many spacings are left to the record by wavelength, not to the factors."""
SHRUNK, POORER = 0.8, 2 / 3
"""Horizon and degree of the second member over those of the rich one."""
ROUNDING = 1e-12


@dataclass(frozen=True)
class Family:
    """A family of laws of one material.

    Attributes:
        rich: the best law that the data bear, LPS(…), ThirdOrder(…) or Micromodulus(…).
        second: a poorer law, as good on long waves; by default the rich one with a shorter horizon.
    """

    rich: Any
    second: Any = None

    def learn(
        self, samples: Any, *, held_out: Samples | None = None, progress: bool | None = None
    ) -> FamilyFit:
        """The fit.

        Args:
            samples: with loads, at least four; of a Dataset `train`, or its only set.
            held_out: samples on the same kind of nodes, not learned from, that calibrate too.
            progress: as for the laws.

        Raises InputError for samples that cannot be halved, and whatever the laws refuse.
        """
        from warp_peri.points.dataset import Dataset

        if isinstance(samples, Dataset):
            samples = samples.sets["train"] if "train" in samples.sets else samples.obvious()
        if not isinstance(samples, Samples) or len(samples) < 4:
            raise InputError("samples: expected one set of at least four samples for a family")
        learn = offered(self.rich, "learn", "fit", "a law as the rich member")
        fits = {"rich": learn(samples, progress=progress)}
        second = self.second or poorer(self.rich)
        fits["second"] = second.learn(samples, progress=progress)
        halves = [learn(part(samples, slice(n, None, 2)), progress=progress) for n in (0, 1)]
        strain = largest_strain(samples.points, samples.u)
        kelvin = samples.arrays.get("temperature")
        temperature = None if kelvin is None else float(np.mean(kelvin))
        family = Members(
            fits["rich"].material,
            fits["second"].material,
            (halves[0].material, halves[1].material),
            strain=strain,
            temperature=temperature,
        )
        family = calibrated(family, samples, held_out)
        return FamilyFit(family, fits["rich"])


@dataclass(frozen=True)
class FamilyFit:
    """A learned family.

    Attributes:
        material: the family.
        rich: the fit of its rich member.
    """

    material: Members
    rich: Any

    @property
    def certificate(self) -> Any:
        """Of the rich member."""
        return getattr(self.rich, "certificate", None)

    @property
    def history(self) -> Any:
        """Of the rich member's fit."""
        return getattr(self.rich, "history", None)


def part(samples: Samples, which: slice) -> Samples:
    """Some of the samples."""
    arrays = {name: values[which] for name, values in samples.arrays.items()}
    return replace(samples, u=samples.u[which], b=samples.loads[which], arrays=arrays)


def poorer(law: Any) -> Any:
    """The same law with a shorter horizon and, of polynomials, fewer of them."""
    inner = getattr(law, "linear", law)
    if not hasattr(inner, "horizon"):
        raise InputError("second: expected a law, as none with a shorter horizon is known")
    changes: dict[str, Any] = {"horizon": SHRUNK * inner.horizon}
    degree = getattr(getattr(inner, "kernel", None), "degree", None)
    if degree is not None:
        changes["kernel"] = replace(inner.kernel, degree=max(1, round(POORER * degree)))
    changed = replace(inner, **changes)
    return replace(law, linear=changed) if hasattr(law, "linear") else changed


def calibrated(family: Members, samples: Samples, held_out: Samples | None) -> Members:
    """The family with its factors and its record by wavelength, from answers whose truth is known.

    Left, floor and screen are quantiles of what was true over what was computed, on all samples but
    the training waves that are short.
    """
    bare = replace(family, factors=Factors(1.0, 1.0, 1.0, 0.0), record=None)
    wavelength = samples.spacing * KNOTS
    rows = [_measured(bare, samples, wavelength)]
    if held_out is not None:
        rows.append(_measured(bare, held_out, wavelength))
    record = None
    if wavelength[0] > 0:
        record = recorded(
            SHORT * samples.spacing,
            wavelength,
            np.concatenate([row["shares"] for row in rows]),
            np.concatenate([row["true"] for row in rows]),
        )
    long = rows[0]["length"] >= SHORT * samples.spacing
    chosen = [long if long.any() else ~long, *(np.ones(len(row["true"]), bool) for row in rows[1:])]

    def quantile(above: str, below: str, share: float = COVERED) -> float:
        ratio = [
            row[above][kept] / np.maximum(row[below][kept], ROUNDING)
            for row, kept in zip(rows, chosen)
        ]
        return float(np.quantile(np.concatenate(ratio), share))

    nonlinear = bool(np.any(rows[0]["gradient"] > 0))
    screen = quantile("first", "gradient", SCREENED) if nonlinear else 0.0
    for row in rows:
        row["floor"] = np.sqrt(
            row["members"] ** 2 + row["cubic"] ** 2 + (screen * row["series"]) ** 2
        )
    floor = quantile("true", "floor")
    factors = Factors(
        left=max(quantile("gone", "left"), 1.0) if nonlinear else 1.0,
        floor=floor,
        screen=screen,
        typical=floor * quantile("members", "one"),
    )
    return replace(family, factors=factors, record=record)


def _measured(family: Members, samples: Samples, wavelength: np.ndarray) -> dict[str, np.ndarray]:
    """What is computed of each sample and what is true, as fractions, shape [S] each."""
    placed = PlacedMembers(family, samples.points)
    inside, spacing = samples.interior, samples.spacing
    rows: list[dict[str, Any]] = []
    for b, truth in zip(samples.loads, samples.u):
        load = placed.load(b)
        u = np.where(inside[:, None], 0.0, truth)
        u[inside] = placed.inverse(load - placed.straight(u), 3e-3)
        first = u.copy()
        left = start = placed.correction(load, u)
        for _ in range(MOST if placed.nonlinear else 0):
            u[inside] += left
            left = placed.correction(load, u)
        size = float(np.linalg.norm(truth[inside]))
        fields = placed.doubts(u, left, first)

        def norm(field: np.ndarray, size: float = size) -> float:
            return float(np.linalg.norm(field)) / size

        cubic, series = map(norm, fields.strain) if fields.strain else (0.0, 0.0)
        row: dict[str, Any] = {"left": norm(start), "gone": norm((u - first)[inside])}
        row |= {"true": norm((u - truth)[inside]), "first": norm((first - truth)[inside])}
        row["members"] = np.hypot(norm(fields.waves), norm(fields.data)) / np.sqrt(2)
        row |= {"cubic": cubic, "series": series, "one": 1.0}
        row["gradient"] = placed.gradient(u) if placed.nonlinear else 0.0
        if spacing > 0:
            row["shares"] = shares = placed.spectrum(u, wavelength)
            mean = (shares @ np.log(wavelength)) / max(float(shares.sum()), ROUNDING)
            row["length"] = np.exp(mean)
        else:
            row |= {"shares": np.zeros(len(wavelength)), "length": np.inf}
        rows.append(row)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
