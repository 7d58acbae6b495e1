"""Cracks: bonds that are cut, break or soften, at rest and in motion (theory, C)."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.fracture import adjoint as adjoint
    from warp_peri.fracture.body import LatticeBody as LatticeBody
    from warp_peri.fracture.body import box_nodes as box_nodes
    from warp_peri.fracture.body import lattice_body as lattice_body
    from warp_peri.fracture.body import penny_corners as penny_corners
    from warp_peri.fracture.body import point_force as point_force
    from warp_peri.fracture.body import rectangle_nodes as rectangle_nodes
    from warp_peri.fracture.materials import BondLaw as BondLaw
    from warp_peri.fracture.materials import BrittleMaterial as BrittleMaterial
    from warp_peri.fracture.materials import SofteningMaterial as SofteningMaterial
    from warp_peri.fracture.materials import continuum_stretch as continuum_stretch
    from warp_peri.fracture.materials import with_positive_kernel as with_positive_kernel
    from warp_peri.fracture.problems import Cracked as Cracked
    from warp_peri.fracture.problems import Injected as Injected
    from warp_peri.fracture.problems import crack_opening_volume as crack_opening_volume
    from warp_peri.fracture.problems import energy_release as energy_release
    from warp_peri.fracture.problems import j_integral as j_integral
    from warp_peri.fracture.problems import tip_shift as tip_shift
    from warp_peri.fracture.statics import apparent_toughness as apparent_toughness

if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these
    __getattr__, __dir__, __all__ = lazy(__name__)
