"""From measurements to nodes: dumps and coarse graining."""
