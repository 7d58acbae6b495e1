"""Fits with what they are asked for one by one, which tests like to vary."""

from warp_peri import LPS


def fit(samples, horizon, kernel=None, *, noise=None, progress=None, **options):
    """The fit of a linear peridynamic solid."""
    return LPS(horizon, kernel, **options).learn(samples, noise=noise, progress=progress)
