"""Soft tissue: hyperelastic sheets, learned from loads or from displacement (theory.md, H)."""
