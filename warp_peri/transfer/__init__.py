"""A material on another lattice: kernels fitted to its dispersion, certified there, and kept."""

RECIPE = 7
"""Of the figures in transfer.lattice: what was made by another is made again."""
LEAST = 2.0
"""Smallest horizon that a lattice has, in spacings."""
