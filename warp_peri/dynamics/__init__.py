"""Bodies in motion: velocity Verlet and the steps it may take."""
