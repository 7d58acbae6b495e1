"""Warp kernels of polymer flow: dumbbells and smoothed particles."""
