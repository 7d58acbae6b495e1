"""From a structure of atoms and what holds them together to a law of their crystal."""
