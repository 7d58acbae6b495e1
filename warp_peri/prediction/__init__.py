"""An answer with its error: the richest model is evaluated, and corrects (theory, Q1–Q15)."""

from warp_peri.prediction.answer import Answer, Guarantee, Quantity, force, mean, strain, stress
from warp_peri.prediction.learning import Family
from warp_peri.prediction.next_load import NextLoad, design_loads, mixed_waves, next_load
from warp_peri.prediction.placed import Factors, Members, PlacedMembers

__all__ = [
    "Answer",
    "Factors",
    "Family",
    "Guarantee",
    "Members",
    "NextLoad",
    "PlacedMembers",
    "Quantity",
    "design_loads",
    "force",
    "mean",
    "mixed_waves",
    "next_load",
    "strain",
    "stress",
]
