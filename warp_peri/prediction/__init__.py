"""An answer with its error: the richest model is evaluated, and corrects (theory, Q1–Q11)."""

from warp_peri.points.loads import design_loads, mixed_waves
from warp_peri.prediction.answer import Answer, Guarantee, Quantity, force, mean, strain, stress
from warp_peri.prediction.ensemble import Factors, Family, Members
from warp_peri.prediction.members import PlacedMembers

__all__ = [
    "Answer",
    "Factors",
    "Family",
    "Guarantee",
    "Members",
    "PlacedMembers",
    "Quantity",
    "design_loads",
    "force",
    "mean",
    "mixed_waves",
    "strain",
    "stress",
]
