"""The linear peridynamic solid: numbers, influence functions, force, gradient, symbol, matrices."""
