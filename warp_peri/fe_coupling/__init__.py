"""Bodies with edges of their own: elements at the rim, a lattice inside, and how the two meet."""
