"""How a solid is learned, under which conditions, and how sure it is: `warp_peri.methods`."""

from warp_peri.fitting.bootstrap import Resampled, resample_loads
from warp_peri.fitting.settings import Conditions, Constrained, Optimum, TwoStage
from warp_peri.materials.lps import Solid
from warp_peri.materials.lps_sweep import Sweep, sweep
from warp_peri.materials.third_order import Smoothing
from warp_peri.solvers.solution import Coupling

__all__ = [
    "Conditions",
    "Constrained",
    "Coupling",
    "Optimum",
    "Resampled",
    "Smoothing",
    "Solid",
    "Sweep",
    "TwoStage",
    "resample_loads",
    "sweep",
]
