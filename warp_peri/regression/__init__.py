"""The constrained optimum of a reduced loss: its variables, its conditions, its minimum."""
