"""Cracks beside the library: theories of straight and kinked cracks, inclusions."""
