"""What a crack releases as it grows, and how much further it reaches than its last cut bond."""

from warp_peri.verification.cracks import energy_release, tip_shift

__all__ = ["energy_release", "tip_shift"]
