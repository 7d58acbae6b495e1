"""An answer with its error: the richest model is evaluated, and corrects (theory, Q1–Q11)."""

from warp_peri.points.dataset import design_loads, mixed_waves
from warp_peri.prediction.answer import (
    ErrorBound,
    Prediction,
    QuantityEstimate,
    force,
    mean,
    strain,
    stress,
)
from warp_peri.prediction.ensemble import CalibrationFactors, Ensemble, EnsembleMaterial
from warp_peri.prediction.members import EnsembleOperator

__all__ = [
    "Prediction",
    "CalibrationFactors",
    "Ensemble",
    "ErrorBound",
    "EnsembleMaterial",
    "EnsembleOperator",
    "QuantityEstimate",
    "design_loads",
    "force",
    "mean",
    "mixed_waves",
    "strain",
    "stress",
]
