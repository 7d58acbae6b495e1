"""Learning a family: its members from one data set, and how large their doubts are (Q4–Q6)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_peri.contract import offered
from warp_peri.errors import InputError, warn
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import largest_strain
from warp_peri.points.samples import Samples
from warp_peri.prediction.placed import (
    HALF_PERIOD,
    KNOTS,
    Factors,
    Members,
    PlacedMembers,
    pulled,
    recorded,
    second_order,
    spread,
)
from warp_peri.prediction.predict import MOST

SAFELY = 1.2
"""Of a linear member, which the forces of second order know of isotropic stresses alone."""
COVERED, NEARLY = 0.9, 0.95
"""Shares of the samples that the factors are set to cover; that of what is left to correct, which
varies little, is set higher."""
SHRUNK, POORER = 0.8, 2 / 3
"""Horizon and degree of the second member over those of the rich one."""
ROUNDING = 1e-12
TURNED, SURE = 2.0, 3.0
"""Degrees off a stated axis, and standard errors, from which the data contradict it."""


@dataclass(frozen=True)
class Family:
    """A family of laws of one material.

    Attributes:
        rich: the best law that the data bear: LPS(…), ThirdOrder(…), Micromodulus(…).
        second: a poorer law, as good on long waves; by default the rich one with a shorter horizon,
            or what its own `poorer()` says.
    """

    rich: Any
    second: Any = None

    def learn(
        self, samples: Any, *, validation: Samples | None = None, progress: bool | None = None
    ) -> FamilyFit:
        """The fit.

        Args:
            samples: with loads, at least four; of a Dataset `train`, or its only set.
            validation: samples on the same kind of nodes, not learned from, that calibrate too.
            progress: as for the laws.

        Raises InputError for samples that cannot be halved, and whatever the laws refuse.
        """
        if isinstance(samples, Dataset):
            samples = samples.sets["train"] if "train" in samples.sets else samples.obvious()
        if not isinstance(samples, Samples) or len(samples) < 4:
            raise InputError("samples: expected one set of at least four samples for an ensemble")
        learn = offered(self.rich, "learn", "fit", "a model as the rich member")
        second = self.second or poorer(self.rich)
        fits = {"rich": learn(samples, progress=progress)}
        fits["second"] = second.learn(samples, progress=progress)
        halves = [learn(samples[n::2], progress=progress) for n in (0, 1)]
        strain = largest_strain(samples.points, samples.u)
        kelvin = samples.arrays.get("temperature")
        temperature = None if kelvin is None else float(np.mean(kelvin))
        family = Members(
            fits["rich"].material,
            fits["second"].material,
            (halves[0].material, halves[1].material),
            strain=strain,
            temperature=temperature,
            axis_off=off_axis(fits["rich"].material, samples),
        )
        family = calibrated(family, samples, validation)
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


def poorer(law: Any) -> Any:
    """The same law with a shorter horizon and, of polynomials, fewer of them; or as it says."""
    if hasattr(law, "poorer"):
        return law.poorer()
    inner = getattr(law, "linear", law)
    if not hasattr(inner, "horizon"):
        raise InputError("second: expected a model, as none with a shorter horizon is known")
    changes: dict[str, Any] = {"horizon": SHRUNK * inner.horizon}
    degree = getattr(getattr(inner, "kernel", None), "degree", None)
    if degree is not None:
        changes["kernel"] = replace(inner.kernel, degree=max(1, round(POORER * degree)))
    changed = replace(inner, **changes)
    return replace(law, linear=changed) if hasattr(law, "linear") else changed


def calibrated(family: Members, samples: Samples, validation: Samples | None) -> Members:
    """The family with its factors and its record by wavelength, from answers whose truth is known.

    The factors are quantiles of what was true over what was computed.
    """
    nonlinear = family.linear is not family.rich
    bare = replace(family, factors=Factors(1.0, 1.0, 1.0), record=None)
    if not nonlinear:
        bare = replace(bare, quadratic=quadratic(bare, samples))
    sets = [samples] if validation is None else [samples, validation]
    found = [_measured(bare, one) for one in sets]
    rows = {name: np.concatenate([one[name] for one in found]) for name in found[0]}
    record = recorded(samples.spacing * KNOTS, rows["shares"], rows["true"])
    told = np.array([record.of(one) for one in rows["shares"]])
    members = rows["members"] * [pulled(*pair) for pair in zip(rows["members"], told)]

    def quantile(above: np.ndarray, below: np.ndarray, share: float = COVERED) -> float:
        return float(np.quantile(above / np.maximum(below, ROUNDING), share))

    bends = nonlinear and bool(np.any(rows["gradient"] > 0))
    screen = quantile(rows["gone"], rows["gradient"]) if bends else 0.0
    floor = np.hypot(members, (screen if nonlinear else 1.0) * rows["series"])
    least, known = 1.0, quantile(rows["true"], floor)
    if not nonlinear:  # which may have taken up some of what it cannot hold
        least, known = SAFELY, SAFELY * max(known, 1.0)
    left = max(quantile(rows["gone"], rows["left"], NEARLY), 1.0) if bends else least
    factors = Factors(left=left, floor=known, screen=screen)
    return replace(bare, factors=factors, record=record)


def off_axis(rich: Any, samples: Samples) -> float:
    """Degrees from the axis that samples state to the one that their loads ask for, or 0 (N13).

    The cubic constant's force turns with six times the axis: what it is at the stated one and a
    quarter of a period further span all. Warns of two degrees and more that no three standard
    errors explain.
    """
    points, inside = samples.points, samples.interior
    if points.axis is None or not getattr(rich, "q3", 0.0):
        return 0.0
    here, quarter, half = (
        rich.on(replace(points, axis=points.axis + turn), allow_uncertified=True)(samples.u)
        for turn in (0.0, HALF_PERIOD / 2, HALF_PERIOD)
    )
    even = (here + half) / 2
    rows = np.stack([here - even, quarter - even]).reshape(2, len(samples), -1)
    left = (samples.loads[:, inside] - even).reshape(len(samples), -1)
    G, h = np.einsum("asn,bsn->sab", rows, rows), np.einsum("asn,sn->sa", rows, left)
    back = np.linalg.pinv(G.sum(axis=0))
    found = back @ h.sum(axis=0)
    spread = (h - G @ found) @ back  # each sample's own say
    turn = float(np.degrees(np.arctan2(found[1], found[0]))) * HALF_PERIOD / 180
    if abs(turn) < TURNED or abs(found[1]) < SURE * np.sqrt((spread[:, 1] ** 2).sum()):
        return 0.0
    warn(
        f"axis: {points.axis:g}° is stated, and the data are explained best at "
        f"{points.axis + turn:.1f}°; the difference is a part of every error"
    )
    return turn


def quadratic(family: Members, samples: Samples) -> tuple[float, ...]:
    """Constants of forces of second order in the strain, of what a linear rich member misses.

    They are fitted to what the half that has not seen a sample leaves of its load: the member
    itself has taken up some of it.
    """
    placed = PlacedMembers(family, samples.points)
    left = [
        placed.load(b) - placed.others[2 - n % 2](u)  # even ones are the first half's
        for n, (b, u) in enumerate(zip(samples.loads, samples.u))
    ]
    rows = second_order(samples.points, samples.u)
    return tuple(np.linalg.lstsq(rows.reshape(len(rows), -1).T, np.ravel(left))[0].tolist())


def _measured(family: Members, samples: Samples) -> dict[str, np.ndarray]:
    """What is computed of each sample and what is true, as fractions, shape [S] each."""
    placed = PlacedMembers(family, samples.points)
    inside = samples.interior
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
        fields = placed.doubts(u, left)

        def norm(field: np.ndarray, size: float = size) -> float:
            return float(np.linalg.norm(field)) / size

        row: dict[str, Any] = {"left": norm(start), "gone": norm((u - first)[inside])}
        row["true"] = norm((u - truth)[inside])
        row["series"] = 0.0 if fields.strain is None else norm(fields.strain)
        row["members"] = spread(placed.norm(fields.waves), placed.norm(fields.data)) / size
        row["gradient"] = placed.gradient(u)
        row["shares"] = placed.spectrum.shares(u)
        rows.append(row)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
