"""Crystals learned from fields, phonons and other crystals (theory, T7–T10, T14–T20)."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray
from numpy.linalg import eigvals, eigvalsh, lstsq, matrix_rank, solve, svd

from warp_peri.core import elastic
from warp_peri.core.elastic import (
    BROKEN,
    Symmetry,
    acoustic,
    allowed_tensors,
    bracket_rows,
    brackets_from_elastic,
    checked_orientation,
    directions,
    huang_rows,
    name_of,
    point_group,
    shared_with_nodes,
    stress_brackets,
    turned,
    voigt_to_tensor,
)
from warp_peri.core.proof import check_spacing
from warp_peri.core.stencil import grid_of, half_ball, invariant_basis
from warp_peri.errors import InputError, Values, called, warn
from warp_peri.files.atomic import plain
from warp_peri.fitting import regression
from warp_peri.fitting.long_waves import judged, long_wave_moduli
from warp_peri.fitting.regression import (
    Form,
    LatticeRows,
    Numbers,
    Settled,
    compressed,
    norms,
    over_loads,
    particular,
    rows,
)
from warp_peri.fitting.result import Fit
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.lps_law import LONG_WAVES
from warp_peri.materials.transfer import (
    LARGEST_WAVE,
    LONGEST,
    WaveSymbol,
    carried_symbol,
    wave_rows,
)
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Positive, Units, factors, offered, symbols, typed
from warp_peri.points.dataset import Dataset, sets_of
from warp_peri.points.points import Samples, check_dimensions, check_lattice

if TYPE_CHECKING:
    from warp_peri.atoms.force_constants import ForceConstants

POOR = 0.1
"""The part of the loads of long waves that moduli which fields tell may leave unsaid."""
UNLIKE, OTHER = 1.5, 2.5
"""Times a tensor that its symbol's long waves are: worth a word if any, another solid's if most."""
ABSURD = 10.0
"""Times the loads, that no law leaves of data in its own units, however noisy."""
FLOOR = 0.3
"""ζ over the softest acoustic modulus."""
NOTHING, TOLD = 1e-10, 1e-6
"""Of equalities of size one, that are rounding; relative, what contradicts them."""
DEPENDENT = 1e-12
"""Relative size of a number that the rows do not tell."""
NUMBERS = 3
"""Numbers for each equation that holds moduli, from which holding them costs short waves little."""
OFF = 0.05
"""Of the largest modulus: what is missed by more is warned of."""
FAR = 1e3
"""Nodes over the cell of the atoms, or the cell over nodes, beyond which units are mistaken."""
SAME = 1e-6
"""Relative, of spacings, and of rotations that leave the crystal as it is on its nodes."""


class Tensors:
    """Unknowns θ of a crystal fit: C h² [stress] of all tensors that the group allows."""

    def __init__(self, spacing: float, horizon: float, symmetry: Symmetry, turn: ndarray) -> None:
        self.spacing, self.symmetry, self.turn = spacing, symmetry, turn
        self.allowed = allowed_tensors(symmetry, turn)
        self.group = shared_with_nodes(point_group(symmetry, len(turn)), turn)
        self.bonds = invariant_basis(horizon / spacing, self.group)

    def fitted(
        self, R: ndarray, y: ndarray, tensor: ndarray | None, stress: ndarray | None = None
    ) -> Settled:
        """Fit the tensors, and the numbers of extra columns, to rows R [n, P + E] and y [n],
        holding an elastic tensor along the nodes' axes, else Huang's relations alone. Raises
        InputError for a tensor that the family lacks, too few rows, or a floor that none meets."""
        d, count = len(self.turn), len(self.bonds.basis)
        moments, equations = self.bonds.moments(), huang_rows
        asked = stress_brackets(np.zeros((d, d)) if stress is None else stress)
        if tensor is not None:
            asked, equations = asked + brackets_from_elastic(tensor), bracket_rows
        size = np.abs(moments).max()  # rows that vanish by symmetry are rounding beside it
        A, a = equations(moments) / size, equations(asked[None])[:, 0] / size
        if tensor is None:
            asked = np.tensordot(lstsq(R, y)[0][:count], moments, 1)
        soft = eigvalsh(acoustic(asked, directions(400, d)))[:, 0].min()
        if not soft > 0:
            raise InputError(
                f"moduli: expected a stable crystal, got a sound wave of stiffness {soft:.3g}"
            )
        said = norms(A) > NOTHING
        A, a = np.pad(A[said], [(0, 0), (0, R.shape[1] - count)]), a[said]
        start, free = particular(A, a)
        if np.abs(A @ start - a).max(initial=0.0) > TOLD * np.abs(a).max(initial=1e-300):
            raise InputError(
                "moduli: no model of this horizon and symmetry has them; a larger horizon or a "
                "smaller symmetry may"
            )
        R, y = compressed(R, y)
        sizes = svd(R @ free, compute_uv=False)
        if np.count_nonzero(sizes > DEPENDENT * sizes.max(initial=0.0)) < free.shape[1]:
            raise InputError(
                f"data: expected enough to tell {free.shape[1]} numbers of "
                f"{len(self.bonds.steps) * 2} bonds apart; give more loads, shorter waves, a "
                "smaller horizon or a larger symmetry"
            )
        one, none, floor = np.eye(R.shape[1]), np.zeros((0, R.shape[1])), FLOOR * soft

        def law(theta: ndarray) -> Numbers:
            form = Form(0, theta[:count], one[:count], floor)
            left = (A @ theta - a) / soft
            return Numbers([theta], [one], [form], left, A / soft, none[:, 0], none)

        block = LatticeRows(R, y, self.bonds, self.group)
        found = regression.fit([block], law, start, floor, linear=True)
        if not found.kept:
            raise InputError("stability: no model of this horizon and symmetry meets the floor")
        return found

    def crystal(
        self, found: Settled, units: Units, record: Values, stress: ndarray | None = None
    ) -> CrystalMaterial:
        """Build the certified crystal from fitted numbers."""
        p = found.p[0][: len(self.bonds.basis)]
        tensors = np.tensordot(p, self.bonds.basis, 1) / self.spacing**2
        record = {"fit": record | {"loss": found.loss, "cuts": found.cuts}} if record else {}
        given: Any = {"symmetry": self.symmetry, "orientation": self.turn, "stress": stress}
        steps = self.bonds.steps
        law = CrystalMaterial(self.spacing, steps, tensors, units, provenance=record, **given)
        return law.certified()


@typed
@dataclass(frozen=True)
class Crystal:
    """Settings of a crystal fit: a tensor C(ξ) for every bond, in the plane or space (theory, T).

    Attributes:
        horizon: length of the longest bond [length].
        symmetry: name of the crystal's point group, rotations, or "auto": the largest group with
            which the fit is as good as without one.
        orientation: the crystal's axes in the coordinates of the points, columns of a rotation [d,
            d], or degrees; the points' own axis by default.
        moduli: "long waves" holds those that a fit of long waves finds, None holds none, a Voigt
            matrix (crystal's axes) [stress], shape [3, 3], in space [6, 6], holds its own.
        normalise: weigh each sample by 1/‖b‖.

    `fit` raises InputError for several sets, scattered points, or an unknown symmetry.

    >>> wp.fit(samples, wp.Crystal(12.5, "4mm")).material.certificate.proven > 0
    True
    """

    horizon: Positive
    symmetry: Symmetry = "auto"
    orientation: Any = None
    moduli: Any = LONG_WAVES
    normalise: bool = False

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> Fit:
        """Learn the crystal by one least squares, without a progress bar; the fit's history has the
        loss, the group's loss over the best group's (`symmetry_ratio`), cuts and numbers.

        Raises InputError for samples that do not carry the horizon or do not determine the law.
        Warns where data contradict the given symmetry, and where long waves are too few or too
        short to tell moduli.
        """
        given = one_set(samples)
        turn = self.turn(given)
        reach, C, misfit = self.horizon / given.spacing, self.held_moduli(turn), None
        name, ratio = judged(given, reach, turn, self.normalise, self.symmetry)
        tensors = Tensors(given.spacing, self.horizon, name, turn)
        R, y = rows(given, tensors.bonds, weight=over_loads(given) if self.normalise else None)
        if self.moduli is not None and C is None:
            C, misfit = long_wave_moduli(given, tensors.allowed)
            if misfit > POOR:
                warn(
                    f"moduli: those of the longest waves leave {misfit:.0%} of what these loads do "
                    "to them, and may be as far off: give them, or loads of longer waves on more "
                    "nodes"
                )
        found = tensors.fitted(R, y, C)
        if not found.loss < ABSURD:
            raise InputError(
                f"data: the model leaves {found.loss:.3g} times the loads themselves; are moduli "
                f"in {symbols(given.units)[1]}, and loads the forces on the nodes?"
            )
        record = {
            "from": "fields",
            "symmetry_ratio": ratio,
            "long_wave_misfit": misfit,
            "numbers": len(tensors.bonds.basis),
            "moduli_held": C is not None,
        }
        material = tensors.crystal(found, given.units, record)
        history = dict(material.provenance["fit"])
        return Fit(material, material.certificate, {}, history, left=found.loss)

    def check_samples(self, samples: Samples, spacing: float | None = None) -> None:
        """Raise InputError for samples to learn from that `learn` refuses, and for nodes that a
        crystal learned at a `spacing` refuses."""
        check_spacing(spacing or samples.spacing, samples.spacing, "these points have")
        self.held_moduli(self.turn(samples))
        grid_of(samples.points, half_ball(self.horizon / samples.spacing, samples.dimension))

    def turn(self, given: Samples) -> ndarray:
        """Rotation from the crystal's axes to those of the samples' nodes, shape [d, d]."""
        stated, d = given.axis if self.orientation is None else self.orientation, given.dimension
        return (
            np.eye(d) if stated is None else given.lattice.axes.T @ checked_orientation(stated, d)
        )

    def held_moduli(self, turn: ndarray) -> ndarray | None:
        """The given elastic tensor along the nodes' axes; None where none was given."""
        if self.moduli is None or isinstance(self.moduli, str):
            if self.moduli not in (None, LONG_WAVES):
                raise InputError(
                    f"moduli: expected {LONG_WAVES!r}, None or a Voigt matrix, got "
                    f"{self.moduli!r:.60}"
                )
            return None
        moduli, d = voigt_to_tensor(self.moduli), len(turn)
        if len(moduli) != d:
            raise InputError(f"moduli: expected those of {d} dimensions, got {len(moduli)}")
        return turned(moduli, turn)


def one_set(samples: Any) -> Samples:
    """The samples of a single set; of a Dataset `train`, or its only set."""
    sets = sets_of(samples)
    if len(sets) != 1:
        raise InputError(f"samples: expected one set for a crystal model, got {len(sets)}")
    check_lattice(sets[0])
    return sets[0]


@typed
def fit_dispersion(
    target: WaveSymbol,
    spacing: Positive,
    horizon: Positive,
    *,
    symmetry: Symmetry,
    orientation: Any = None,
    tensor: ndarray | None = None,
    stress: ndarray | None = None,
    units: Units = USUAL,
    largest_wave: Positive = LARGEST_WAVE,
    record: Values | None = None,
) -> CrystalMaterial:
    """Fit a crystal's tensors to a symbol D₀: rows D₀⁻¹ D e − e (T9).

    Args:
        target: D₀(k) [stress/length²] at k [K, d] along the nodes' axes, to [K, d, d].
        spacing, horizon: of the crystal's nodes and longest bond.
        symmetry: of the crystal, by name or as rotations.
        orientation: the crystal's axes in those of the nodes.
        tensor: elastic tensor to hold, along the nodes' axes, [d, d, d, d]; without it Huang's
            relations alone are held, and the orientation is a rotation.
        stress: that the crystal is held under, along the nodes' axes, [d, d].
        largest_wave: |k| h up to which waves weigh fully; beyond it a tenth.
        record: goes into the provenance.

    Raises InputError for a symbol that is not symmetric and positive, a tensor without its
    symmetries, a record that is no JSON, and as `Tensors.fitted`.
    """
    axes = orientation if tensor is None else tensor
    d = called("tensor, orientation: expected one of them, a rotation", len, axes)
    check_dimensions("tensor, orientation", d)
    if tensor is not None:
        tensor = arguments.checked("tensor", tensor, float, 4 * (d,))
        off = np.abs(tensor - voigt_to_tensor(elastic.voigt(tensor))).max()
        if off > TOLD * np.abs(tensor).max():
            raise InputError(f"tensor: expected C_ijkl = C_jikl = C_ijlk, got some {off:.2g} off")
    stress = None if stress is None else elastic.checked_symmetric("stress", stress, (d, d))
    called("record: expected values of JSON", json.dumps, plain(record), allow_nan=False)
    tensors = Tensors(spacing, horizon, symmetry, checked_orientation(orientation, d))
    R, y = wave_rows(target, spacing, tensors.bonds, tensors.group, largest_wave)
    told = (record or {}) | {
        "numbers": len(tensors.bonds.basis),
        "moduli_held": tensor is not None,
        "largest_wave": largest_wave / spacing,
    }
    found = tensors.fitted(R, y, tensor, stress)
    if tensor is not None:
        k = 10 * LONGEST / spacing * directions(400, d)  # long, and above what symbols are off
        held = 0 if stress is None else stress_brackets(stress)
        times = np.abs(eigvals(solve(target(k), acoustic(brackets_from_elastic(tensor) + held, k))))
        most, usual = (max(np.max(one), 1 / np.min(one)) for one in (times, np.median(times)))
        said = "tensor: expected that of the symbol, whose long waves are off"
        if usual > OTHER:
            raise InputError(f"{said} {usual:.2g} times")
        if most > UNLIKE:
            warn(f"{said} by up to {most:.2g} times")
    if not found.loss < ABSURD:
        raise InputError(f"target: the crystal's answers are off {found.loss:.3g} times")
    return tensors.crystal(found, units, told, stress)


def symmetry_of(atoms: ForceConstants, symmetry: Symmetry) -> Symmetry:
    """The symmetry asked for; of "auto" that which spglib finds."""
    return name_of(atoms.group()) if str(symmetry) == "auto" else symmetry


def check_beside(spacing: float, cell: float, units: Units = USUAL) -> None:
    """Raise InputError for nodes that are nearer, or further apart, than a cell is long by FAR."""
    if not 1 / FAR < spacing / cell < FAR:
        raise InputError(
            f"spacing: expected nodes about as far apart as a cell of the atoms is long, "
            f"{cell:.3g} {symbols(units)[0]}, got {spacing:g}"
        )


@typed
def fit_phonons(
    atoms: ForceConstants,
    spacing: Positive,
    horizon: Positive,
    *,
    symmetry: Symmetry = "auto",
    orientation: Any = None,
    units: Units = USUAL,
) -> CrystalMaterial:
    """Fit a certified crystal to the phonons of atoms, from their force constants alone (T14).

    Args:
        atoms: force constants; the crystal's axes are those of their coordinates.
        spacing, horizon: of the nodes and of the longest bond, in the unit of length.
        symmetry: "auto" asks spglib.
        orientation: the crystal's axes in those of the nodes.
        units: of the crystal.

    It has the atoms' elastic constants exactly where a family has NUMBERS for each; elsewhere long
    waves weigh four times. Raises InputError for a crystal that is not stable.
    """
    offered(atoms, "effective", "atoms", "ForceConstants, as from_calculator gives")
    d, turn = atoms.dimension, checked_orientation(orientation, atoms.dimension)
    length, stress = factors(units, USUAL)
    name = symmetry_of(atoms, symmetry)
    cell = (atoms.volume / (atoms.thickness or 1.0)) ** (1 / d)
    check_beside(spacing, cell / length, units)

    def target(k: ndarray) -> ndarray:
        D = atoms.effective(k / length @ turn)  # k in the crystal's axes is Rᵗ k
        return np.asarray(turn @ D @ turn.T) * (length**2 / stress)

    same = shared_with_nodes(point_group(name, d), turn)
    moments = invariant_basis(horizon / spacing, same).moments()
    hold = len(moments) >= NUMBERS * matrix_rank(bracket_rows(moments))
    allowed = allowed_tensors(name, np.eye(d))
    true = turned(atoms.elastic(allowed), turn) / stress  # refuses what is no elastic solid
    held = None if atoms.stress is None else turn @ atoms.stress @ turn.T / stress
    law = fit_dispersion(
        target,
        spacing,
        horizon,
        symmetry=name,
        orientation=turn,
        tensor=true if hold else None,
        stress=held,
        units=units,
        record={"from": "phonons"},
    )
    off = np.abs(law.tensor() - true).max() / np.abs(true).max()
    if off > OFF:
        warn(
            f"moduli: with {law.bonds} bonds they are up to {off:.0%} of the largest away from "
            "those of the atoms; a longer horizon brings them back"
        )
    return law


@typed
def transfer_to_lattice(
    law: CrystalMaterial,
    spacing: Positive,
    *,
    rotation: Any = None,
    horizon: Positive | None = None,
) -> CrystalMaterial:
    """Fit the same crystal on other nodes to its own symbol, moduli held, with a certificate (T17).

    Args:
        law: the crystal.
        spacing: of the new nodes.
        rotation: by which the crystal is turned on its nodes, [d, d], or degrees in the plane:
            C(Rξ) is R C(ξ) Rᵗ, so that its symbol is R D(Rᵗ k) Rᵗ.
        horizon: on the new nodes; by default as many spacings as on the old ones.

    Raises InputError where the symbol is not positive.
    """
    d = law.dimension
    turn = checked_orientation(rotation, d)
    orientation = turn @ law.orientation
    held = None if law.stress is None else turn @ law.stress @ turn.T
    same = shared_with_nodes(turn[None], np.eye(d)).any() and horizon is None
    if same and abs(spacing / law.spacing - 1) < SAME:
        steps, tensors = np.rint(law.steps @ turn.T).astype(int), turn @ law.tensors @ turn.T
        turned_law = {"steps": steps, "tensors": tensors, "orientation": orientation}
        return replace(law, **turned_law, stress=held, certificate=None).certified()
    return fit_dispersion(
        carried_symbol(law.symbol, law.spacing, turn),
        spacing,
        horizon or law.horizon / law.spacing * spacing,
        symmetry=law.symmetry,
        orientation=orientation,
        tensor=turned(law.tensor(), turn),
        stress=held,
        units=law.units,
        largest_wave=LARGEST_WAVE * min(1.0, spacing / law.spacing),
        record={"from": "a law on other nodes", "spacing": law.spacing},
    )


@typed
def plane_strain(law: CrystalMaterial, normal: int = 2) -> CrystalMaterial:
    """Reduce a crystal in space to plane strain: fields constant along axis 0, 1 or 2 of the nodes,
    bonds summed along it, exact at all wavelengths.

    Raises InputError for a crystal in the plane, another axis, and one that such fields push out of
    the plane: a mirror or a twofold turn about the normal forbids it.
    """
    kept = _kept(law, normal)
    sums: dict[tuple[int, ...], ndarray] = {}
    for step, C in zip(law.steps[:, kept].tolist(), law.tensors):
        if any(step):
            key = max(tuple(step), tuple(-s for s in step))
            sums[key] = sums.get(key, np.zeros((3, 3))) + C
    tensors = np.array(list(sums.values()))
    pushed = np.abs(tensors[:, kept, normal]).max()
    if pushed > BROKEN * np.abs(tensors).max():
        raise InputError(
            f"normal: expected an axis with a mirror or a twofold turn, got one along which fields "
            f"of the plane push (by {pushed / np.abs(tensors).max():.1e} of the tensors)"
        )
    turns = law.orientation @ point_group(law.symmetry, 3) @ law.orientation.T
    return replace(
        law,
        steps=np.array(list(sums)),
        tensors=tensors[:, kept][:, :, kept],
        symmetry=turns[np.abs(np.abs(turns[:, normal, normal]) - 1) < BROKEN][:, kept][:, :, kept],
        orientation=None,
        stress=None if law.stress is None else law.stress[np.ix_(kept, kept)],
        certificate=None,
    ).certified()


@typed
def plane_stress(law: CrystalMaterial, normal: int = 2) -> CrystalMaterial:
    """Reduce a crystal in space to a thin sheet, free of stress across an axis of its nodes.

    Its moduli are a Schur complement; at short waves it answers as that elastic solid does, for
    what faces do there is no property of the crystal. Bonds and errors as in `plane_strain`.
    """
    order = [*_kept(law, normal), normal]
    C = elastic.plane_stress(law.tensor()[np.ix_(order, order, order, order)])
    brackets = brackets_from_elastic(C)
    flat = plane_strain(law, normal)
    return fit_dispersion(
        lambda k: acoustic(brackets, k),
        law.spacing,
        flat.horizon,
        symmetry=flat.symmetry,
        tensor=C,
        units=law.units,
        record={"from": "plane stress"},
    )


def _kept(law: CrystalMaterial, normal: int) -> list[int]:
    if law.dimension != 3 or normal not in (0, 1, 2):
        raise InputError(
            f"normal: expected axis 0, 1 or 2 of a model in space, got {normal!r:.20} of one in "
            f"{law.dimension} dimensions"
        )
    return [axis for axis in range(3) if axis != normal]
