"""Polymer flow with memory: dumbbells, laws named and learned, plane flows and a channel."""

from warp_peri.flow.channel_run import ChannelFlow, ChannelRecord
from warp_peri.flow.closure import Closure, CoupledDumbbells, homogeneous
from warp_peri.flow.dumbbells import Dumbbells
from warp_peri.flow.laws import FENEP, Giesekus, UpperConvectedMaxwell
from warp_peri.flow.log_conformation import LogConformation
from warp_peri.flow.pairs import start_pairs
from warp_peri.flow.planar import elongation, shear
from warp_peri.flow.plane import PlaneFlow, Profiles
from warp_peri.flow.protocols import Ensembles, held, mixed, read_trajectory, simulate
from warp_peri.flow.rate_law import RateLaw, learn_rate
from warp_peri.flow.shear_law import ShearLaw, learn_shear
from warp_peri.flow.spring_law import SpringLaw, learn_spring
from warp_peri.flow.twins import Twins
from warp_peri.flow.twisted_law import TwistedSpringLaw, learn_twisted

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
