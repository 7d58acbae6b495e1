"""Conduction and diffusion along bonds, alone and with mechanics (theory.md, D)."""
