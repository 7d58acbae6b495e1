"""How a solid is learned, under which conditions, and how sure it is: `warp_peri.methods`."""

from warp_peri.fitting.evaluate import BootstrapResult, bootstrap
from warp_peri.fitting.settings import (
    AugmentedLagrangian,
    GaussNewton,
    StabilityConditions,
    TwoStage,
)
from warp_peri.materials.lps import LPSParameters
from warp_peri.materials.sweep import SweepResult, sweep
from warp_peri.materials.third_order import Smoothing
from warp_peri.solvers.solution import Coupling

__all__ = [
    "StabilityConditions",
    "AugmentedLagrangian",
    "Coupling",
    "GaussNewton",
    "BootstrapResult",
    "Smoothing",
    "LPSParameters",
    "SweepResult",
    "TwoStage",
    "bootstrap",
    "sweep",
]
