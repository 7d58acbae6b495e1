"""Sheets of atoms with a known fault, and the cause that the diagnosis names.

    python examples/studies/diagnosis.py --json        # extra: data

LAMMPS makes small sheets of graphene and boron nitride, each with one thing (the mixed one has
two) that a uniform, isotropic, linear solid cannot have: they are stretched, sheared, have holes or
two phases, carry rough or large loads, or move at 300 K. Each is smoothed, fitted and diagnosed.
The last five were chosen before any was looked at, and took no part in setting up the diagnosis;
the six before them were such once, and have been looked at since.
"""

import json
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

from tools.graphene import THICKNESS, bond_length, sheet
from tools.lammps_session import LammpsSession
from tools.options import Options
from tools.statics import Statics
from warp_peri import LPS, Bernstein, Points, Samples, diagnose, fit
from warp_peri.atoms import coarse_grain, smoothing_matrix
from warp_peri.structures.calculators import potential_file

CELLS = (24, 14)
"""Four-atom cells of a sheet: about 60 Å each way."""
SPACING, RADIUS, HORIZON, DEGREE = 5.0, 10.0, 15.0, 6
INTERIOR = 25.0
REACH = INTERIOR + 2 * HORIZON
LOADS, STRAIN = 24, 0.002
LONGEST, SHORTEST, ROUGH = 60.0, 24.0, 13.0
"""Waves of the loads [Å]; rough loads go down to the last."""
STEPS, SKIPPED, QUIET = 40, 20, 8
"""Time steps of 0.5 fs a load, those left out at the begin, and fields of noise alone."""
BATH: dict[str, Any] = {"steps": STEPS, "timestep": 5e-4, "damping": 0.1}


@dataclass(frozen=True)
class Sheet:
    """A sheet and what is wrong with it.

    `name`: of the sheet; `causes`: put in; names of `Diagnosis.shares`; `elements`: of the matrix,
    in turn; `stretch`: of the box along x and y; `turn`: angle of the nodes' axes against the box;
    `missing`: share of the atoms that are taken out, in pairs; `phase`: where boron nitride
    replaces graphene: "band", "disk" or nowhere; `strain`: largest change of a bond's length by a
    load; `shortest`: wave of the loads [Å]; `temperature`: [K]; 0 for statics.
    """

    name: str
    causes: tuple[str, ...]
    elements: tuple[str, ...] = ("C",)
    stretch: tuple[float, float] = (1.0, 1.0)
    turn: float = 0.0
    missing: float = 0.0
    phase: str = ""
    strain: float = STRAIN
    shortest: float = SHORTEST
    temperature: float = 0.0


NITRIDE, BOTH = ("B", "N"), ("anisotropy", "heterogeneity")
SHEETS = (
    Sheet("stretched", ("anisotropy",), stretch=(1.1, 1.0)),
    Sheet("sheared", ("anisotropy",), stretch=(1.06, 0.96), turn=np.pi / 4),
    Sheet("vacancies", ("heterogeneity",), missing=0.02),
    Sheet("two phases", ("heterogeneity",), phase="band"),
    Sheet("rough loads", ("dispersion",), shortest=ROUGH),
    Sheet("nonlinear", ("nonlinearity",), strain=0.02),
    Sheet("noisy", ("noise",), temperature=300.0),
    Sheet("mixed", BOTH, stretch=(1.1, 1.0), missing=0.02),
    Sheet("boron nitride, stretched", ("anisotropy",), elements=NITRIDE, stretch=(1.0, 1.08)),
    Sheet("a disk of boron nitride", ("heterogeneity",), phase="disk"),
    Sheet("boron nitride, nonlinear", ("nonlinearity",), elements=NITRIDE, strain=0.02),
    Sheet("boron nitride, mixed", BOTH, elements=NITRIDE, stretch=(1.0, 1.1), missing=0.015),
    Sheet("tight, nonlinear", ("nonlinearity",), stretch=(1.03, 1.03), strain=0.015),
    Sheet("boron nitride, rough loads", ("dispersion",), elements=NITRIDE, shortest=ROUGH),
)
UNSEEN = (
    Sheet("boron nitride, vacancies", ("heterogeneity",), elements=NITRIDE, missing=0.03),
    Sheet("stretched, nodes turned", ("anisotropy",), stretch=(1.0, 1.09), turn=np.pi / 6),
    Sheet(
        "tight boron nitride, nonlinear",
        ("nonlinearity",),
        elements=NITRIDE,
        stretch=(1.02, 1.02),
        strain=0.02,
    ),
    Sheet("tight, rough loads", ("dispersion",), stretch=(1.03, 1.03), shortest=ROUGH),
    Sheet("a disk of boron nitride, stretched", BOTH, phase="disk", stretch=(1.1, 1.0)),
)


def atoms_of(asked: Sheet) -> tuple[np.ndarray, tuple[float, float], np.ndarray, tuple[str, ...]]:
    """Positions [Å], periods, number of each atom's element, and the elements."""
    file = potential_file("BNC.tersoff")
    x, box = sheet(bond_length(file, elements=asked.elements), cells=CELLS)
    kind = np.arange(len(x)) % len(asked.elements)
    elements = asked.elements
    if asked.phase:
        inside = np.abs(x[:, 0]) < box[0] / 4
        if asked.phase == "disk":
            inside = np.linalg.norm(x, axis=1) < box[0] / 4
        elements = (*elements, *NITRIDE)
        kind = np.where(inside, len(asked.elements) + np.arange(len(x)) % 2, kind)
    if asked.missing:
        generator = np.random.default_rng(1)
        first = 2 * generator.choice(len(x) // 2, round(asked.missing * len(x) / 2), replace=False)
        kept = np.setdiff1d(np.arange(len(x)), [*first, *(first + 1)])  # whole bonds
        x, kind = x[kept], kind[kept]
    return x * asked.stretch, (box[0] * asked.stretch[0], box[1] * asked.stretch[1]), kind, elements


def loads_on(x: np.ndarray, box: tuple[float, float], shortest: float) -> np.ndarray:
    """Single waves of the box without net force, of any direction and phase; shape [S, A, 2]."""
    generator, most = np.random.default_rng(0), int(max(box) / shortest) + 1
    p = np.argwhere(np.ones((most + 1, 2 * most + 1))) - (0, most)
    k = 2 * np.pi * p / box
    length = 2 * np.pi / np.maximum(np.linalg.norm(k, axis=1), 1e-9)
    some = k[(length < 1.1 * LONGEST) & (length >= shortest)]
    out = []
    for s in range(LOADS):
        angle, phase = generator.uniform(0, 2 * np.pi, 2)
        wave = np.cos(
            x @ some[generator.permutation(len(some))[0] if s >= len(some) else s] + phase
        )
        force = wave[:, None] * (np.cos(angle), np.sin(angle))
        out.append(force - force.mean(axis=0))
    return np.array(out)


def smoothed(
    asked: Sheet, x: np.ndarray, box: tuple[float, float], u: np.ndarray, force: np.ndarray
) -> Samples:
    """Fields of the atoms on nodes whose axes are turned against the box."""
    c, s = np.cos(asked.turn), np.sin(asked.turn)
    axes = np.array([[c, -s], [s, c]])
    reach = int(np.ceil((1.5 * REACH + RADIUS) / min(box)))
    shifts = np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1))) - reach
    images = (x + (shifts * box)[:, None]).reshape(-1, 2) @ axes
    number = np.tile(np.arange(len(x)), len(shifts))
    near = (np.abs(images) < REACH + RADIUS + SPACING).all(axis=1)
    images, number = images[near], number[near]
    line = SPACING * np.arange(-round(REACH / SPACING), round(REACH / SPACING) + 1)
    nodes = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    omega = smoothing_matrix(images, nodes, radius=RADIUS, spacing=SPACING)
    u, b = coarse_grain(
        omega,
        displacement=(u @ axes)[:, number],
        force=(force @ axes)[:, number],
        node_area=SPACING**2,
        thickness=THICKNESS,
    )
    inside = (np.abs(nodes) <= INTERIOR).all(axis=1)
    return Samples(Points(nodes, inside, SPACING), u, b)


def make(asked: Sheet) -> tuple[Samples, Samples | None]:
    """The sheet under its loads, and fields of noise alone where it moves."""
    x, box, kind, elements = atoms_of(asked)
    file = potential_file("BNC.tersoff")
    with LammpsSession(x, box=box, potential=file, elements=elements, kind=kind) as session:
        statics = Statics(x, box=box, session=session)
        forces, fields = [], []
        for unit in loads_on(statics.reference, box, asked.shortest):
            linear = statics.linear_response(unit)
            small = 1e-6 / np.abs(linear).max()
            size = asked.strain * small / statics.max_bond_strain(small * linear)
            rest = statics.equilibrium(size * unit, name=asked.name, guess=size * linear)
            fields.append(rest.displacement)
            forces.append(rest.force)
        u, force, quiet = np.array(fields), np.array(forces), None
        if asked.temperature:
            still = np.zeros_like(u[0])
            u = np.array(
                [moved(session, statics, box, asked, *each) for each in zip(u, force, range(1, 99))]
            )
            seeds = range(100, 100 + QUIET)
            quiet = np.array(
                [moved(session, statics, box, asked, still, still, seed) for seed in seeds]
            )
    samples = smoothed(asked, statics.reference, box, u, force)
    if quiet is None:
        return samples, None
    return samples, smoothed(asked, statics.reference, box, quiet, 0 * quiet)


def moved(
    session: LammpsSession,
    statics: Statics,
    box: tuple[float, float],
    asked: Sheet,
    u: np.ndarray,
    force: np.ndarray,
    seed: int,
) -> np.ndarray:
    """Mean displacement [Å] of a run at temperature from rest under a load, shape [A, 2].

    Its own mean is zero.
    """
    total, begin = np.zeros_like(u), statics.reference + u
    run = session.trajectory(begin, force, temperature=asked.temperature, seed=seed, **BATH)
    for step, (x, _) in enumerate(run):
        if step >= SKIPPED:
            move = x - begin
            total += u + move - np.rint(move / box) * box
    mean: np.ndarray = total / (STEPS - SKIPPED)
    return mean - mean.mean(axis=0)


def study(sheets: Sequence[Sheet]) -> list[dict[str, Any]]:
    """What was put in and what was named, sheet by sheet."""
    rows = []
    for asked in sheets:
        begin = time.perf_counter()
        samples, quiet = make(asked)
        made = time.perf_counter() - begin
        with warnings.catch_warnings(action="ignore"):
            found = fit(samples, LPS(HORIZON, Bernstein(DEGREE)), noise=quiet, progress=False)
            diagnosis = diagnose(found.material, samples, quiet)
        named = diagnosis.causes[: len(asked.causes)]
        rows.append(
            {
                "sheet": asked.name,
                "put_in": list(asked.causes),
                "named": named,
                "right": set(named) == set(asked.causes),
                "residual": diagnosis.residual,
                "shares": diagnosis.shares,
                "sentence": diagnosis.sentence,
                "seconds": [made, time.perf_counter() - begin - made],
            }
        )
    return rows


def main() -> None:
    """Print the table, or JSON."""
    parser = Options(__doc__, json=True)
    parser.add("--only", nargs="+", help="names of sheets")
    given = parser.parse_args()
    wanted = [s for s in (*SHEETS, *UNSEEN) if not given.only or s.name in given.only]
    rows = study(wanted)
    if given.json:
        seen = {s.name for s in SHEETS}
        right = [
            sum(row["right"] for row in rows if (row["sheet"] in seen) == known)
            for known in (True, False)
        ]
        print(json.dumps({"right": right[0], "right_unseen": right[1], "sheets": rows}))
        return
    for row in rows:
        shares = ", ".join(f"{name} {100 * part:.0f}" for name, part in row["shares"].items())
        print(
            f"{row['sheet']:26}{' + '.join(row['put_in']):28}{' + '.join(row['named']):28}"
            f"{'right' if row['right'] else 'WRONG'}  leaves {100 * row['residual']:.1f} %: "
            f"{shares}  {row['seconds'][0]:.0f} + {row['seconds'][1]:.0f} s"
        )


if __name__ == "__main__":
    main()
