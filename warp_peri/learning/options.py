"""What can be asked for by name: for functions, and for the command without their torch."""

METHODS = ("constrained", "two-stage", "optimum")
"""Of `fit`."""
LOSSES = ("auto", "residual", "corrected", "output")
"""Of `fit`."""
HORIZONS = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0)
"""Of `sweep` [Å] (You et al. 2021, section 6.2)."""
DEGREES = (0, 5, 10, 15, 20)
"""Of `sweep`."""
