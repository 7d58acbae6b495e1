"""Polymer flow with memory: dumbbells, laws named and learned, plane flows and a channel."""

from warp_peri.flow.channel import ChannelFlow, ChannelRecord
from warp_peri.flow.closure import Closure, CoupledDumbbells, homogeneous, start_pairs
from warp_peri.flow.dumbbells import (
    Dumbbells,
    Ensembles,
    Twins,
    held,
    mixed,
    read_trajectory,
    simulate,
)
from warp_peri.flow.laws import (
    FENEP,
    Giesekus,
    LogConformation,
    UpperConvectedMaxwell,
    elongation,
    shear,
)
from warp_peri.flow.plane import PlaneFlow, Profiles
from warp_peri.flow.rates import RateLaw, ShearLaw, learn_rate, learn_shear
from warp_peri.flow.springs import SpringLaw, TwistedSpringLaw, learn_spring, learn_twisted

__all__ = [
    "ChannelFlow",
    "ChannelRecord",
    "Closure",
    "CoupledDumbbells",
    "Dumbbells",
    "Ensembles",
    "FENEP",
    "Giesekus",
    "LogConformation",
    "PlaneFlow",
    "Profiles",
    "RateLaw",
    "ShearLaw",
    "SpringLaw",
    "Twins",
    "TwistedSpringLaw",
    "UpperConvectedMaxwell",
    "elongation",
    "held",
    "homogeneous",
    "learn_rate",
    "learn_shear",
    "learn_spring",
    "learn_twisted",
    "mixed",
    "read_trajectory",
    "shear",
    "simulate",
    "start_pairs",
]
