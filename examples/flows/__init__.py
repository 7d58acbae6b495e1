"""Flows beside the library: bands of a learned law, laws that ask for data, or fit velocities."""
