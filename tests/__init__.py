"""Tests; what they share stands in problems.py, reference.py and conftest.py."""
