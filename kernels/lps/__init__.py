"""The linear peridynamic solid: influence, weighted volume, dilatation, force, adjoint."""
