"""One regression over rows of a basis; materials bring their parametrisation and nothing else."""
