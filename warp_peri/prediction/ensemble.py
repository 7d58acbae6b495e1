"""Ensembles: members learned from one data set, and how large their doubts are (Q4–Q6)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from warp_peri.core.record import FieldUnits, OnLinear
from warp_peri.core.stencil import grid_of
from warp_peri.errors import InputError
from warp_peri.points.arguments import NotNegative, typed
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import largest_strain
from warp_peri.points.points import PointsLike, Samples
from warp_peri.prediction.members import (
    KNOTS,
    EnsembleOperator,
    ErrorSpectrum,
    norm,
    pulled,
    recorded,
    second_order,
    spread,
)
from warp_peri.protocols import offered

MOST = 8
"""Corrections of an answer at most."""
SAFELY = 1.2
"""Of a linear member, which the forces of second order know of isotropic stresses alone."""
COVERED, NEARLY = 0.9, 0.95
"""Shares of the samples that the factors are set to cover; that of what is left to correct, which
varies little, is set higher."""
SHRUNK, POORER = 0.8, 2 / 3
"""Horizon and degree of the second member over those of the rich one."""
ROUNDING = 1e-12


@typed
@dataclass(frozen=True)
class CalibrationFactors:
    """Calibration: by how much what can be computed is multiplied, so that it is an error (Q4).

    Attributes:
        left: of the correction that is left.
        floor: of what waves, data and strain may miss.
        screen: of the mean gradient, for what the linear answer misses.
    """

    left: NotNegative = 1.2
    floor: NotNegative = 1.48
    screen: NotNegative = 1.42


@dataclass(frozen=True, eq=False, repr=False)
class EnsembleMaterial(OnLinear, format="warp_peri.family", version=2):
    """What `fit(samples, prediction.Ensemble(…))` learns: a material with its doubts.

    It solves, moves and is placed on points as its rich member; `predict` uses all.

    Attributes:
        rich: the best law of the data, linear or of third order.
        second: a poorer one; how they differ is what short waves may miss.
        halves: the rich law from two halves of the samples; how they differ is what data may miss.
        record: error of the rich member by wavelength; None of scattered samples.
        factors: calibration.
        strain: largest strain between neighbouring nodes in the samples.
        temperature: [K] of the samples, where they state it.
        quadratic: of a linear rich member the constants [stress] of `quadratic_stresses`.
    """

    rich: Any
    second: Any
    halves: tuple[Any, Any]
    record: ErrorSpectrum | None = None
    factors: CalibrationFactors = CalibrationFactors()
    strain: float = 0.0
    temperature: float | None = None
    quadratic: Annotated[tuple[float, ...], FieldUnits(stress=1, omit=True)] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for one in (self.rich, self.second, *self.halves):
            if not hasattr(one, "on"):
                raise InputError(f"member: expected a material, got {one!r:.40}")

    @property
    def horizon(self) -> float:
        """δ [length] of the rich member."""
        return float(self.rich.horizon)

    @property
    def linear(self) -> Any:
        """The linear part of the rich member."""
        return getattr(self.rich, "linear", self.rich)

    @property
    def moduli_error(self) -> float:
        """Relative standard error of the rich member's moduli, by its record; 0 without."""
        return float(getattr(self.linear, "provenance", {}).get("moduli_error", 0.0))

    def on(self, points: PointsLike, **options: Any) -> Any:
        """The rich member on points."""
        return self.rich.on(points, **options)

    def ensemble_on(self, points: PointsLike, **options: Any) -> EnsembleOperator:
        """All members on points, with what they do not know there; options of `on`."""
        return EnsembleOperator(self, points, **options)

    def rows(self) -> list[tuple[str, str]]:
        names = [type(one).__name__ for one in (self.rich, self.second)]
        rows = [("rich, second", ", ".join(names)), ("strain seen", f"{self.strain:.2%}")]
        rows.append(("factors", f"{self.factors.left:.2f} left, {self.factors.floor:.2f} floor"))
        return rows + list(self.rich.rows() if hasattr(self.rich, "rows") else [])


@typed
@dataclass(frozen=True)
class Ensemble:
    """A family of laws of one material.

    Attributes:
        rich: the best law that the data bear: LPS(…), ThirdOrder(…), Crystal(…).
        second: a poorer law, as good on long waves; by default the rich one with a shorter horizon.
    """

    rich: Any
    second: Any = None

    def learn(
        self, samples: Any, *, validation: Samples | None = None, progress: bool | None = None
    ) -> EnsembleFit:
        """The ensemble, with the history and the certificate of the rich one's fit.

        Of at least four samples with loads; `validation` on the same kind of nodes calibrates too.
        """
        if isinstance(samples, Dataset):
            samples = samples.obvious("train")
        if not isinstance(samples, Samples) or len(samples) < 4:
            raise InputError("samples: expected one set of at least four samples for an ensemble")
        learn = offered(self.rich, "learn", "fit", "a model as the rich member")
        second = self.second or poorer(self.rich)
        fit = learn(samples, progress=progress)
        other = second.learn(samples, progress=progress).material
        odd, even = (learn(samples[n::2], progress=progress).material for n in (0, 1))
        kelvin = samples.arrays.get("temperature")
        family = EnsembleMaterial(
            fit.material,
            other,
            (odd, even),
            strain=largest_strain(samples.points, samples.u),
            temperature=None if kelvin is None else float(np.mean(kelvin)),
        )
        material = calibrated(family, samples, validation)
        certificate, history = (getattr(fit, n, None) for n in ("certificate", "history"))
        return EnsembleFit(material, certificate, history)


@dataclass(frozen=True)
class EnsembleFit:
    """A learned ensemble, with the certificate and the history of its rich member's fit."""

    material: EnsembleMaterial
    certificate: Any
    history: Any


def poorer(law: Any) -> Any:
    """The same law with a shorter horizon and, of polynomials, fewer of them."""
    inner = getattr(law, "linear", law)
    if not hasattr(inner, "horizon"):
        raise InputError("second: expected a model, as none with a shorter horizon is known")
    changes: dict[str, Any] = {"horizon": SHRUNK * inner.horizon}
    degree = getattr(getattr(inner, "kernel", None), "degree", None)
    if degree is not None:
        changes["kernel"] = replace(inner.kernel, degree=max(1, round(POORER * degree)))
    changed = replace(inner, **changes)
    return replace(law, linear=changed) if hasattr(law, "linear") else changed


def calibrated(
    family: EnsembleMaterial, samples: Samples, validation: Samples | None
) -> EnsembleMaterial:
    """The family with its record by wavelength, and quantiles of truth over answers as factors."""
    nonlinear = family.linear is not family.rich
    bare = replace(family, factors=CalibrationFactors(1.0, 1.0, 1.0), record=None)
    if not nonlinear:
        bare = replace(bare, quadratic=quadratic(bare, samples))
    sets = [samples] if validation is None else [samples, validation]
    found = [row for one in sets for row in _measured(bare, one)]
    rows = {name: np.array([row[name] for row in found]) for name in found[0]}
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
    factors = CalibrationFactors(left=left, floor=known, screen=screen)
    return replace(bare, factors=factors, record=record)


def quadratic(family: EnsembleMaterial, samples: Samples) -> tuple[float, ...]:
    """Constants of `second_order`, by what the half that has not seen a sample leaves of it."""
    placed, points = EnsembleOperator(family, samples.points), samples.points
    left = [
        placed.rich.rhs(b) - placed.others[2 - n % 2](u)  # even ones are the first half's
        for n, (b, u) in enumerate(zip(samples.loads, samples.u))
    ]
    grid = grid_of(points, 2 * np.eye(points.dimension, dtype=int))
    rows = second_order(grid, points.spacing, samples.u)
    return tuple(np.linalg.lstsq(rows.reshape(len(rows), -1).T, np.ravel(left))[0].tolist())


def _measured(family: EnsembleMaterial, samples: Samples) -> list[dict[str, Any]]:
    """What is computed of each sample and what is true, as fractions."""
    placed = EnsembleOperator(family, samples.points)
    inside = samples.interior
    rows = []
    for b, truth in zip(samples.loads, samples.u):
        load, size = placed.rich.rhs(b), norm(truth[inside])
        u = np.where(inside[:, None], 0.0, truth)
        u[inside] = placed.inverse(load - placed.straight(u), 3e-3)
        first = u.copy()
        left = start = placed.correction(load, u)
        for _ in range(MOST if placed.nonlinear else 0):
            u[inside] += left
            left = placed.correction(load, u)
        fields = placed.doubts(u, left).fields
        rows.append(
            {
                "left": norm(start) / size,
                "gone": norm((u - first)[inside]) / size,
                "true": norm((u - truth)[inside]) / size,
                "series": norm(fields["strain"]) / size if "strain" in fields else 0.0,
                "members": spread(fields["waves"], fields["data"]) / size,
                "gradient": placed.gradient(u),
                "shares": placed.spectrum.shares(u),
            }
        )
    return rows
