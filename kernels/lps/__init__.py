"""The linear peridynamic solid: influence, dilatation, force, and what gradients are made of."""
