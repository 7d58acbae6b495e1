"""Where nodes are, which bonds join them, and the quadrature weights of the bonds."""
