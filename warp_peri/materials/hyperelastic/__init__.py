"""Hyperelastic sheets. The fit is loaded with the energies, which learn by it."""

from warp_peri.materials.hyperelastic import sheet_fit as sheet_fit
