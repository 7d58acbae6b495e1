"""Bodies at rest: solves, and equilibrium as a differentiable function."""
