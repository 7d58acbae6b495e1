"""How a model is learned; here what functions and the command share, where no torch is loaded."""

METHODS = ("constrained", "two-stage", "optimum")
"""Methods of `fit` on the command line."""
LOSSES = ("auto", "residual", "corrected", "output")
"""Losses that `fit` may be asked for."""
HORIZONS = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0)
"""Horizons δ that `sweep` tries [Å] (You et al. 2021, section 6.2)."""
DEGREES = (0, 5, 10, 15, 20)
"""Degrees M that `sweep` tries (You et al. 2021, section 6.2)."""
