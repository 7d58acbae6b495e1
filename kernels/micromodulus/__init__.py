"""Crystal tensors: the force of a lattice by half families."""
