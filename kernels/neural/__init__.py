"""Kernels of the peridynamic neural operator."""
