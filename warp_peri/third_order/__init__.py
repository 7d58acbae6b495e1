"""A linear solid with third-order elastic constants (theory, N)."""
