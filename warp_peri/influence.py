"""Shapes of influence functions: what users call warp_peri.influence."""

from warp_peri.materials.influence import (
    InfluenceFunction,
    conical,
    damped_wave,
    exponential,
    gaussian,
    named,
    table,
)

__all__ = [
    "InfluenceFunction",
    "conical",
    "damped_wave",
    "exponential",
    "gaussian",
    "named",
    "table",
]
