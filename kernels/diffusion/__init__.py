"""Nonlocal diffusion: the flux along bonds and its adjoint."""
