"""Answers of a family on points: members, their forces, the record of errors (theory, Q)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import scipy.fft
import scipy.sparse as sp
from scipy.ndimage import distance_transform_edt

from warp_peri.contract import placed, stencil_of, taken
from warp_peri.core.elastic import acoustic, elastic_from_brackets
from warp_peri.core.grid import grid_of
from warp_peri.core.record import Entry, OnLinear
from warp_peri.core.stencil import directions
from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number
from warp_peri.points.lattice import largest_strain, lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike, nodes_of

SEEN = 0.5
"""Samples' worth of a wavelength from which its error counts as known."""
KNOTS = 2.0 * 2.0 ** (np.arange(12) / 2)
"""Wavelengths in spacings between which a record is interpolated."""


@dataclass(frozen=True)
class ErrorSpectrum:
    """The relative error of a material's answers by wavelength.

    Attributes:
        wavelength: [length], growing, shape [K].
        error: a fraction, shape [K]; between the wavelengths its square is linear in their
            logarithms, and it is constant beyond them.
        shortest: wavelength that samples held enough of [length]; below it the largest error that
            is known stands for one that is not.
    """

    wavelength: Annotated[np.ndarray, Entry(length=1)]
    error: np.ndarray
    shortest: Annotated[float, Entry(length=1)] = 0.0

    def of(self, shares: np.ndarray) -> float:
        """The error of a field with those shares, relative to the field."""
        return float(np.sqrt(shares @ self.error**2))

    def unseen(self, shares: np.ndarray) -> float:
        """The share of a field that is shorter than all that samples held."""
        return float(shares[self.wavelength < self.shortest * (1 - 1e-9)].sum())

    def told(self, shares: np.ndarray) -> tuple[float, float]:
        """Both: the error, and the share that is not seen."""
        return self.of(shares), self.unseen(shares)


class Spectrum:
    """Shares of fields on a lattice by wavelength; what is affine in a field belongs to none.

    A field is taken to zero towards the edge of its nodes.

    Args:
        points: the lattice.
        wavelength: [length], growing, shape [K].
    """

    def __init__(self, points: PointsLike, wavelength: np.ndarray) -> None:
        grid, _ = lattice_steps(points)
        grid = grid - grid.min(axis=0)
        self.shape = tuple(int(n) for n in grid.max(axis=0) + 1)
        self.place = np.ravel_multi_index(tuple(grid.T), self.shape)
        there = np.zeros(self.shape, bool)
        there.flat[self.place] = True
        depth = distance_transform_edt(np.pad(there, 1))[(slice(1, -1),) * len(self.shape)]
        depth = depth.flat[self.place]
        self.window = np.sin(np.pi / 2 * depth / depth.max()) ** 2
        self.affine = np.linalg.qr(np.column_stack([np.ones(len(grid)), grid]))[0]
        self.wide = [scipy.fft.next_fast_len(2 * n, real=True) for n in self.shape]
        lines = [np.fft.fftfreq(n, points.spacing) for n in self.wide[:-1]]
        lines.append(np.fft.rfftfreq(self.wide[-1], points.spacing))
        waves = np.meshgrid(*lines, indexing="ij")
        length = 1 / np.maximum(np.linalg.norm(waves, axis=0), 1e-300)
        twice = np.full(len(lines[-1]), 2.0)  # of ±k one is not computed
        twice[[0] if self.wide[-1] % 2 else [0, -1]] = 1.0
        share, count = twice / np.prod(self.wide), len(wavelength)
        knot = np.interp(np.log(length), np.log(wavelength), np.arange(count)).ravel()
        low = np.minimum(knot.astype(int), count - 2)
        upper, whole = knot - low, np.broadcast_to(share, length.shape).ravel()
        values = np.concatenate([whole * (1 - upper), whole * upper])
        at = np.concatenate([low, low + 1]), np.tile(np.arange(low.size), 2)
        self.by_knot = sp.csr_array((values, at), (count, low.size))

    def shares(self, u: np.ndarray) -> np.ndarray:
        """Shares of the square of a field [N, d], shape [K]."""
        u = u / max(float(np.abs(u).max()), 1e-300)
        left = (u - self.affine @ (self.affine.T @ u)) * self.window[:, None]
        field = np.zeros((u.shape[1], int(np.prod(self.shape))), np.float32)
        field[:, self.place] = left.T
        axes = tuple(range(1, 1 + len(self.shape)))
        wave = scipy.fft.rfftn(field.reshape(-1, *self.shape), s=self.wide, axes=axes)
        power = (wave.real**2 + wave.imag**2).sum(axis=0).ravel()
        found = self.by_knot @ power
        size = float(((u * self.window[:, None]) ** 2).sum())
        return np.asarray(found / size if size > 0 else found)


def recorded(wavelength: np.ndarray, rows: np.ndarray, errors: np.ndarray) -> ErrorSpectrum:
    """The root mean square of the errors of samples, by what they have of a wavelength.

    Args:
        wavelength: [length], shape [K].
        rows: shares of the samples there, shape [S, K].
        errors: of their answers, fractions, shape [S].
    """
    there = rows.sum(axis=0)
    error = np.sqrt((rows * errors[:, None] ** 2).sum(axis=0) / np.maximum(there, 1e-300))
    first = int(np.argmax(there >= min(SEEN, there.max())))
    error[:first] = error[first:][there[first:] >= min(SEEN, there.max())].max()
    return ErrorSpectrum(wavelength, error, float(wavelength[first]))


ROUGH = 0.03
"""Relative residual of the solves that give errors, not answers. Conjugate gradients grow towards
their answer: at 0.1 an error came out up to 8 % too small, at 0.03 up to 2 %."""
PULLED = 2.0
"""What members say otherwise is made larger or smaller by their record by so much at most."""
BEYOND = 2.75
"""What is beyond the square of the strain may be, over what its orders go on to: no data have it.
Chosen on 150 problems with atoms for truth (commit f35114cb)."""
DIRECTIONS = {2: 24, 3: 60}
"""Of waves on which a local solid is compared."""
HALF_PERIOD = 30.0
"""Degrees between the directions of a crystal that differ most in their third-order constants."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Fields of errors on the interior nodes [length], each of shape [I, d] (Q1–Q3).

    Attributes:
        left: the correction that is left.
        waves: by the second member.
        data: by the halves.
        strain: what the orders of the force would go on to as a series, the nonlinear part times
            the gradient; times BEYOND. Of a linear member what forces of second order add.
        axis: by the crystal at its other extreme, where its axis is not stated, or at the one that
            the family's data have, where they contradict what is stated.
        moduli: the answer times the standard error of its moduli, where the law's record has one;
            it belongs to the data.
        pull: what waves and data are multiplied with: half way, in logarithms, to what the record
            says of such wavelengths (Q6).
    """

    left: np.ndarray
    waves: np.ndarray
    data: np.ndarray
    strain: np.ndarray | None = None
    axis: np.ndarray | None = None
    pull: float = 1.0
    moduli: np.ndarray | None = None


class PlacedMembers:
    """The members of a family on the points of a problem.

    Args:
        family: what was learned.
        points: a lattice, or for a linear rich member any points it goes on.
        options: of its `on`.

    Attributes:
        loads: how many are asked for at once, before the first: what a factorisation is worth.
    """

    loads = 1

    def __init__(self, family: Members, points: PointsLike, **options: Any) -> None:
        nodes = nodes_of(points)
        self.points: Any = nodes  # on ranks a piece
        self.family, self.options = family, options
        linear = getattr(family.rich, "linear", family.rich)
        scattered = nodes.spacing == 0
        self.rich = self._on(linear if scattered else family.rich)
        self.nonlinear = hasattr(self.rich, "straight")

    def _on(self, material: Any) -> Any:
        """A member on the points, or on the piece of them that this rank has."""
        if self.on_ranks:
            taken(self.options, "predict")
            return self.points.operator(material)
        return placed(material, self.points, verb="predict", has="straight", **self.options)

    @property
    def on_ranks(self) -> bool:
        """Whether other processes have other nodes."""
        return hasattr(self.points, "comm")

    def norm(self, field: np.ndarray) -> float:
        """‖field‖₂ of vectors [n, d], over the nodes of all ranks."""
        return float(self.points.norm(field) if self.on_ranks else np.linalg.norm(field))

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Scalar product of vectors [n, d], over the nodes of all ranks."""
        return float(self.points.dot(a, b) if self.on_ranks else (a * b).sum())

    def straight(self, u: np.ndarray) -> np.ndarray:
        """The linear part of the rich member at u."""
        return np.asarray((self.rich.straight if self.nonlinear else self.rich)(u))

    @cached_property
    def others(self) -> tuple[Any, Any, Any]:
        """The second member's linear part and the halves, placed when they are first asked for."""
        second, halves = self.family.second, self.family.halves
        rich = halves if self.nonlinear else tuple(getattr(m, "linear", m) for m in halves)
        one, *both = [self._on(each) for each in (second, *rich)]
        return getattr(one, "straight", one), both[0], both[1]

    @cached_property
    def inverse(self) -> Callable[[np.ndarray, float], np.ndarray]:
        """S: L⁻¹ of a load on the interior, to a relative residual."""
        if hasattr(self.rich, "inverse"):
            return self.rich.inverse(self.loads)  # type: ignore[no-any-return]
        inside, zero = self.points.interior, np.zeros(self.points.x.shape)

        def solved(right: np.ndarray, tolerance: float) -> np.ndarray:
            b = zero.copy()
            b[inside] = right
            return np.asarray(self.rich.rest(b, zero).u[inside])

        return solved

    def load(self, b: np.ndarray) -> np.ndarray:
        """What the operator equals in equilibrium, shape [I, d]."""
        return np.asarray(self.rich.load(b))

    def gradient(self, u: np.ndarray) -> float:
        """Root mean square of |H| near the unknowns; of a linear member the largest strain between
        neighbours."""
        if not self.nonlinear:
            return float(
                self.points.largest_strain(u) if self.on_ranks else largest_strain(self.points, u)
            )
        H, _ = self.rich.gradients(u)
        return float(np.sqrt(np.vdot(H, H) / (H.size / H.shape[-1] ** 2)))

    @cached_property
    def spectrum(self) -> Any:
        """What part of a field has which wavelength, by the record; None on ranks but the first."""
        points, record = whole_of(self.points), self.family.record
        wavelength = self.points.spacing * KNOTS if record is None else record.wavelength
        return points and Spectrum(points, wavelength)

    @cached_property
    def local(self) -> tuple[Spectrum, ErrorSpectrum] | None:
        """Waves of these nodes, and what a local solid of the rich member's long ones is off by
        (Q10); None but on whole lattices of one process."""
        points, d = self.points, self.points.dimension
        if self.on_ranks or not points.is_plain_lattice:
            return None
        law = getattr(self.rich.model, "linear", self.rich.model)
        stencil, _ = stencil_of(law, points.spacing, "predict")
        along, error = directions(DIRECTIONS[d], d), []
        local = np.linalg.inv(acoustic(stencil.brackets, along))
        for length in KNOTS:
            phase = 2 * np.pi / length
            ratio = local @ stencil.symbol(phase * along) * (points.spacing / phase) ** 2
            error.append(np.sqrt(((ratio - np.eye(d)) ** 2).sum(axis=(1, 2)).mean() / d))
        wavelength = points.spacing * KNOTS
        return Spectrum(points, wavelength), ErrorSpectrum(wavelength, np.array(error))

    def recorded(self, u: np.ndarray) -> tuple[float | None, float]:
        """The relative error that the record gives a field, None without one; and the share of its
        square that is shorter than all that the data held."""
        record = self.family.record
        if record is None or self.points.spacing == 0:
            return None, 0.0
        spectrum = self.spectrum
        found: tuple[float, float] = by_first(
            self.points, lambda u: record.told(spectrum.shares(u)), u
        )
        return found

    @cached_property
    def turned(self) -> Any:
        """The rich member with the crystal at its other extreme, or at the axis of the data that
        contradict theirs; None where neither is so, or it has no axis."""
        stated = self.points.axis
        turn = HALF_PERIOD if stated is None else self.family.axis_off
        if not (turn and getattr(self.rich.model, "q3", 0.0)):
            return None
        there = replace(self.points, axis=turn + (stated or 0.0))
        return PlacedMembers(self.family, there, **self.options).rich

    def correction(self, load: np.ndarray, u: np.ndarray) -> np.ndarray:
        """e = S (b − R u), the error and the improvement of u, shape [I, d] (Q1)."""
        return self.inverse(load - self.rich(u), ROUGH)

    def bent(self, u: np.ndarray) -> np.ndarray | None:
        """What the body moves by since its force is not linear at u, [I, d] (Q3).

        Of a linear member by the forces of second order of its data; on ranks and behind a narrow
        collar by the most that any uniform strain gives; None off lattices and without such data.
        """
        if self.nonlinear:
            return self.inverse(self.rich(u) - self.straight(u), ROUGH)
        c = self.family.quadratic
        if not (c and self.points.spacing):
            return None
        try:
            if not self.on_ranks:
                return self.inverse(
                    np.tensordot(c, second_order(self.points, u[None]), 1)[0], ROUGH
                )
        except InputError:  # a narrow collar
            pass
        bent: np.ndarray = self.most_bent * self.gradient(u) * u[self.points.interior]
        return bent

    @cached_property
    def most_bent(self) -> float:
        """The strain that forces of second order give, over the square of a uniform strain."""
        law, d = self.rich.model, self.points.dimension
        linear = getattr(law, "linear", law)  # on ranks a crystal
        stencil, _ = stencil_of(linear, self.points.spacing, "predict")
        C = elastic_from_brackets(stencil.brackets).reshape(d * d, d * d)
        E = np.random.default_rng(0).normal(size=(100, d, d))
        E += E.swapaxes(1, 2)
        E /= np.linalg.norm(E, axis=(1, 2))[:, None, None]
        P = np.tensordot(self.family.quadratic, quadratic_stresses(E), 1).reshape(-1, d * d)
        return float(np.linalg.norm(P @ np.linalg.pinv(C), axis=1).max())

    def series(self, gradient: float, slowed: float = 0.0) -> float:
        """What is beyond the orders of the rich member may be, over what is not linear (Q3).

        Args:
            gradient: |H|.
            slowed: the second correction over the first, where both are known.
        """
        if not self.nonlinear:
            return 1.0
        return max(BEYOND * self.family.factors.screen * gradient, slowed)

    def doubts(
        self, u: np.ndarray, left: np.ndarray, told: float | None = None, slowed: float = 0.0
    ) -> Parts:
        """Fields of what the members do not know of u, [N, d]; `left` is its correction, `told`
        what the record says of it, `slowed` as in `series`."""
        second, *halves = self.others
        lin = self.straight(u)
        waves = self.inverse(lin - second(u), ROUGH)
        data = self.inverse(halves[0](u) - halves[1](u), ROUGH) / np.sqrt(2)
        strain, axis = self.bent(u), None
        if strain is not None:
            strain = self.series(self.gradient(u), slowed) * strain
        if self.turned is not None:
            axis = self.inverse(self.rich(u) - self.turned(u), ROUGH)
        size = self.norm(u[self.points.interior]) or 1.0
        members = spread(self.norm(waves), self.norm(data)) / size
        unsure = self.family.moduli_error
        moduli = unsure * u[self.points.interior] if unsure else None
        return Parts(left, waves, data, strain, axis, pulled(members, told), moduli)


def quadratic_stresses(H: np.ndarray) -> np.ndarray:
    """All isotropic stresses that are quadratic in H = ∇u, [..., d, d], shape [7, ..., d, d]."""
    E, one = (H + H.swapaxes(-1, -2)) / 2, np.eye(H.shape[-1])
    W, trace = H - E, np.trace(E, axis1=-2, axis2=-1)[..., None, None]
    squares = ((F * F).sum(axis=(-1, -2))[..., None, None] * one for F in (E, W))
    mixed = (H @ H.swapaxes(-1, -2), E @ W - W @ E)
    return np.stack([trace**2 * one, *squares, trace * E, E @ E, *mixed])


def second_order(points: Points, u: np.ndarray) -> np.ndarray:
    """Forces of those stresses of u [S, N, d], by differences on a lattice, [7, S, I, d]."""
    grid = grid_of(points, 2 * np.eye(points.dimension, dtype=int))
    axes = tuple(range(2, 2 + points.dimension))

    def slopes(planes: np.ndarray) -> np.ndarray:
        return np.stack(np.gradient(planes, points.spacing, axis=axes), axis=-1)

    crop: tuple[Any, ...] = (..., *grid.core) if grid.periodic else (...,)

    def force(P: np.ndarray) -> np.ndarray:
        bent = [slopes(np.moveaxis(P[..., j], -1, 1))[..., j] for j in range(points.dimension)]
        return grid.gather(np.sum(bent, axis=0)[crop])

    H = np.moveaxis(slopes(grid.scatter(u)), 1, -2)
    return np.array([force(P) for P in quadratic_stresses(H)])


def whole_of(points: Any) -> Points | None:
    """The points; of a piece those of the whole body on the first rank, None on others."""
    if not hasattr(points, "comm"):
        return points  # type: ignore[no-any-return]
    x, inside = (points.joined(values) for values in (points.x, points.interior))
    return None if x is None else Points(x, inside, points.spacing)


def by_first(points: Any, told: Callable[..., Any], *fields: np.ndarray) -> Any:
    """What `told` says of fields of the whole body: on ranks the first one asks, and all hear."""
    if not hasattr(points, "comm"):
        return told(*fields)
    whole = [points.joined(field) for field in fields]
    return points.comm.bcast(None if whole[0] is None else told(*whole))


def spread(waves: float, data: float) -> float:
    """What members say otherwise: the root mean square of the sizes of both fields."""
    return float(np.sqrt((waves**2 + data**2) / 2))


def pulled(members: float, told: float | None) -> float:
    """The factor towards what the record has told, of the same (Q6)."""
    if told is None or not members > 0:
        return 1.0
    return float(np.clip(np.sqrt(told / members), 1 / PULLED, PULLED))


@dataclass(frozen=True)
class Factors:
    """Calibration: by how much what can be computed is multiplied, so that it is an error (Q4).

    Attributes:
        left: of the correction that is left.
        floor: of what waves, data and strain may miss.
        screen: of the mean gradient, for what the linear answer misses.
    """

    left: float = 1.2
    floor: float = 1.48
    screen: float = 1.42

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (is_number(value) and value >= 0):
                raise InputError(f"{name}: expected a factor ≥ 0, got {value!r:.40}")


@dataclass(frozen=True, eq=False, repr=False)
class Members(OnLinear, format="warp_peri.family", version=2):
    """What `fit(samples, prediction.learning.Family(…))` learns: a material with its doubts.

    It solves, moves and is placed on points as its rich member. `predict` uses all.

    Attributes:
        rich: the best law of the data, linear or of third order.
        second: a poorer one; how they differ is what short waves may miss.
        halves: the rich law from two halves of the samples; how they differ is what data may miss.
        record: error of the rich member by wavelength; None of scattered samples.
        factors: calibration.
        strain: largest strain between neighbouring nodes in the samples.
        temperature: [K] of the samples, where they state it.
        quadratic: of a linear rich member the constants of the forces of second order that its
            data show [stress], those of `quadratic_stresses`.
        axis_off: degrees by which the samples' own crystal is turned from the axis they state.
        provenance: of the fit.
    """

    rich: Any
    second: Any
    halves: tuple[Any, Any]
    record: ErrorSpectrum | None = None
    factors: Factors = Factors()
    strain: float = 0.0
    temperature: float | None = None
    quadratic: Annotated[tuple[float, ...], Entry(stress=1, omit=True)] = ()
    axis_off: Annotated[float, Entry(omit=True)] = 0.0
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

    def with_doubts(self, points: PointsLike, **options: Any) -> PlacedMembers:
        """All members on points, with what they do not know there; options of `on`."""
        return PlacedMembers(self, points, **options)

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        names = [type(one).__name__ for one in (self.rich, self.second)]
        rows = [("rich, second", ", ".join(names)), ("strain seen", f"{self.strain:.2%}")]
        rows.append(("factors", f"{self.factors.left:.2f} left, {self.factors.floor:.2f} floor"))
        return rows + list(self.rich.rows() if hasattr(self.rich, "rows") else [])
