"""Nodes of bodies, the bonds that join them, and the quadrature weights of the bonds."""
