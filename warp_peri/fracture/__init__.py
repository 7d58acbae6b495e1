"""Cracks: bonds that are cut, break or soften, at rest and in motion (theory, C)."""
