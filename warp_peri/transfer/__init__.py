"""A material on another lattice: kernels fitted to its dispersion, certified there, and kept."""
