"""Linear peridynamic solids learned from molecular data, on NVIDIA Warp."""

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
