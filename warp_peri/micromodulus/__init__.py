"""Crystals of any symmetry in two and three dimensions: a tensor for every bond (theory.md, T)."""
