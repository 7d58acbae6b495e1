"""How a model is learned, and how sure it is: fits, sweeps, errors, uncertainty."""
