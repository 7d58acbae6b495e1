"""Hyperelastic solids: nodal strains, energies of strains and of bonds, forces, tangents."""
