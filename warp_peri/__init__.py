"""Continuum laws learned from molecular data and measurement, proven and solved, on NVIDIA Warp.

One pattern for every law:

    fit = warp_peri.fit(samples, warp_peri.LPS(horizon=20.0))
    solution = warp_peri.solve(fit.material, warp_peri.Dirichlet(points, b, u))
    warp_peri.save("material.json", fit.material)

Names are imported on first use, so that neither torch nor Warp is loaded before it is needed.
"""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from sys import modules
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warp_peri import atoms as atoms
    from warp_peri import certificates as certificates
    from warp_peri import crystals as crystals
    from warp_peri import diffusion as diffusion
    from warp_peri import export as export
    from warp_peri import fracture as fracture
    from warp_peri import hyperelastic as hyperelastic
    from warp_peri import influence as influence
    from warp_peri import methods as methods
    from warp_peri import neural as neural
    from warp_peri import plots as plots
    from warp_peri import prediction as prediction
    from warp_peri import runtime as runtime
    from warp_peri import transfers as transfers
    from warp_peri.atoms.crystal_fit import fit_crystal as fit_crystal
    from warp_peri.core.proof import certify as certify
    from warp_peri.core.torch_bridge import TorchModule as TorchModule
    from warp_peri.errors import InputError as InputError
    from warp_peri.fitting.diagnose import diagnose as diagnose
    from warp_peri.fitting.evaluate import evaluate as evaluate
    from warp_peri.fracture.problems import Cracked as Cracked
    from warp_peri.materials.crystal_fit import Crystal as Crystal
    from warp_peri.materials.density import Density as Density
    from warp_peri.materials.density import DensityMaterial as DensityMaterial
    from warp_peri.materials.lps import LPSMaterial as LPSMaterial
    from warp_peri.materials.lps_fit import LPS as LPS
    from warp_peri.materials.lps_law import Bernstein as Bernstein
    from warp_peri.materials.third_order import ThirdOrder as ThirdOrder
    from warp_peri.points.dataset import Dataset as Dataset
    from warp_peri.points.mesh import Mesh as Mesh
    from warp_peri.points.points import Points as Points
    from warp_peri.points.points import Samples as Samples
    from warp_peri.prediction.answer import predict as predict
    from warp_peri.problems import Body as Body
    from warp_peri.problems import Dirichlet as Dirichlet
    from warp_peri.problems import Periodic as Periodic
    from warp_peri.problems import simulate as simulate
    from warp_peri.problems import solve as solve
    from warp_peri.solvers.motion import Motion as Motion
    from warp_peri.solvers.solution import CG as CG
    from warp_peri.solvers.solution import Direct as Direct
    from warp_peri.solvers.solution import Newton as Newton
    from warp_peri.solvers.solution import Solution as Solution
    from warp_peri.verbs import fit as fit
    from warp_peri.verbs import load as load
    from warp_peri.verbs import save as save

__version__ = "0.2.0"


def lazy(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Make `__getattr__`, `__dir__` and `__all__` of a package that is being imported (PEP 562),
    from the names that its `__init__` imports for type checkers; `__all__` leaves modules out."""
    home: dict[str, str] = {}
    for node in ast.walk(ast.parse(Path(str(modules[package].__file__)).read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.col_offset:  # below `if TYPE_CHECKING`
            home |= {alias.name: str(node.module) for alias in node.names}

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if home[name] == package:
            return import_module(f"{package}.{name}")
        return vars(modules[package]).setdefault(name, getattr(import_module(home[name]), name))

    names = sorted(name for name, module in home.items() if module != package)
    return get, lambda: sorted(home), names


if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these
    __getattr__, __dir__, __all__ = lazy(__name__)
