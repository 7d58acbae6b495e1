"""Solids whose bonds break: dilatation, force and energy over unbroken bonds, and motion."""
