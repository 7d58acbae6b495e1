"""Local elasticity on the nodes of a set: the solid without a horizon that a law is held against.

    python examples/local_elasticity.py                 on scenes that no fit saw
    python examples/local_elasticity.py --data data/graphene_0K.h5 --model M.json N.json
    python examples/local_elasticity.py --data data/graphene_0K.h5 --third-order --sets val test
    python examples/local_elasticity.py --waves --model M.json N.json
    python examples/local_elasticity.py --data runs/boron_nitride/bn.h5 \\
        --model runs/boron_nitride/model/model.json --true 0.2572 0.2849

Prints E_u [%] by set of laws of sheets, of local elasticity with the moduli that are true, and with
those of each law's long waves; where the file has the same loads reversed, also the part of even
order, which no linear law follows. The scenes are of tools/make_scenes.py. Biquadratic elements
half a spacing wide; loads and displacements of the collar go to points between the nodes by
ten-point interpolation. With --third-order also of local third-order elasticity with the five
constants of graphene's potential, on these elements and on linear ones between the nodes. With
--waves it is by the length of a wave in graphene, in nodes 5 Å apart,
against the force constants of the atoms, the mean over directions.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from scipy.ndimage import binary_erosion, convolve1d

import warp_peri as wp
from examples.crystals import local
from examples.prose import table
from examples.studies.fem_rival import elastic_solver
from tools import graphene_phonons
from tools.elastic import cubic_constants
from tools.graphene import bond_length
from tools.options import Options
from warp_peri import InputError, Points, Samples
from warp_peri.core.elastic import from_voigt, plane_isotropic, voigt
from warp_peri.errors import exit_status
from warp_peri.micromodulus import Crystal, tensors_of
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import PointsLike
from warp_peri.third_order.material import CUBIC

MODEL = ROOT / "runs" / "graphene_0K" / "model.json"
GRAPHENE, SCENES = (ROOT / "data" / f"graphene_0K{end}.h5" for end in ("", "_scenes"))
USUAL = ("train", "val", "test", "1", "3")
"""Ends of the names of the sets that are taken where none is asked for."""
FINER = 4
"""Points of elements, which are two of them wide, in a spacing."""
SPACING, DIRECTIONS = 5.0, 24
LENGTHS = (20, 10, 6, 5, 4, 3.5, 3, 2.5, 2)
"""Of waves, in spacings."""
BETWEEN = np.zeros(19)
BETWEEN[::2] = np.array([35, -405, 2268, -8820, 39690, 39690, -8820, 2268, -405, 35]) / 2**16
BETWEEN[9] = 1.0
"""Ten-point interpolation half way, on points twice as dense."""


def errors_of_local(
    samples: Samples, C: np.ndarray, third: Sequence[float] | None = None
) -> np.ndarray:
    """E_u of local elasticity by sample: relative ℓ2 errors on the interior, shape [S].

    Args are as of local_solver.
    """
    return errors_of(local_solver(samples, C, third)(samples.loads, samples.u), samples)


def errors_of(inner: np.ndarray, samples: Samples) -> np.ndarray:
    """Relative ℓ2 errors, shape [S], of displacements on the interior [S, I, 2]."""
    true = samples.u[:, samples.interior]
    wrong, size = (np.linalg.norm(f.reshape(len(f), -1), axis=1) for f in (inner - true, true))
    return np.asarray(wrong / size)


def potential_constants() -> list[float]:
    """t3, tq2 and q3 [TPa] of graphene's potential."""
    constants = cubic_constants(bond_length())
    return [constants[name] for name in CUBIC]


def third_order_rows(sets: dict[str, Samples], C: np.ndarray) -> dict[str, dict[str, float]]:
    """E_u of local third-order elasticity with the potential's constants, by elements and set."""
    third = potential_constants()
    found: dict[str, dict[str, float]] = {"quadratic": {}, "linear": {}}
    for name, samples in sets.items():
        on_nodes = elastic_solver(samples.points, order=1, C=C, third=third)
        found["linear"][name] = float(errors_of(on_nodes(samples.loads, samples.u), samples).mean())
        found["quadratic"][name] = float(errors_of_local(samples, C, third).mean())
    return found


def local_solver(
    points: PointsLike, C: np.ndarray, third: Sequence[float] | None = None
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Assemble and factorise; the result solves for u on the interior, shape [..., I, 2].

    Args:
        points: a square lattice with a collar of five nodes at least.
        C: Voigt matrix of plane elasticity [stress], along the nodes' axes, shape [3, 3].
        third: t3, tq2 and q3 [stress] of a crystal whose zigzag direction is the nodes' x axis;
            None for linear elasticity.
    """
    steps, axes = lattice_steps(points)
    place = FINER * (steps - steps.min(axis=0))
    shape = tuple(place.max(axis=0) + 1)
    body = np.zeros(shape, bool)  # the elements that touch the interior
    for corner in np.ndindex(2 * FINER + 1, 2 * FINER + 1):
        body[tuple((place[points.interior] + corner - FINER).T)] = True
    free = binary_erosion(body, np.ones((3, 3)))
    free[tuple(place[~points.interior].T)] = False
    spacing = points.spacing / FINER
    fine = Points(np.argwhere(body) * spacing, free[body], spacing)
    factorised = elastic_solver(fine, order=2, C=C, third=third)
    unknown = np.zeros(shape, int)
    unknown[free] = np.arange(np.count_nonzero(free))
    nodes = unknown[tuple(place[points.interior].T)]

    def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
        stacks = (np.reshape(field, (-1, *field.shape[-2:])) for field in (b, u))
        load, held = (_refined(field @ axes, place, shape)[:, body] for field in stacks)
        found = factorised(load, held)[:, nodes] @ axes.T
        return found.reshape(*u.shape[:-2], *found.shape[1:])

    return solve


def _refined(field: np.ndarray, place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A field [S, N, 2] on points a quarter of a spacing apart, [S, *shape, 2]."""
    grid = np.zeros((len(field), *shape, 2))
    grid[:, place[:, 0], place[:, 1]] = field
    wide = np.zeros(2 * len(BETWEEN) - 1)
    wide[::2] = BETWEEN  # half way between nodes first
    for weights in (wide, BETWEEN):
        for axis in (1, 2):
            grid = convolve1d(grid, weights, axis=axis, mode="constant")
    return grid


def moduli_of(material: Any, spacing: float) -> np.ndarray:
    """Voigt matrix [3, 3] of the long waves of a law of sheets, of its linear part if it has one.

    Raises InputError for a law that has none.
    """
    law = getattr(material, "linear", material)
    law = tensors_of(law, spacing) if isinstance(law, wp.Model) else law
    if not isinstance(law, Crystal) or law.dimension != 2:
        raise InputError(f"model: expected a law of sheets that is linear, got {law!r:.80}")
    return voigt(law.tensor())


def errors_by_law(
    materials: dict[str, Any],
    sets: dict[str, Samples],
    true: np.ndarray,
    backs: dict[str, Samples] | None = None,
) -> dict[str, dict[str, float]]:
    """E_u by law and set: each law, local elasticity with its moduli, and with the true ones.

    Of sets with the same loads the other way round, `backs`, also the part of even order.
    """
    found: dict[str, dict[str, float]] = {}
    for name, samples in sets.items():
        tried = [("", samples, np.ones(len(samples)))]
        if backs and name in backs:
            tried.append((", of even order", *even_part(samples, backs[name])))
        for end, given, share in tried:

            def put(label: str, errors: Any, end: str = end, name: str = name, by: Any = share):
                found.setdefault(label + end, {})[name] = float(np.mean(by * errors))

            for label, material in materials.items():
                allowed = {"allow_uncertified": True} if isinstance(material, wp.Model) else {}
                put(label, wp.evaluate(material, given, **allowed)["E_u_samples"])
                C = moduli_of(material, samples.spacing)
                put(f"local elasticity, moduli of {label}", errors_of_local(given, C))
            put("local elasticity, true moduli", errors_of_local(given, true))
    return found


def even_part(samples: Samples, back: Samples) -> tuple[Samples, np.ndarray]:
    """Sum of the answers to loads and to their reverse, and by load its size over theirs, [S].

    A linear law has no such part but what it continues of the collar's: the errors of both its
    answers are together no less than what it misses of this one.

    Args:
        samples: answers of a nonlinear solid.
        back: answers to the same loads the other way round, of any size.
    """
    b, reverse = samples.loads, back.loads
    ratio = -np.sum(b * b, axis=(1, 2)) / np.sum(b * reverse, axis=(1, 2))
    other = ratio[:, None, None] * back.u
    both = b + ratio[:, None, None] * reverse
    even = dataclasses.replace(samples, u=samples.u + other, b=both)
    sizes = [
        np.linalg.norm(u[:, samples.interior].reshape(len(u), -1), axis=1)
        for u in (even.u, samples.u, other)
    ]
    return even, sizes[0] / (sizes[1] + sizes[2])


def errors_by_wave(materials: dict[str, Any], true: np.ndarray) -> dict[str, list[float]]:
    """E_u by law and length of the wave, in spacings as in LENGTHS, mean over loads."""
    atoms = graphene_phonons.force_constants()
    turn = np.linspace(0, np.pi, DIRECTIONS, endpoint=False)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    laws: dict[str, Callable[[np.ndarray], np.ndarray]] = {}
    for label, material in materials.items():
        law = getattr(material, "linear", material)
        laws[label] = (tensors_of(law, SPACING) if isinstance(law, wp.Model) else law).symbol
    laws["local elasticity, true moduli"] = local(from_voigt(true))
    found: dict[str, list[float]] = {label: [] for label in laws}
    for length in LENGTHS:
        k = 2 * np.pi / (SPACING * length) * along
        u = np.linalg.inv(atoms.effective(k))  # under a load along each axis
        for label, D in laws.items():
            off = np.linalg.norm(np.linalg.inv(D(k)) - u, axis=1) / np.linalg.norm(u, axis=1)
            found[label].append(float(off.mean()))
    return found


def study(given: Any) -> str:
    """The table for the files that were asked for."""
    materials = {m.stem: wp.load(m) for m in given.model}
    if given.waves:
        truth = wp.load(GRAPHENE).provenance["truth"]
        waves = errors_by_wave(materials, plane_isotropic(truth["lambda"], truth["mu"]))
        rows = [[law, *(f"{100 * e:.2f}" for e in row)] for law, row in waves.items()]
        return table(["length / nodes", *(f"{length:g}" for length in LENGTHS)], rows)
    data = wp.load(given.data)
    some = given.sets or sorted(
        (n for n in data if n.rsplit("_")[-1] in USUAL),
        key=lambda n: USUAL.index(n.rsplit("_")[-1]),
    )
    if missing := sorted(set(some) - set(data)):
        raise InputError(f"sets: expected some of {', '.join(data)}, got {', '.join(missing)}")
    true = given.true
    if true is None:  # of the file, or of graphene at rest, of which the scenes are
        truth = data.provenance.get("truth") or wp.load(GRAPHENE).provenance["truth"]
        true = truth["lambda"], truth["mu"]
    ways = {name: "_reversed_".join(name.rsplit("_", 1)) for name in some}
    backs = {name: data[back] for name, back in ways.items() if back != name and back in data}
    sets = {name: data[name] for name in some}
    found = errors_by_law(materials, sets, plane_isotropic(*true), backs)
    if given.third_order:
        for elements, row in third_order_rows(sets, plane_isotropic(*true)).items():
            found[f"local third-order elasticity, true constants, {elements} elements"] = row
    if given.json:
        return json.dumps(found)
    cells = [[law, *(f"{100 * e:.2f}" for e in row.values())] for law, row in found.items()]
    return table(["", *some], cells)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True)
    parser.add("--model", type=Path, nargs="+", default=[MODEL], metavar="FILE", help="laws")
    parser.add("--data", type=Path, default=SCENES, metavar="FILE", help="samples of a sheet")
    parser.add("--waves", action="store_true", help="by the length of a wave")
    parser.add("--third-order", action="store_true", help="local elasticity of third order, too")
    parser.add("--sets", nargs="+", metavar="NAME", help="of the file")
    parser.add(
        "--true", type=float, nargs=2, metavar=("LAMBDA", "MU"), help="by default the file's"
    )
    given = parser.parse_args(arguments)
    return exit_status(lambda: print(study(given)))


if __name__ == "__main__":
    sys.exit(main())
