"""Equilibrium and motion: linear and nonlinear solves, time steps, their gradients."""
