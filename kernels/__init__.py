"""Warp kernels, a folder for each law beside what all share; imported as warp_peri.kernels."""

if __name__ != "warp_peri.kernels":
    raise ImportError(f"import warp_peri.kernels, not {__name__}")
