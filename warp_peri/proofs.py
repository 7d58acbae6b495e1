"""What can be proven of a material or of a domain: `warp_peri.proofs`."""

from warp_peri.core.proof import Proof
from warp_peri.dynamics.verlet import critical_time_step
from warp_peri.materials.certificate import Certificate, Solvability, certify, solvability
from warp_peri.materials.third_order import Uniqueness, uniqueness

__all__ = [
    "Certificate",
    "Proof",
    "Solvability",
    "Uniqueness",
    "certify",
    "critical_time_step",
    "solvability",
    "uniqueness",
]
