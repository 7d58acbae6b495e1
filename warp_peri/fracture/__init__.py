"""Cracks: bonds that are cut, break or soften, at rest and in motion (theory, C)."""

from typing import TYPE_CHECKING

from warp_peri.lazy import lazy

if TYPE_CHECKING:
    from warp_peri.fracture.body import (
        LatticeBody,
        box_nodes,
        lattice_body,
        penny_corners,
        point_force,
        rectangle_nodes,
    )
    from warp_peri.fracture.dynamics import BrittleMaterial, continuum_stretch, with_positive_kernel
    from warp_peri.fracture.growth import apparent_toughness
    from warp_peri.fracture.problems import Cracked, Injected
    from warp_peri.fracture.release import (
        crack_opening_volume,
        energy_release,
        j_integral,
        tip_shift,
    )
    from warp_peri.fracture.softening import BondLaw, SofteningMaterial

__all__ = [
    "BondLaw",
    "BrittleMaterial",
    "Cracked",
    "Injected",
    "LatticeBody",
    "SofteningMaterial",
    "apparent_toughness",
    "box_nodes",
    "continuum_stretch",
    "crack_opening_volume",
    "energy_release",
    "j_integral",
    "lattice_body",
    "penny_corners",
    "point_force",
    "rectangle_nodes",
    "tip_shift",
    "with_positive_kernel",
]

_HOMES = {
    "body": "LatticeBody box_nodes lattice_body penny_corners point_force rectangle_nodes",
    "dynamics": "BrittleMaterial continuum_stretch with_positive_kernel",
    "growth": "apparent_toughness",
    "problems": "Cracked Injected",
    "release": "j_integral energy_release crack_opening_volume tip_shift",
    "softening": "BondLaw SofteningMaterial",
}

if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these
    __getattr__, __dir__ = lazy(__name__, _HOMES)
