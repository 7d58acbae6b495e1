"""Solvers for equilibrium and motion: linear, nonlinear, time steps, gradients."""
