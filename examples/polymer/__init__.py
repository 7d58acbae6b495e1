"""Polymer flow with memory: dumbbells, laws named and learned, plane flows and a channel.

An application beside the library, for the fourth paper:

    python examples/polymer/learn.py      # dumbbells teach laws, held to flows that no fit saw
    python examples/polymer/channel.py    # a learned law in a channel, with its band
"""

from examples.polymer.closure import Closure, CoupledDumbbells, homogeneous, start_pairs
from examples.polymer.dumbbells import (
    Dumbbells,
    Ensembles,
    Twins,
    held,
    mixed,
    read_trajectory,
    simulate,
)
from examples.polymer.laws import (
    FENEP,
    Giesekus,
    LogConformation,
    UpperConvectedMaxwell,
    elongation,
    shear,
)
from examples.polymer.particles import ChannelFlow, ChannelRecord
from examples.polymer.plane import PlaneFlow, Profiles
from examples.polymer.rates import RateLaw, ShearLaw, learn_rate, learn_shear
from examples.polymer.springs import SpringLaw, TwistedSpringLaw, learn_spring, learn_twisted
from warp_peri.storage import load

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
    "load",
    "mixed",
    "read_trajectory",
    "shear",
    "simulate",
    "start_pairs",
]
