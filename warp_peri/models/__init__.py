"""Laws as numbers: the linear peridynamic solid and the influence functions it is made of."""
