"""Polymer flow with memory: dumbbells, laws named and learned, plane flows and a channel."""
