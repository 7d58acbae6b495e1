"""Hyperelastic sheets: energies in torch, their operator and equilibria, fits."""
