"""Ensembles: members learned from one data set, and fields of their likely errors (Q1–Q6)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import scipy.fft
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import lstsq, norm, qr
from scipy.ndimage import distance_transform_edt

from warp_peri.core.elastic import symmetric_part
from warp_peri.core.record import FieldUnits, OnLinear
from warp_peri.core.stencil import Grid, grid_of
from warp_peri.errors import Arrays, InputError, Rows, Values, hold, warn
from warp_peri.fitting.regression import check_alike
from warp_peri.fitting.result import Fit
from warp_peri.points.arguments import (
    ArrayMap,
    NotNegative,
    checked,
    is_number,
    offered,
    typed,
    within,
)
from warp_peri.points.dataset import sets_of
from warp_peri.points.families import largest_strain
from warp_peri.points.points import PointsLike, Samples, check_lattice, nodes_of
from warp_peri.protocols import placed

SEEN = 0.5
"""Samples' worth of a wavelength from which its error counts as known."""
KNOTS = 2.0 * 2.0 ** (np.arange(12) / 2)
"""Wavelengths in spacings between which a record is interpolated."""
ROUGH = 0.03
"""Relative residual of the solves that give errors, not answers. Conjugate gradients grow towards
their answer: at 0.1 an error came out up to 8 % too small, at 0.03 up to 2 %."""
PULLED = 2.0
"""What members say otherwise is made larger or smaller by their record by so much at most."""
BEYOND = 2.75
"""What is beyond the square of the strain may be, over what its orders go on to: no data have it.
Chosen on 150 problems with atoms for truth (commit f35114cb)."""
HALF_PERIOD = 30.0
"""Degrees between the directions of a crystal that differ most in their third-order constants."""
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
Measure = ArrayMap
"""Of a displacement on all nodes, [N, d] → numbers."""


@dataclass(frozen=True)
class ErrorSpectrum:
    """Relative error [K] of a material's solutions by wavelength [length], growing, [K].

    Its square is linear in log wavelength; below the `shortest` that samples held enough of, it is
    unknown, and the largest known error stands for it.
    """

    wavelength: Annotated[ndarray, FieldUnits(length=1)]
    error: ndarray
    shortest: Annotated[float, FieldUnits(length=1)] = 0.0

    def __post_init__(self) -> None:
        for name in ("wavelength", "error"):
            hold(self, **{name: checked(name, getattr(self, name), float, ("K",))})
        hold(self, shortest=float(checked("shortest", self.shortest, float, ())))
        rising = np.size(self.wavelength) and (np.diff(self.wavelength, prepend=0.0) > 0).all()
        if not (rising and self.error.shape == self.wavelength.shape and (self.error >= 0).all()):
            raise InputError("record: expected wavelengths > 0 that grow, an error ≥ 0 of each")

    def of(self, shares: ndarray) -> float:
        """Relative error of a field with these shares by wavelength."""
        return float(np.sqrt(shares @ self.error**2))

    def unseen(self, shares: ndarray) -> float:
        """Share of a field with wavelengths shorter than all that samples held."""
        return float(shares[self.wavelength < self.shortest * (1 - 1e-9)].sum())


def spectrum_of(points: PointsLike, wavelength: ndarray) -> Measure:
    """Function from lattice fields [N, d], less affine parts, to the shares of their squares by
    wavelength [length], growing, [K]."""
    steps, count = points.lattice.steps, len(wavelength)
    shape = tuple(int(n) for n in steps.max(axis=0) + 1)
    place = np.ravel_multi_index(tuple(steps.T), shape)
    there, padded = np.zeros(np.add(shape, 2), bool), tuple(steps.T + 1)
    there[padded] = True
    depth = distance_transform_edt(there)[padded]
    window = np.sin(np.pi / 2 * depth / depth.max())[:, None] ** 2
    affine = qr(np.column_stack([np.ones(len(steps)), steps]))[0]
    wide = [scipy.fft.next_fast_len(2 * n, real=True) for n in shape]
    lines = [np.fft.fftfreq(n, points.spacing) for n in wide[:-1]]
    lines.append(np.fft.rfftfreq(wide[-1], points.spacing))
    length = 1 / np.maximum(norm(np.meshgrid(*lines, indexing="ij"), axis=0), 1e-300)
    twice = np.full(len(lines[-1]), 2.0)  # of ±k one is not computed
    twice[[0] if wide[-1] % 2 else [0, -1]] = 1.0
    knot = np.interp(np.log(length), np.log(wavelength), np.arange(count)).ravel()
    low = np.minimum(knot.astype(int), count - 2)
    upper, whole = knot - low, np.broadcast_to(twice / np.prod(wide), length.shape).ravel()
    values = np.concatenate([whole * (1 - upper), whole * upper])
    at = np.concatenate([low, low + 1]), np.tile(np.arange(low.size), 2)
    by_knot = sp.csr_array((values, at), (count, low.size))

    def shares(u: ndarray) -> ndarray:
        u = u / max(np.abs(u).max(), 1e-300)
        left = (u - affine @ (affine.T @ u)) * window
        field = np.zeros((u.shape[1], np.prod(shape)), np.float32)
        field[:, place] = left.T
        wave = scipy.fft.rfftn(field.reshape(-1, *shape), wide, axes=range(1, 1 + len(shape)))
        found = by_knot @ (wave.real**2 + wave.imag**2).sum(axis=0).ravel()
        size = ((u * window) ** 2).sum()
        return np.asarray(found / size if size > 0 else found)

    return shares


def recorded(wavelength: ndarray, rows: ndarray, errors: ndarray) -> ErrorSpectrum:
    """Make the error spectrum from samples' errors [S] and shares [S, K] of wavelengths [K]."""
    there = rows.sum(axis=0)
    error = np.sqrt((rows * errors[:, None] ** 2).sum(axis=0) / np.maximum(there, 1e-300))
    enough = there >= min(SEEN, there.max())
    first = np.argmax(enough)
    error[:first] = error[first:][enough[first:]].max()
    return ErrorSpectrum(wavelength, error, float(wavelength[first]))


class EnsembleOperator:
    """Members of an ensemble on points, a lattice unless the rich one is linear; options of `on`.
    `loads` is the number of loads to come, by which a factorisation is chosen."""

    loads = 1

    def __init__(self, family: EnsembleMaterial, points: PointsLike, **options: Any) -> None:
        self.family, self.points, self.options = family, nodes_of(points), options
        self.rich = self._on(family.rich if self.points.spacing else family.linear, self.points)
        self.nonlinear = hasattr(self.rich, "straight")

    def _on(self, material: Any, points: Any) -> Any:
        return placed(material, points, verb="predict", has="straight", **self.options)

    def straight(self, u: ndarray) -> ndarray:
        """Force of the rich member's linear part at u."""
        return np.asarray(getattr(self.rich, "straight", self.rich)(u))

    @cached_property
    def others(self) -> tuple[Any, ...]:
        """Operators of the second member's linear part and of the halves, made on first use."""
        second, halves = self.family.second, self.family.halves
        rich = halves if self.nonlinear else tuple(getattr(m, "linear", m) for m in halves)
        poor, one, other = (self._on(each, self.points) for each in (second, *rich))
        return getattr(poor, "straight", poor), one, other

    @cached_property
    def inverse(self) -> Callable[[ndarray, float], ndarray]:
        """Inverse S = L⁻¹ of a load on the interior, to a relative residual."""
        return self.rich.inverse(self.loads)  # type: ignore[no-any-return]

    def gradient(self, u: ndarray) -> float:
        """Root mean square gradient |H| of u; of a linear member the largest bond strain."""
        if not self.nonlinear:
            return float(largest_strain(self.points, u))
        H, _ = self.rich.gradients(u)
        return float(np.sqrt(np.vdot(H, H) / (H.size / H.shape[-1] ** 2)))

    @cached_property
    def shares(self) -> Measure:
        """Shares of fields on these points by the recorded wavelengths."""
        record = self.family.record
        knots = self.points.spacing * KNOTS if record is None else record.wavelength
        return spectrum_of(self.points, knots)

    def recorded(self, u: ndarray) -> tuple[float | None, float]:
        """Recorded relative error of a field, or None, and its share of unrecorded short waves."""
        record = self.family.record
        if record is None or self.points.spacing == 0:
            return None, 0.0
        shares = self.shares(u)
        return record.of(shares), record.unseen(shares)

    @cached_property
    def turned(self) -> Any:
        """Rich member with the crystal at its other extreme; None where that is not in doubt."""
        if self.points.axis is not None or not getattr(self.rich.model, "q3", 0.0):
            return None
        return self._on(self.family.rich, replace(self.points, axis=HALF_PERIOD))

    def correction(self, load: ndarray, u: ndarray) -> ndarray:
        """Correction e = S (b − R u) of u by the rich member: its estimated error, [I, d] (Q1)."""
        return self.inverse(load - self.rich(u), ROUGH)

    @cached_property
    def grid(self) -> Grid | None:
        """Grid for second-order forces of a linear member; None where none are known or defined."""
        if not (self.family.quadratic and self.points.spacing):
            return None
        try:
            return grid_of(self.points, 2 * np.eye(self.points.dimension, dtype=int))
        except InputError:
            return None

    def bent(self, u: ndarray) -> ndarray | None:
        """Displacement by the force's nonlinearity at u, [I, d] (Q3); None without `grid`."""
        if self.nonlinear:
            return self.inverse(self.rich(u) - self.straight(u), ROUGH)
        if self.grid is None:
            return None
        forces = second_order(self.grid, self.points.spacing, u[None])
        return self.inverse(np.tensordot(self.family.quadratic, forces, 1)[0], ROUGH)

    def series(self, gradient: float, slowed: float = 0.0) -> float:
        """Likely size of the orders beyond the rich member's, over its nonlinear part (Q3).
        `slowed` is the second correction over the first, where both are known."""
        if not self.nonlinear:
            return 1.0
        return max(BEYOND * self.family.factors.screen * gradient, slowed)

    def doubts(
        self, u: ndarray, left: ndarray, told: float | None = None, slowed: float = 0.0
    ) -> Arrays:
        """Error fields of u [length], shape [I, d], by origin (Q1–Q3); `slowed` as of `series`.

        "left": its remaining correction; "waves": by the second member; "data": by the halves, both
        half way in logarithms to the recorded error `told` (Q6); "strain": by higher orders of the
        force, of a linear member the second; "axis": by the crystal at its other extreme; "moduli":
        by their standard error.
        """
        second, *halves = self.others
        waves = self.inverse(self.straight(u) - second(u), ROUGH)
        data = self.inverse(halves[0](u) - halves[1](u), ROUGH) / np.sqrt(2)
        size = float(norm(u[self.points.interior])) or 1.0
        pull = pulled(spread(waves, data) / size, told)
        fields = {"left": left, "waves": pull * waves, "data": pull * data}
        if (strain := self.bent(u)) is not None:
            fields["strain"] = self.series(self.gradient(u), slowed) * strain
        if self.turned is not None:
            fields["axis"] = self.inverse(self.rich(u) - self.turned(u), ROUGH)
        if unsure := self.family.moduli_error:
            fields["moduli"] = unsure * u[self.points.interior]
        return fields


def quadratic_stresses(H: ndarray) -> ndarray:
    """Isotropic stresses, 7 in all, that are quadratic in H = ∇u [..., d, d], [7, ..., d, d]."""
    E, one = symmetric_part(H), np.eye(H.shape[-1])
    W, trace = H - E, np.linalg.trace(E)[..., None, None]
    squares = ((F * F).sum(axis=(-1, -2))[..., None, None] * one for F in (E, W))
    mixed = H @ H.mT, E @ W - W @ E
    return np.stack([trace**2 * one, *squares, trace * E, E @ E, *mixed])


def second_order(grid: Grid, spacing: float, u: ndarray) -> ndarray:
    """Forces of the quadratic stresses of u [S, N, d], by lattice differences, [7, S, I, d]."""
    axes = tuple(range(2, 2 + grid.dimension))

    def slopes(planes: ndarray) -> ndarray:
        return np.stack(np.gradient(planes, spacing, axis=axes), axis=-1)

    def force(P: ndarray) -> ndarray:
        bent = [slopes(np.moveaxis(P[..., j], -1, 1))[..., j] for j in range(grid.dimension)]
        return grid.gather(grid.within(np.sum(bent, axis=0)))

    H = np.moveaxis(slopes(grid.scatter(u)), 1, -2)
    return np.array([force(P) for P in quadratic_stresses(H)])


def spread(waves: ndarray, data: ndarray) -> float:
    """Root mean square size of the two fields in which other members differ."""
    return float(np.hypot(norm(waves), norm(data)) / np.sqrt(2))


def pulled(members: float, told: float | None) -> float:
    """Factor from the members' error towards the recorded one, of the same (Q6)."""
    if told is None or not members > 0:
        return 1.0
    return float(np.clip(np.sqrt(told / members), 1 / PULLED, PULLED))


@typed
@dataclass(frozen=True)
class CalibrationFactors:
    """Calibration factors that turn error fields into likely errors (Q4).

    Of the correction `left`; `floor` of what waves, data and strain may miss; `screen` of the mean
    gradient, for the error of the linear solution.
    """

    left: NotNegative = 1.2
    floor: NotNegative = 1.48
    screen: NotNegative = 1.42


def kelvin(samples: Any) -> Any:
    """Temperatures [K] that samples state, [S], or None; InputError for what is none."""
    given = getattr(samples, "arrays", {}).get("temperature")
    if given is not None and (given := checked("temperature", given)).min(initial=0) < 0:
        raise InputError(f"temperature: expected values ≥ 0 K, got {given.min():g}")
    return given


@dataclass(frozen=True, eq=False)
class EnsembleMaterial(OnLinear, format="warp_peri.family", version=2):
    """Material with alternatives that show its errors, learned by `fit(samples, Ensemble(…))`.

    It solves, moves and is placed on points as its rich member; `predict` uses all.

    Attributes:
        rich: the best material of the data, linear or of third order.
        second: a poorer one; the difference is the error of short waves.
        halves: the rich material from two halves of the samples; they differ by the data's error.
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
    provenance: Values = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for one in (self.rich, self.second, *self.halves):
            if not hasattr(one, "on"):
                raise InputError(f"member: expected a material, got {one!r:.40}")
            if (one.units, one.dimension) != (self.rich.units, self.rich.dimension):
                raise InputError("member: expected units and dimension of the rich one, got others")
        if (self.temperature or 0) < 0:
            raise InputError(f"temperature: expected a number ≥ 0 K, got {self.temperature:g}")
        if (count := len(self.quadratic)) not in (0, 7):
            raise InputError(f"quadratic: expected 7 constants or none, got {count}")

    @property
    def linear(self) -> Any:
        """Linear part of the rich member."""
        return getattr(self.rich, "linear", self.rich)

    @property
    def moduli_error(self) -> float:
        """Relative standard error of the rich member's moduli, by its record; 0 without."""
        found = getattr(self.linear, "provenance", {}).get("moduli_error", 0.0)
        if not (is_number(found) and found >= 0):
            raise InputError(f"moduli_error: expected a number ≥ 0, got {found!r:.50}")
        return float(found)

    def on(self, points: PointsLike, **options: Any) -> Any:
        """Operator of the rich member on points."""
        return placed(self.rich, points, verb="on", **options)

    def ensemble_on(self, points: PointsLike, **options: Any) -> EnsembleOperator:
        """Operators of all members on points; options of `on`."""
        return EnsembleOperator(self, points, **options)

    def rows(self) -> Rows:
        names = [type(one).__name__ for one in (self.rich, self.second)]
        return [
            ("rich, second", ", ".join(names)),
            ("strain seen", f"{self.strain:.2%}"),
            ("factors", f"{self.factors.left:.2f} left, {self.factors.floor:.2f} floor"),
            *(self.rich.rows() if hasattr(self.rich, "rows") else []),
        ]


@typed
@dataclass(frozen=True)
class Ensemble:
    """Ensemble to learn: `rich`, the best material that the data bear, and a poorer `second`.

    They are LPS(…), ThirdOrder(…) or Crystal(…); the second, as good on long waves, is by default
    the rich one with a shorter horizon.
    """

    rich: Any
    second: Any = None

    def learn(
        self, samples: Any, *, validation: Samples | None = None, progress: bool | None = None
    ) -> Fit:
        """Learn the ensemble from at least four samples with loads; certificate and history are
        those of its rich member's fit. `validation`, on the same kind of nodes, calibrates too.
        Warns of samples at several temperatures, of which the material says the mean."""
        sets = sets_of(samples)
        if len(sets) != 1 or len(sets[0]) < 4:
            raise InputError("samples: expected one set of at least four samples for an ensemble")
        samples = sets[0]
        learn = offered(self.rich, "learn", "fit", "a model as the rich member")
        second = poorer(self.rich) if self.second is None else self.second
        learn_other = offered(second, "learn", "fit", "a model as the second member")
        known = {"samples": samples} | ({} if validation is None else {"validation": validation})
        stated = {name: kelvin(one) for name, one in known.items()}
        mean = None if stated["samples"] is None else float(stated["samples"].mean())
        check_sets((self.rich, second), known)
        for name, there in stated.items():
            if not (there is None or mean is None or np.allclose(there, mean)):
                got = f"{there.min():g} to {there.max():g} K"
                warn(f"temperature: the ensemble says {mean:g} K alone, {name} are at {got}")
        fit = learn(samples, progress=progress)
        other = learn_other(samples, progress=progress).material
        odd, even = (learn(samples[n::2], progress=progress).material for n in (0, 1))
        strain, halves = largest_strain(samples.points, samples.u), (odd, even)
        family = EnsembleMaterial(fit.material, other, halves, strain=strain, temperature=mean)
        return Fit(calibrated(family, samples, validation), fit.certificate, {}, fit.history)


def check_sets(laws: tuple[Any, Any], sets: dict[str, Samples]) -> None:
    """Raise InputError, before any fit, for what members' fits or their calibration would refuse of
    samples and validation."""
    samples = sets["samples"]
    check_alike([*sets.values()])
    for name, one in sets.items():
        within(name, check_lattice, one)
        if not (len(one.loads) and one.u[:, one.interior].any()):
            raise InputError(f"{name}: expected some that are displaced inside, got none")
        for law in laws:
            if check := getattr(law, "check_samples", None):  # of a law that has one
                within(name, check, one, None if one is samples else samples.spacing)
    for half in (samples[::2], samples[1::2]):
        if hasattr(laws[0], "check_samples") and not half.loads[:, half.interior].any():
            raise InputError("samples: expected loads on each half, every second one, got none")


def poorer(law: Any) -> Any:
    """The learning settings with a shorter horizon and, of polynomials, fewer of them."""
    inner = getattr(law, "linear", law)
    if not hasattr(inner, "horizon"):
        raise InputError("second: expected a model, as none with a shorter horizon is known")
    changes = {"horizon": SHRUNK * inner.horizon}
    degree = getattr(getattr(inner, "kernel", None), "degree", None)
    if degree is not None:
        changes["kernel"] = replace(inner.kernel, degree=max(1, round(POORER * degree)))
    changed = replace(inner, **changes)
    return replace(law, linear=changed) if hasattr(law, "linear") else changed


def calibrated(
    family: EnsembleMaterial, samples: Samples, validation: Samples | None
) -> EnsembleMaterial:
    """Calibrate an ensemble: its record by wavelength, and factors by quantiles of true errors."""
    nonlinear = family.linear is not family.rich
    bare = replace(family, factors=CalibrationFactors(1.0, 1.0, 1.0), record=None)
    if not nonlinear:
        bare = replace(bare, quadratic=quadratic(bare, samples))
    found = [*_measured(bare, samples)]
    if validation is not None:
        found += _measured(bare, validation)
    rows = {name: np.array([row[name] for row in found]) for name in found[0]}
    record = recorded(samples.spacing * KNOTS, rows["shares"], rows["true"])
    told = np.array([record.of(one) for one in rows["shares"]])
    members = rows["members"] * [pulled(*pair) for pair in zip(rows["members"], told)]

    def quantile(above: ndarray, below: ndarray, share: float = COVERED) -> float:
        return float(np.quantile(above / np.maximum(below, ROUNDING), share))

    bends = nonlinear and np.any(rows["gradient"] > 0)
    screen = quantile(rows["gone"], rows["gradient"]) if bends else 0.0
    floor = np.hypot(members, (screen if nonlinear else 1.0) * rows["series"])
    least, known = 1.0, quantile(rows["true"], floor)
    if not nonlinear:  # which may have taken up some of what it cannot hold
        least, known = SAFELY, SAFELY * max(known, 1.0)
    left = max(quantile(rows["gone"], rows["left"], NEARLY), 1.0) if bends else least
    factors = CalibrationFactors(left=left, floor=known, screen=screen)
    return replace(bare, factors=factors, record=record)


DETERMINED = 1e-4
"""Singular value, over the largest, of constants that data determine; of less rounding does."""


def quadratic(family: EnsembleMaterial, samples: Samples) -> tuple[float, ...]:
    """Fit the constants of `second_order` to residuals of the half that has not seen a sample."""
    placed, points = EnsembleOperator(family, samples.points), samples.points
    left = [
        placed.rich.rhs(b) - placed.others[2 - n % 2](u)  # even ones are the first half's
        for n, (b, u) in enumerate(zip(samples.loads, samples.u))
    ]
    grid = grid_of(points, 2 * np.eye(points.dimension, dtype=int))
    rows = second_order(grid, points.spacing, samples.u)
    A = rows.reshape(len(rows), -1).T
    return tuple(lstsq(A, np.ravel(left), rcond=DETERMINED)[0].tolist())


def _measured(family: EnsembleMaterial, samples: Samples) -> Iterator[Values]:
    """Iterate over estimated and true relative errors of the samples that are not at rest."""
    placed = EnsembleOperator(family, samples.points)
    inside = samples.interior
    for b, truth in zip(samples.loads, samples.u):
        load, size = placed.rich.rhs(b), norm(truth[inside])
        if not size:  # at rest, where nothing is relative
            continue
        u = np.where(inside[:, None], 0.0, truth)
        u[inside] = placed.inverse(load - placed.straight(u), 3e-3)
        first = u.copy()
        left = start = placed.correction(load, u)
        for _ in range(MOST if placed.nonlinear else 0):
            u[inside] += left
            left = placed.correction(load, u)
        fields = placed.doubts(u, left)
        yield {
            "left": norm(start) / size,
            "gone": norm((u - first)[inside]) / size,
            "true": norm((u - truth)[inside]) / size,
            "series": norm(fields["strain"]) / size if "strain" in fields else 0.0,
            "members": spread(fields["waves"], fields["data"]) / size,
            "gradient": placed.gradient(u),
            "shares": placed.shares(u),
        }
