"""Polymer flow with memory: dumbbells, learned models of their stress, plane flows and a channel.

An application beside the library, for the fourth paper; `tables.py` prints its tables.
"""

from examples.polymer.closure import Closure, CoupledDumbbells, homogeneous, start_pairs
from examples.polymer.dumbbells import Dumbbells, Ensembles, held, mixed, read_trajectory, simulate
from examples.polymer.laws import UpperConvectedMaxwell, elongation, shear
from examples.polymer.particles import ChannelFlow, ChannelRecord, run_channel
from examples.polymer.plane import PlaneFlow, Profiles, run_plane
from examples.polymer.rates import RateLaw, ShearLaw, learn_rate, learn_shear, read_law

__all__ = [
    "ChannelFlow", "ChannelRecord", "Closure", "CoupledDumbbells", "Dumbbells", "Ensembles",
    "PlaneFlow", "Profiles", "RateLaw", "ShearLaw", "UpperConvectedMaxwell", "elongation", "held",
    "homogeneous", "learn_rate", "learn_shear", "mixed", "read_law", "read_trajectory",
    "run_channel", "run_plane", "shear", "simulate", "start_pairs",
]  # fmt: skip
