"""Fit methods, their conditions and their bootstrap: `warp_peri.methods`."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.fitting.evaluate import BootstrapResult as BootstrapResult
    from warp_peri.fitting.evaluate import bootstrap as bootstrap
    from warp_peri.materials.lps import LPSParameters as LPSParameters
    from warp_peri.materials.lps_law import AugmentedLagrangian as AugmentedLagrangian
    from warp_peri.materials.lps_law import GaussNewton as GaussNewton
    from warp_peri.materials.lps_law import StabilityConditions as StabilityConditions
    from warp_peri.materials.lps_law import TwoStage as TwoStage
    from warp_peri.materials.sweep import SweepResult as SweepResult
    from warp_peri.materials.sweep import sweep as sweep
    from warp_peri.materials.third_order import Smoothing as Smoothing
    from warp_peri.solvers.solution import Coupling as Coupling
else:
    __getattr__, __dir__, __all__ = lazy(__name__)
