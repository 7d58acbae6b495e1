"""The nonlinear solid: energy of a nodal displacement gradient, force, adjoint, tangent."""
