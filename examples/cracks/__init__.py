"""Cracks beside the library: theories of straight and kinked cracks, energy release, inclusions."""
