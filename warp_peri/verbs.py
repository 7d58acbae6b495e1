"""The verbs of the library: fit, solve, simulate, load, save."""

from __future__ import annotations

import os
from collections.abc import Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import warp_peri.fitting as fitting
from warp_peri.core.record import load as load_record
from warp_peri.errors import ALONE, InputError, agreed
from warp_peri.files.atomic import check_regular, write_json
from warp_peri.fitting.settings import Fit
from warp_peri.points.arguments import check_flag, check_mapping, is_piece, typed
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.mesh_files import load_mesh
from warp_peri.points.points import Samples
from warp_peri.points.unit_names import Units
from warp_peri.protocols import offered, taken, uncompiled
from warp_peri.solvers.motion import Motion, refuse_learning
from warp_peri.solvers.solution import Solution, Solver, told

if TYPE_CHECKING:
    from warp_peri.materials.crystal_fit import Crystal
    from warp_peri.materials.lps_fit import LPS
    from warp_peri.materials.third_order import ThirdOrder

Sets = Samples | Dataset | Sequence[Samples]


@overload
def fit(samples: Sets, law: LPS | Crystal | ThirdOrder, **options: Any) -> Fit: ...
@overload
def fit(samples: Any, law: Any, **options: Any) -> Any: ...
def fit(samples: Any, law: Any = None, **options: Any) -> Any:
    """Learn a material from samples.

    Args:
        samples: one set or several; of a Dataset `train`, or its only set.
        law: what may be learned, and how: LPS(horizon, …), ThirdOrder(Crystal(…)),
            hyperelastic.Hyperelastic(…).
        options: of its `learn`; all take `progress`, linear solids `noise`: fields of noise
            alone on the nodes of each training set.

    Returns a fit with `material`, and with `certificate` and `history` where the model has them.
    Warns where data ask for another kind of solid, and for which. Raises InputError for input that
    cannot be used, RuntimeError where a search fails.

    >>> round(wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).material.mu, 3)
    0.7
    """
    learned = offered(
        law, "learn", "fit", "a model: LPS(…), ThirdOrder(…), hyperelastic.Hyperelastic(…)"
    )
    if not any(one.kind is one.VAR_KEYWORD for one in signature(learned).parameters.values()):
        (options,) = taken(options, "fit", learned)
    found = learned(samples, **options)
    if isinstance(found, Fit):
        fitting.diagnose.warn_of_kind(found.material, samples, options.get("noise"))
    return found


PROBLEMS = "a problem: Dirichlet(points, b, u), Periodic(points, b), Body(mesh, …) or Cracked(…)"


def solve(material: Any, problem: Any, *, solver: Solver = None, **options: Any) -> Solution:
    """Solve for the equilibrium of a material.

    Args:
        material: what `fit` or `load` gave, or its operator, `material.on(points)`, where the same
            points are solved on again.
        problem: Dirichlet(points, b, u), Periodic(points, b), Body(mesh, …), Cracked(…).
        solver: Direct(…), CG(…) or Newton(…), as the material has them; chosen by default.
        options: transfer=False refuses points that the material itself holds no certificate for;
            allow_uncertified=True takes its own numbers there, with a warning; parameters={name:
            tensor} of the operator's `learnable`, which the answer is then differentiable in.

    Returns the solution, with its residual, what is proven of it, and what was warned of. Of
    tensors in a Dirichlet its u is differentiable, along the branch of equilibria that it lies on.
    Raises InputError for what does not fit, naming what was expected, and for a gradient that is
    asked for and not had.

    >>> wp.solve(model, wp.Dirichlet(points, b[0], u[0])).residual < 1e-8
    True
    """
    solved = offered(problem, "solved", "solve", PROBLEMS)
    _check(problem, options, "solve")
    if _on_ranks(problem):
        return told(lambda: problem.points.solve(material, problem, solver, options))
    return told(uncompiled(lambda: solved(material, solver, options)))


def simulate(material: Any, problem: Any, **options: Any) -> Motion:
    """Solve for the motion of a material: waves, growing cracks, loads that rise slowly, flow.

    Args:
        material: as for `solve`.
        problem: what is given; its displacement is that of the start.
        options: of the material's motion: `step` [ps] and `steps`, `density` [kg/m³], `every`
            (steps between two records), `record` (nodes), `checkpoint`, `progress`; see the `moved`
            of the problem.

    Returns times, histories by name, the fields at the end. Waves, heat and coupled fields of torch
    tensors are differentiable, in `parameters` too: see solvers.adjoint. Raises InputError for what
    does not fit, and for a step that is not proven stable.

    >>> start = wp.Dirichlet(points, b[0], u[0])
    >>> wp.simulate(model, start, density=2e3, step=0.005, steps=4).u.shape
    (441, 2)
    """
    moved = offered(
        problem, "moved", "simulate", "a problem that moves, as Dirichlet(points, b, u)"
    )
    _check(problem, options, "simulate")
    if _on_ranks(problem):
        return problem.points.move(material, problem, options)  # type: ignore[no-any-return]
    return uncompiled(moved)(material, options)  # type: ignore[no-any-return]


FLAGS = {"transfer", "allow_uncertified"}
"""Options that are True or False."""


def _check(problem: Any, options: dict[str, Any], verb: str) -> None:
    """Raise InputError, on all ranks, for options of another kind than their names say, and for
    tensors whose gradient the problem does not have."""
    with agreed(problem.points.comm if _on_ranks(problem) else ALONE):
        for name in FLAGS & options.keys():
            check_flag(name, options[name])
        for name in {"parameters", "watch"} & options.keys():
            if options[name] is not None:
                check_mapping(name, options[name])
        if _on_ranks(problem) or not hasattr(problem, "learns"):
            refuse_learning(problem, options, verb)


def _on_ranks(problem: Any) -> bool:
    """Whether a problem's points are a rank's piece of a body."""
    return is_piece(getattr(problem, "points", None))


HDF5 = b"\x89HDF\r\n\x1a\n"


@typed
def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Any:
    """Read a data set (HDF5), a material (JSON) or a mesh (as `points.mesh_files.load_mesh`).

    Args:
        path: of the file.
        units: names of the units of length and stress to convert to; by default those of the file.

    Raises InputError naming the file and what is wrong with it, and for units that no factor leads
    to, or of what has none.

    >>> wp.save("model.json", model)
    >>> wp.load("model.json", units=("nm", "GPa")).mu
    700.0
    """
    path = Path(path)
    check_regular(path)
    try:
        with open(path, "rb") as file:
            head = file.read(len(HDF5))
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(f"{path}: {reason}") from None
    if head == HDF5 and path.suffix.lower() not in (".med", ".h5m"):  # meshes, of Salome and MOAB
        return load_dataset(path, units=units)
    if path.suffix.lower() == ".json" or head.lstrip()[:1] == b"{":
        loaded = load_record(path)
    else:
        loaded = load_mesh(path)
    if units is None:
        return loaded
    return offered(loaded, "in_units", "units", "a file with units of its own")(units)


@typed
def save(path: str | os.PathLike[str], given: Any) -> None:
    """Write a data set or a material, whole or not at all; `load` reads it again.

    Args:
        path: of the file; .h5 for a data set, .json for a material.
        given: a Dataset, or a material.

    Raises InputError for what no file is made of, OSError where the file cannot be written.

    >>> wp.save("data.h5", wp.Dataset({"train": samples}, thickness=3.35, density=2200.0))
    """
    if isinstance(given, Dataset):
        return save_dataset(path, given)
    content = offered(given, "content", "save", "a data set or a material")
    if hasattr(given, "save"):  # some keep weights beside
        given.save(path)
    else:
        write_json(path, content())
