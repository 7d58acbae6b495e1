"""What can be proven of a material or of a domain: `warp_peri.proofs`."""

from warp_peri.core.proof import Proof
from warp_peri.materials.certificate import Certificate, Solvability, certify, solvability
from warp_peri.materials.third_order import Uniqueness, uniqueness
from warp_peri.solvers.verlet import critical_time_step

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
