"""Linear peridynamic solids learned from molecular data, on NVIDIA Warp.

The names below are imported on first use, so that neither torch nor Warp is loaded before it is
needed.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warp_peri import dumps as dumps
    from warp_peri import export as export
    from warp_peri import shapes as shapes
    from warp_peri import stress as stress
    from warp_peri.certificate import Certificate, certify
    from warp_peri.choice import Choice, Scene, choose_model
    from warp_peri.coarse_graining import coarse_grain, smoothing_matrix
    from warp_peri.dataset import Dataset, PointSet, load_dataset, save_dataset
    from warp_peri.dynamics import Motion, critical_time_step, velocity_verlet
    from warp_peri.equilibrium import equilibrium
    from warp_peri.errors import InputError
    from warp_peri.launch import set_threads
    from warp_peri.model import Model, load_model
    from warp_peri.operator import LPSOperator
    from warp_peri.shapes import InfluenceFunction
    from warp_peri.solvability import Solvability, solvability
    from warp_peri.solve import solve, solve_periodic
    from warp_peri.sweep import Sweep, sweep
    from warp_peri.training import Fit, fit
    from warp_peri.uncertainty import Uncertainty, fit_uncertainty
    from warp_peri.validation import evaluate

__version__ = "0.1.0"

__all__ = [
    "Certificate",
    "Choice",
    "Dataset",
    "Fit",
    "InfluenceFunction",
    "InputError",
    "LPSOperator",
    "Model",
    "Motion",
    "PointSet",
    "Scene",
    "Solvability",
    "Sweep",
    "Uncertainty",
    "certify",
    "choose_model",
    "coarse_grain",
    "critical_time_step",
    "equilibrium",
    "evaluate",
    "fit",
    "fit_uncertainty",
    "load_dataset",
    "load_model",
    "save_dataset",
    "set_threads",
    "smoothing_matrix",
    "solvability",
    "solve",
    "solve_periodic",
    "sweep",
    "velocity_verlet",
]

_NAMES = {
    "certificate": ("Certificate", "certify"),
    "choice": ("Choice", "Scene", "choose_model"),
    "coarse_graining": ("coarse_grain", "smoothing_matrix"),
    "dataset": ("Dataset", "PointSet", "load_dataset", "save_dataset"),
    "dynamics": ("Motion", "critical_time_step", "velocity_verlet"),
    "equilibrium": ("equilibrium",),
    "errors": ("InputError",),
    "launch": ("set_threads",),
    "model": ("Model", "load_model"),
    "operator": ("LPSOperator",),
    "shapes": ("InfluenceFunction",),
    "solvability": ("Solvability", "solvability"),
    "solve": ("solve", "solve_periodic"),
    "sweep": ("Sweep", "sweep"),
    "training": ("Fit", "fit"),
    "uncertainty": ("Uncertainty", "fit_uncertainty"),
    "validation": ("evaluate",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these

    def __getattr__(name):
        """A public name, or else a module of the package, imported now (PEP 562)."""
        path = f"{__name__}.{_MODULE_OF.get(name, name)}"
        try:
            module = import_module(path)
        except ModuleNotFoundError as error:
            if error.name != path:
                raise  # something that a module of ours needs is not installed
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
        found = globals()[name] = getattr(module, name) if name in _MODULE_OF else module
        return found

    def __dir__():
        return sorted({*__all__, "__version__", "dumps", "export", "shapes", "stress"})


class _Package(ModuleType):
    """Python binds a module in its package once it is loaded: `solve` and others stay functions."""

    def __setattr__(self, name: str, value: object) -> None:
        if _MODULE_OF.get(name) == name and isinstance(value, ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
