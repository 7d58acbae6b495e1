"""No more than a scene needs: the cheapest measured model and solver within a tolerance."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from warp_peri.contract import linear_part
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.arrays import LARGEST, check_positive, is_number, is_positive
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import USUAL, factors, symbols
from warp_peri.prediction.placed import KNOTS, Spectrum
from warp_peri.statics.linear import DIRECT, cheapest_method
from warp_peri.transfer.cache import on_lattice

LU_POWER = 1.5
"""Cost of a sparse factorisation in two dimensions grows with this power of the unknowns."""
SPACINGS, RATIO = 8, 2**0.25
"""Lattices that a model is tried on, each so much finer than the one before."""
LEFT = 0.01
"""Share of the square of a displacement that is left to shorter waves than the shortest."""
ANSWERS = {"FEM Q1": "elements", "FEM Q2": "elements", "third-order model": "nonlinear"}
"""What the kinds of rows that are no linear solids answer with; `predict` is its own."""
UNSOLVED = ("positive kernel", "atoms", "neural operator")
"""Kinds that are in the table to compare with."""


@dataclass(frozen=True)
class Scene:
    """What is to be solved.

    Attributes:
        size: extents of the domain [Å]; where a model is given, in its unit of length.
        shortest_wave: shortest wavelength of the load, likewise.
        rectangle: whether the unknown nodes fill the box of that size.
        strain: root mean square of |grad u|, where it is known: rows are held to their errors at
            it, and to those at 2 % of bond strain without.
        loads: how many are solved for.
        stiff: λ ≫ μ.
    """

    size: tuple[float, float]
    shortest_wave: float
    rectangle: bool = False
    strain: float | None = None
    loads: int = 1
    stiff: bool = False

    def __post_init__(self) -> None:
        pair = isinstance(self.size, (tuple, list, np.ndarray)) and np.ndim(self.size[:1]) == 1
        if not pair or len(self.size) != 2:
            raise InputError(f"scene: expected two extents (x, y) [Å], got size {self.size!r:.60}")
        if not all(is_positive(v) and v < LARGEST for v in (*self.size, self.shortest_wave)):
            raise InputError(
                f"scene: expected lengths > 0 Å, below {LARGEST:g}, got size "
                f"{self.size}, wave {self.shortest_wave}"
            )
        if self.strain is not None and not is_positive(self.strain):
            raise InputError(f"scene: expected a strain > 0 or None, got {self.strain!r:.40}")
        if not (is_number(self.loads) and self.loads >= 1):
            raise InputError(f"scene: expected a number of loads ≥ 1, got {self.loads!r:.40}")

    @classmethod
    def of(cls, problem: Any, *, modulus: float) -> Scene:
        """The scene of a problem: size, wavelengths and strain, without a solve.

        Waves of the load move a solid by b/(μ k²); the strain is that of these and of the collar.

        Args:
            problem: Dirichlet(points, b, u) on a lattice in the plane.
            modulus: a shear modulus μ [stress], in the points' unit.

        Raises InputError for scattered points, and a problem without load and displacement.
        """
        check_positive("modulus", modulus)
        points = nodes_of(problem.points)
        if not (points.spacing > 0 and points.dimension == 2):
            raise InputError("scene: expected a problem on a lattice in the plane")
        grid = lattice_steps(points)[0]
        sides = np.ptp(grid[points.interior], axis=0) + 1
        shape = (-1, *points.x.shape)
        load, field = (np.reshape(np.asarray(one, float), shape) for one in (problem.b, problem.u))
        moved = np.stack([_answered(grid, points.spacing, b) for b in load]) / modulus
        moved += np.where(points.interior[:, None], 0.0, field)  # the collar as it is given
        knots = points.spacing * KNOTS
        shares = np.mean([Spectrum(points, knots).shares(u) for u in moved], axis=0)
        if not shares.sum() > 0:
            raise InputError("scene: expected a load, or displacement on the collar")
        below = np.cumsum(shares) <= LEFT * shares.sum()
        strain = float(np.sqrt(np.mean([gradient_size(points, u) ** 2 for u in moved])))
        unit, _ = factors(points.units, USUAL)
        size = (float(unit * points.spacing * sides[0]), float(unit * points.spacing * sides[1]))
        short = float(unit * knots[min(int(below.sum()), len(knots) - 1)])
        rectangle = bool(np.prod(sides) == np.count_nonzero(points.interior))
        return cls(size, short, rectangle, strain or None, len(moved))


def _answered(grid: np.ndarray, spacing: float, load: np.ndarray) -> np.ndarray:
    """μ u of a solid without λ + μ and without edges: b̂/k² of a load [N, 2]."""
    grid = grid - grid.min(axis=0)
    shape = tuple(2 * (grid.max(axis=0) + 1))
    field = np.zeros((2, *shape))
    field[:, *grid.T] = load.T
    k = np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n, spacing) for n in shape), indexing="ij")
    square = k[0] ** 2 + k[1] ** 2
    square[0, 0] = np.inf
    answer = np.fft.ifft2(np.fft.fft2(field) / square).real
    return np.asarray(answer[:, *grid.T].T)


def gradient_size(points: PointsLike, u: np.ndarray) -> float:
    """Root mean square of |grad u| of a field [N, d] on a lattice, by central differences where
    both neighbours are nodes."""
    grid = lattice_steps(points)[0]
    d = grid.shape[1]
    table = neighbour_table(grid, np.concatenate([np.eye(d, dtype=int), -np.eye(d, dtype=int)]))
    square, count = 0.0, 0
    for axis in range(d):
        ahead, behind = table[:, axis], table[:, d + axis]
        both = (ahead >= 0) & (behind >= 0)
        slope = (u[ahead[both]] - u[behind[both]]) / (2 * points.spacing)
        square += float((slope**2).sum() / max(int(both.sum()), 1))
        count += int(both.sum())
    return float(np.sqrt(square)) if count else 0.0


@dataclass(frozen=True)
class Choice:
    """What to use, and why in one sentence.

    Attributes:
        spacing: h [Å].
        horizon: δ [Å]; 0 of elements.
        degree: M of the influence function; of elements their order.
        method: of `solve`; "elements", or "predict".
        error: measured displacement error, a fraction.
        seconds: expected for set-up and the solves on the machine that measured.
        reason: the sentence.
        answer: "elements", "linear", "nonlinear" or "predict".
        label: of the row in the table.
    """

    spacing: float
    horizon: float
    degree: int
    method: str
    error: float
    seconds: float
    reason: str
    answer: str = "linear"
    label: str = ""


def shipped_table() -> dict[str, Any]:
    """What the study of speed and accuracy measured on graphene: rows, and waves they hold for."""
    text = (files("warp_peri") / "speed_accuracy.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text)
    return table


@dataclass(frozen=True, order=True)
class _Way:
    """One row of a table, for one scene."""

    seconds: float
    error: float
    nodes: float
    method: str
    answer: str
    number: int


def _ways(table: dict[str, Any], scene: Scene, name: str) -> list[_Way]:
    """Every row of a table that can be gone, with what it costs and errs."""
    found = []
    for number, row in enumerate(table["rows"]):
        kind = row["kind"]
        own = row["method"] in ("rest", "predict") or kind.startswith("FEM")
        # What `solve` can do of the linear solid: its factorisations are float64.
        if kind in UNSOLVED or not (own or row["method"] == "lu"):
            continue
        nodes = math.prod(length / row["spacing"] for length in scene.size)
        growth = nodes / row["disks_nodes"]
        setup, each = row["disks_setup"], row["disks_solve"]
        if scene.loads > 1 and "hundred" in row:
            each = (row["hundred"] - setup) / 100
        seconds = setup + scene.loads * each
        method = cheapest_method(
            int(nodes), box=scene.rectangle, stiff=scene.stiff, loads=scene.loads
        )
        if kind.startswith("FEM"):
            method, seconds = "elements", seconds * growth**LU_POWER
        elif own:
            seconds *= growth
        elif nodes <= DIRECT:
            method, seconds = "lu", seconds * growth**LU_POWER
        else:
            iterated = "sine" if scene.rectangle else "multigrid"
            seconds = table["seconds_per_node"][iterated] * nodes * scene.loads
        answer = ANSWERS.get(kind, "predict" if row["method"] == "predict" else "linear")
        method = "predict" if answer == "predict" else method
        found.append(_Way(seconds, _error(row, scene, name), nodes, method, answer, number))
    return found


def _error(row: dict[str, Any], scene: Scene, name: str) -> float:
    """Of a row on loads as long or short as a scene's, at its strain."""
    error: float = row[f"{name}_error"]
    agreed = 0.0
    if name == "disks" and "agrees" in row:  # levels up to which a transfer does, and lengths [Å]
        levels = (level for level, length in row["agrees"] if length <= scene.shortest_wave)
        agreed = min(levels, default=math.inf)
    if scene.strain is None or "strained" not in row:
        return float(max(error, agreed))
    strain, measured = np.array(row["strained"]).T
    at = float(np.exp(np.interp(np.log(scene.strain), np.log(strain), np.log(measured))))
    at *= max(1.0, scene.strain / strain[-1])
    if name == "waves":
        return float(np.hypot(error, at))
    return float(max(at, agreed))


def choose_model(
    *, tolerance: float, scene: Scene, table: dict[str, Any] | None = None, model: Any = None
) -> Choice:
    """The cheapest spacing, horizon, degree and solver for a scene.

    Args:
        tolerance: largest displacement error, a fraction.
        scene: domain and load.
        table: of examples/studies/speed_accuracy.py; that of the project when None.
        model: pick spacing and horizon from transfers of this linear solid instead, or of a
            material's linear part: the coarsest lattice, and on it the fewest bonds, that answer
            waves as long as the scene's shortest within the tolerance, against the model at home.
            Costs are those of the table's solvers.

    The table holds models learned on a lattice, transfers of some of them from 2.5 to 10 Å,
    third-order and crystal models, `predict`, and elements for those who know the
    constants (`kind` of a row, which the reason names). Loads at least as long as `long_wave` of
    the table are held to the errors on the disks, at the scene's strain where both know it,
    shorter ones to those on the short waves; a transfer has at least the error that it agrees with
    home to at the scene's shortest wave. Costs are the measured ones: of factorisations grown with
    the power 1.5 of the unknowns, of all else in proportion to them, of conjugate gradients from a
    large domain. Of two that cost the same the more accurate is taken; a nonlinear solid only where
    no linear one keeps the tolerance.

    Raises InputError for a wave shorter than any measured, or a tolerance that nothing keeps.
    """
    if not is_positive(tolerance):
        raise InputError(f"tolerance: expected a fraction > 0, got {tolerance!r:.60}")
    table = shipped_table() if table is None else table
    if model is not None:
        return _of_transfers(linear_part(model, "choose_model"), tolerance, scene, table)
    if scene.shortest_wave < table["short_wave"]:
        raise InputError(
            f"scene: waves of {scene.shortest_wave:.6g} Å were not measured; the shortest are "
            f"{table['short_wave']:.6g} Å"
        )
    short = scene.shortest_wave < table["long_wave"]
    ways = _ways(table, scene, "waves" if short else "disks")
    good = [way for way in ways if way.error <= tolerance]
    if not good:
        best = min((way.error for way in ways), default=math.inf)
        raise InputError(
            f"tolerance: no measured model comes within {100 * tolerance:g} % on such loads; the "
            f"best has {100 * best:.2g} %"
        )
    enough = [way for way in good if way.answer != "nonlinear"]
    way = min(enough if any(way.answer == "linear" for way in good) else good)
    row = table["rows"][way.number]
    kind = "short waves" if short else "long waves"
    at = "" if scene.strain is None else f" at |H| = {100 * scene.strain:.2g} %"
    what = f"δ = {row['horizon']:.4g} Å, M = {row['degree']} ({row['kind']})"
    suffice = local = ""
    if way.answer == "elements":
        what = f"{row['label'].split(',')[0]} with known constants"
        suffice = "Local elements suffice: "
    elif way.answer != "linear" or row["method"] == "rest":
        what = str(row["label"])
    if not suffice and (elements := [each for each in good if each.answer == "elements"]):
        local = f" Local elements suffice too: {table['rows'][min(elements).number]['label']}."
    reason = (
        f"{suffice}h = {row['spacing']:g} Å, {what} by {way.method} is the cheapest of {len(good)} "
        f"measured ways within {100 * tolerance:g} % on {kind}{at}: {100 * way.error:.2g} %, about "
        f"{way.seconds:.2g} s for {way.nodes:.0f} nodes.{local}"
    )
    return Choice(
        row["spacing"], row["horizon"], row["degree"], way.method, way.error, way.seconds, reason,
        way.answer, row.get("label", ""),
    )  # fmt: skip


def _of_transfers(model: Model, tolerance: float, scene: Scene, table: dict[str, Any]) -> Choice:
    """The coarsest lattice that a model transfers to within the tolerance.

    Raises InputError for waves that the model's data did not hold, or a tolerance that no lattice
    keeps, with the last attempt's reason.
    """
    wave = scene.shortest_wave
    reason = InputError("scene: no lattice was tried")
    for number in range(SPACINGS):
        spacing = float(f"{wave / 3 / RATIO**number:.2g}")
        try:
            transferred = on_lattice(
                model, spacing=spacing, tolerance=tolerance, shortest_wave=wave
            )
        except InputError as error:
            reason = error
            continue
        nodes, method, seconds = _way(spacing, scene, table)
        record = transferred.provenance["transfer"]
        pairs = zip(record["wavelength"], record["error"])
        reached = max((e for length, e in pairs if length >= wave), default=tolerance)
        words = (
            f"{record['statement']}; the coarsest of {number + 1} lattices within "
            f"{100 * tolerance:g} % of the model on its own lattice on waves of {wave:g} "
            f"{symbols(model.units)[0]}, by {method}, "
            f"about {seconds:.2g} s for {nodes:.0f} nodes."
        )
        return Choice(
            spacing, transferred.horizon, transferred.degree, method, reached, seconds, words
        )
    raise reason


def _way(spacing: float, scene: Scene, table: dict[str, Any]) -> tuple[float, str, float]:
    """Nodes of a scene, how they are solved for, and in how many seconds."""
    nodes = math.prod(length / spacing for length in scene.size)
    method = cheapest_method(int(nodes), box=scene.rectangle, stiff=scene.stiff)
    if nodes > DIRECT:
        iterated = "sine" if scene.rectangle else "multigrid"
        return nodes, method, table["seconds_per_node"][iterated] * nodes
    row = next(row for row in table["rows"] if row["method"] == "lu")
    whole = row["disks_setup"] + row["disks_solve"]
    return nodes, method, whole * (nodes / row["disks_nodes"]) ** LU_POWER
