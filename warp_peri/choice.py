"""No more than a scene needs: the cheapest measured model and solver within a tolerance."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from warp_peri.contract import linear_part
from warp_peri.dressed.law import DressedSolid
from warp_peri.dressed.learning import transferred
from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.points.arrays import is_positive
from warp_peri.points.unit_names import symbols
from warp_peri.statics.lps import DIRECT
from warp_peri.transfer.cache import on_lattice

LU_POWER = 1.5
"""Cost of a sparse factorisation in two dimensions grows with this power of the unknowns."""
WAVES = (1.0, 1.5, 2.5, 5.0)
"""Wavelengths that a dressed solid is compared on, over the scene's shortest."""
SPACINGS, RATIO = 8, 2**0.25
"""Lattices that a model is tried on, each so much finer than the one before."""


@dataclass(frozen=True)
class Scene:
    """What is to be solved.

    Attributes:
        size: extents of the domain [Å]; where a model is given, in its unit of length.
        shortest_wave: shortest wavelength of the load, likewise.
        rectangle: whether the unknown nodes fill the box of that size.
    """

    size: tuple[float, float]
    shortest_wave: float
    rectangle: bool = False

    def __post_init__(self) -> None:
        pair = isinstance(self.size, (tuple, list, np.ndarray)) and np.ndim(self.size[:1]) == 1
        if not pair or len(self.size) != 2:
            raise InputError(f"scene: expected two extents (x, y) [Å], got size {self.size!r:.60}")
        if not all(is_positive(v) for v in (*self.size, self.shortest_wave)):
            raise InputError(
                f"scene: expected lengths > 0 Å, got size {self.size}, wave {self.shortest_wave}"
            )


@dataclass(frozen=True)
class Choice:
    """What to use, and why in one sentence.

    Attributes:
        spacing: h [Å].
        horizon: δ [Å].
        degree: M of the influence function.
        method: of `solve`.
        error: measured displacement error, a fraction.
        seconds: expected for set-up and one solve on the machine that measured.
        reason: the sentence.
    """

    spacing: float
    horizon: float
    degree: int
    method: str
    error: float
    seconds: float
    reason: str


def shipped_table() -> dict[str, Any]:
    """What the study of speed and accuracy measured on graphene: rows, and waves they hold for."""
    text = (files("warp_peri") / "speed_accuracy.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text)
    return table


def _measured(
    table: dict[str, Any], scene: Scene, name: str
) -> list[tuple[float, float, dict[str, Any], str, float]]:
    """Seconds, error, row, method and nodes of every way in a table that `solve` can go."""
    measured = []
    for row in table["rows"]:
        # What `solve` can do: its factorisations are float64.
        if row["method"] != "lu" or row["kind"] == "positive kernel":
            continue
        nodes = math.prod(length / row["spacing"] for length in scene.size)
        if nodes <= DIRECT:
            method = "lu"
            growth = nodes / row["disks_nodes"]
            seconds = (row["disks_setup"] + row["disks_solve"]) * growth**LU_POWER
        else:
            method = "sine" if scene.rectangle else "multigrid"
            seconds = table["seconds_per_node"][method] * nodes
        error = row[f"{name}_error"]
        if name == "disks" and "agrees" in row:
            error = max(error, _agreement(row["agrees"], scene.shortest_wave))
        measured.append((seconds, error, row, method, nodes))
    return measured


def _agreement(pairs: list[list[float]], wave: float) -> float:
    """The level that a transfer agrees with home to on a wave; pairs of level and length [Å]."""
    return min((level for level, length in pairs if length <= wave), default=math.inf)


def choose_model(
    *,
    tolerance: float,
    scene: Scene,
    table: dict[str, Any] | None = None,
    model: Any = None,
) -> Choice:
    """The cheapest spacing, horizon, degree and solver for a scene.

    Args:
        tolerance: largest displacement error, a fraction.
        scene: domain and load.
        table: of examples/studies/speed_accuracy.py; that of the project when None.
        model: pick spacing and horizon from transfers of this linear solid instead, or of a
            material's linear part: the coarsest lattice, and on it the fewest bonds, that answer
            waves as long as the scene's shortest within the tolerance, against the model at home;
            of a dressed solid the coarsest to which its G is carried so. Costs are those of the
            table's solvers.

    The table holds models learned on a lattice, and transfers of some of them from 2.5 to 10 Å
    (`kind` of a row, which the reason names). Loads at least as long as `long_wave` of the table
    are held to the errors on the disks, shorter ones to those on the short waves; a transfer has
    at least the error that it agrees with home to at the scene's shortest wave. Costs are the
    measured ones: of LU grown with the power 1.5 of the unknowns, of conjugate gradients in
    proportion to them from a large domain, where the horizon hardly matters. Of two that cost the
    same the more accurate is taken.

    Raises InputError for a wave shorter than any that was measured, or a tolerance that is no
    number above zero or that nothing in the table keeps.
    """
    if not is_positive(tolerance):
        raise InputError(f"tolerance: expected a fraction > 0, got {tolerance!r:.60}")
    table = shipped_table() if table is None else table
    if isinstance(model, DressedSolid):
        if model.dimension != 2:
            raise InputError("choose_model: expected a sheet, got a dressed solid in space")
        return _of_dressed(model, tolerance, scene, table)
    if model is not None:
        return _of_transfers(linear_part(model, "choose_model"), tolerance, scene, table)
    if scene.shortest_wave < table["short_wave"]:
        raise InputError(
            f"scene: waves of {scene.shortest_wave:.6g} Å were not measured; the shortest are "
            f"{table['short_wave']:.6g} Å"
        )
    short = scene.shortest_wave < table["long_wave"]
    name = "waves" if short else "disks"
    measured = _measured(table, scene, name)
    good = [way for way in measured if way[1] <= tolerance]
    if not good:
        best = min((way[1] for way in measured), default=math.inf)
        raise InputError(
            f"tolerance: no measured model comes within {100 * tolerance:g} % on such loads; the "
            f"best has {100 * best:.2g} %"
        )
    seconds, error, row, method, nodes = min(good, key=lambda way: way[:2])
    kind = "short waves" if short else "long waves"
    reason = (
        f"h = {row['spacing']:g} Å, δ = {row['horizon']:.4g} Å, M = {row['degree']} "
        f"({row['kind']}) by {method} is the cheapest of {len(good)} measured ways within "
        f"{100 * tolerance:g} % on {kind}: {100 * error:.2g} %, about {seconds:.2g} s for "
        f"{nodes:.0f} nodes."
    )
    return Choice(row["spacing"], row["horizon"], row["degree"], method, error, seconds, reason)


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
            f"{100 * tolerance:g} % of the model at home on waves of {wave:g} "
            f"{symbols(model.units)[0]}, by {method}, "
            f"about {seconds:.2g} s for {nodes:.0f} nodes."
        )
        return Choice(
            spacing, transferred.horizon, transferred.degree, method, reached, seconds, words
        )
    raise reason


def _of_dressed(law: DressedSolid, tolerance: float, scene: Scene, table: dict[str, Any]) -> Choice:
    """The coarsest nodes on which a dressed solid answers the scene's waves as at home."""
    wave, reached = scene.shortest_wave, math.inf
    angle = np.linspace(0, np.pi, 24, endpoint=False)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    k = np.concatenate([2 * np.pi / (wave * longer) * along for longer in WAVES])
    home = law.symbol(k)
    for number in range(SPACINGS):
        spacing = float(f"{wave / 3 / RATIO**number:.2g}")
        there = transferred(law, spacing)
        off = np.linalg.solve(there.symbol(k), home) - np.eye(2)
        reached = float(np.linalg.norm(off, 2, axis=(1, 2)).max())
        if reached > tolerance:
            continue
        nodes, method, seconds = _way(spacing, scene, table)
        words = (
            f"a base of {law.base} under a G of {2 * len(law.steps)} neighbours on {spacing:g} "
            f"{symbols(law.units)[0]}: the coarsest of {number + 1} lattices within "
            f"{100 * tolerance:g} % of the law at home on waves of {wave:g} and longer "
            f"({100 * reached:.2g} %), about {seconds:.2g} s for {nodes:.0f} nodes."
        )
        return Choice(spacing, there.horizon, 0, method, reached, seconds, words)
    raise InputError(
        f"tolerance: no lattice down to {spacing:g} {symbols(law.units)[0]} answers waves of "
        f"{wave:g} within {100 * tolerance:g} %; the last is {100 * reached:.2g} % off"
    )


def _way(spacing: float, scene: Scene, table: dict[str, Any]) -> tuple[float, str, float]:
    """Nodes of a scene, how they are solved for, and in how many seconds."""
    nodes = math.prod(length / spacing for length in scene.size)
    method = "lu" if nodes <= DIRECT else "sine" if scene.rectangle else "multigrid"
    if method != "lu":
        return nodes, method, table["seconds_per_node"][method] * nodes
    row = next(row for row in table["rows"] if row["method"] == "lu")
    whole = row["disks_setup"] + row["disks_solve"]
    return nodes, method, whole * (nodes / row["disks_nodes"]) ** LU_POWER
