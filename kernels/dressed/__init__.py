"""Dressed solids: elements whose moduli vary."""
