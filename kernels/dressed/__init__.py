"""Dressed solids: elements and bonds whose moduli vary, and finite strain."""
