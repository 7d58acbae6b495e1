"""Predictions with an error: the richest model is evaluated, and corrects (theory, Q1–Q11)."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.points.dataset import design_loads as design_loads
    from warp_peri.points.dataset import mixed_waves as mixed_waves
    from warp_peri.prediction.answer import ErrorBound as ErrorBound
    from warp_peri.prediction.answer import Prediction as Prediction
    from warp_peri.prediction.answer import QuantityEstimate as QuantityEstimate
    from warp_peri.prediction.answer import strain as strain
    from warp_peri.prediction.answer import stress as stress
    from warp_peri.prediction.ensemble import CalibrationFactors as CalibrationFactors
    from warp_peri.prediction.ensemble import Ensemble as Ensemble
    from warp_peri.prediction.ensemble import EnsembleMaterial as EnsembleMaterial
    from warp_peri.prediction.ensemble import EnsembleOperator as EnsembleOperator
else:
    __getattr__, __dir__, __all__ = lazy(__name__)
