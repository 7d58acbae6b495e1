"""Hyperelastic sheets. Both fits are loaded with the energies, which learn by them."""

from warp_peri.materials.hyperelastic import energy_fit as energy_fit
from warp_peri.materials.hyperelastic import from_displacement as from_displacement
