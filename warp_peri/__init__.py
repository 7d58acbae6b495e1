"""Linear peridynamic solids learned from molecular data, on NVIDIA Warp.

The names below are imported on first use, so that neither torch nor Warp is loaded before it is
needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warp_peri import dumps as dumps
    from warp_peri import export as export
    from warp_peri import shapes as shapes
    from warp_peri import stress as stress
    from warp_peri.choice import Choice, Scene, choose_model
    from warp_peri.dynamics.verlet import Motion, critical_time_step, velocity_verlet
    from warp_peri.errors import InputError
    from warp_peri.launch import set_threads
    from warp_peri.learning.diagnosis import Diagnosis, diagnose
    from warp_peri.learning.evaluate import evaluate
    from warp_peri.learning.fit import fit
    from warp_peri.learning.methods import Bernstein, Constrained, TwoStage
    from warp_peri.learning.nonlinear import Nonlinear, NonlinearFit
    from warp_peri.learning.result import Fit
    from warp_peri.learning.sweep import Sweep, sweep
    from warp_peri.learning.uncertainty import Uncertainty, fit_uncertainty
    from warp_peri.models.lps import Model, load_model
    from warp_peri.models.nonlinear import NonlinearModel, load_nonlinear
    from warp_peri.models.shapes import InfluenceFunction
    from warp_peri.models.smoothing import Smoothing
    from warp_peri.models.solid import Solid
    from warp_peri.operator.nonlinear import NonlinearOperator
    from warp_peri.points.dataset import Dataset
    from warp_peri.points.dataset_file import load_dataset, save_dataset
    from warp_peri.points.interpolation import onto_lattice
    from warp_peri.points.mesh import Mesh, load_mesh
    from warp_peri.points.points import Points
    from warp_peri.points.samples import Samples
    from warp_peri.regression.settings import Optimum
    from warp_peri.sources.coarse_graining import coarse_grain, smoothing_matrix
    from warp_peri.stability.certificate import Certificate, certify
    from warp_peri.stability.conditions import Conditions
    from warp_peri.stability.solvability import Solvability, solvability
    from warp_peri.stability.uniqueness import Uniqueness, uniqueness
    from warp_peri.statics.body import BodySolution, Coupling, solve_body
    from warp_peri.statics.body_gradient import BodyGradient, body_gradient
    from warp_peri.statics.equilibrium import equilibrium
    from warp_peri.statics.nonlinear import NonlinearRecord, solve_nonlinear
    from warp_peri.statics.scattered import ThroughLattice
    from warp_peri.statics.solve import Iteration, solve, solve_periodic
    from warp_peri.transfer.cache import on_lattice
    from warp_peri.transfer.operator import LPSOperator
    from warp_peri.transfer.points import model_for
    from warp_peri.transfer.shared_kernel import one_kernel

__version__ = "0.1.0"

__all__ = [
    "Bernstein",
    "BodyGradient",
    "BodySolution",
    "Certificate",
    "Choice",
    "Conditions",
    "Constrained",
    "Coupling",
    "Dataset",
    "Diagnosis",
    "Fit",
    "InfluenceFunction",
    "InputError",
    "Iteration",
    "LPSOperator",
    "Mesh",
    "Model",
    "Motion",
    "Nonlinear",
    "NonlinearFit",
    "NonlinearModel",
    "NonlinearOperator",
    "NonlinearRecord",
    "Optimum",
    "Points",
    "Samples",
    "Scene",
    "Smoothing",
    "Solid",
    "Solvability",
    "Sweep",
    "ThroughLattice",
    "TwoStage",
    "Uncertainty",
    "Uniqueness",
    "body_gradient",
    "certify",
    "choose_model",
    "coarse_grain",
    "critical_time_step",
    "diagnose",
    "equilibrium",
    "evaluate",
    "fit",
    "fit_uncertainty",
    "load_dataset",
    "load_mesh",
    "load_model",
    "load_nonlinear",
    "model_for",
    "on_lattice",
    "one_kernel",
    "onto_lattice",
    "save_dataset",
    "set_threads",
    "smoothing_matrix",
    "solvability",
    "solve",
    "solve_body",
    "solve_nonlinear",
    "solve_periodic",
    "sweep",
    "uniqueness",
    "velocity_verlet",
]

_NAMES = {
    "choice": ("Choice", "Scene", "choose_model"),
    "dynamics.verlet": ("Motion", "critical_time_step", "velocity_verlet"),
    "errors": ("InputError",),
    "launch": ("set_threads",),
    "learning.diagnosis": ("Diagnosis", "diagnose"),
    "learning.evaluate": ("evaluate",),
    "learning.fit": ("fit",),
    "learning.methods": ("Bernstein", "Constrained", "TwoStage"),
    "regression.settings": ("Optimum",),
    "learning.result": ("Fit",),
    "learning.nonlinear": ("Nonlinear", "NonlinearFit"),
    "learning.sweep": ("Sweep", "sweep"),
    "learning.uncertainty": ("Uncertainty", "fit_uncertainty"),
    "models.lps": ("Model", "load_model"),
    "models.nonlinear": ("NonlinearModel", "load_nonlinear"),
    "models.smoothing": ("Smoothing",),
    "models.shapes": ("InfluenceFunction",),
    "models.solid": ("Solid",),
    "points.dataset": ("Dataset",),
    "points.dataset_file": ("load_dataset", "save_dataset"),
    "points.interpolation": ("onto_lattice",),
    "points.mesh": ("Mesh", "load_mesh"),
    "points.points": ("Points",),
    "points.samples": ("Samples",),
    "operator.nonlinear": ("NonlinearOperator",),
    "sources.coarse_graining": ("coarse_grain", "smoothing_matrix"),
    "stability.certificate": ("Certificate", "certify"),
    "stability.conditions": ("Conditions",),
    "stability.solvability": ("Solvability", "solvability"),
    "stability.uniqueness": ("Uniqueness", "uniqueness"),
    "statics.body": ("BodySolution", "Coupling", "solve_body"),
    "statics.body_gradient": ("BodyGradient", "body_gradient"),
    "statics.equilibrium": ("equilibrium",),
    "statics.nonlinear": ("NonlinearRecord", "solve_nonlinear"),
    "statics.scattered": ("ThroughLattice",),
    "statics.solve": ("Iteration", "solve", "solve_periodic"),
    "transfer.cache": ("on_lattice",),
    "transfer.shared_kernel": ("one_kernel",),
    "transfer.operator": ("LPSOperator",),
    "transfer.points": ("model_for",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}
_MODULES = ("dumps", "export", "shapes", "stress")

if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these

    def __getattr__(name):
        """A public name or module, imported now (PEP 562)."""
        if name in _MODULES:
            return import_module(f"{__name__}.{name}")
        if name == "PointSet":
            raise AttributeError(
                "warp_peri.PointSet is now warp_peri.Points(x, interior, spacing, box, outside), "
                "and with fields warp_peri.Samples(points, u, b, arrays)"
            )
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        return value

    def __dir__():
        return sorted({*__all__, "__version__", *_MODULES})
