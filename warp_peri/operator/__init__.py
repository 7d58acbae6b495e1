"""A law on points: the force and its gradient, matrices, the symbol, stress."""
