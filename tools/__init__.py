"""What runs LAMMPS and makes data sets; the library does not know of it."""
