"""Influence functions given as callables, for the tests of them and of their fits."""

from dataclasses import replace

import numpy as np

from warp_peri.influence import InfluenceFunction
from warp_peri.materials.influence import conical, exponential, gaussian
from warp_peri.points.families import bond_classes

HORIZON = 3.0
LENGTHS = bond_classes(1.0, HORIZON).r


def humps(r, width, ratio, size):
    """Two Gaussians, the wider one of size −`size`."""
    return np.exp(-((r / width) ** 2)) - size * np.exp(-((r / (ratio * width)) ** 2))


def lines(r, K):
    """A table whose values are what is learned."""
    return np.interp(r, [0.5, 1.5, 2.5, 3.0], K)


SHAPES = {
    "gaussian": InfluenceFunction(gaussian, {"width": 1.9}),
    "exponential": InfluenceFunction(exponential, {"length": 1.2}),
    "conical": InfluenceFunction(conical, {"reach": 3.7}),
    "sign-changing": InfluenceFunction(
        humps,
        {"width": 1.6, "ratio": 2.0, "size": 0.1},
        {"width": (0.5, 4.0), "ratio": (1.1, 3.0), "size": (0.0, 0.9)},
    ),
    "table": InfluenceFunction(lines, {"K": [1.0, 0.7, -0.1, 0.2]}),
}


def solid(shape, *spacings, lam=0.1, mu=0.7, horizon=HORIZON):
    """The model of a shape, taken as certified."""
    model = shape.model(lam=lam, mu=mu, horizon=horizon, spacings=spacings)
    return replace(model, certified_on=spacings)


def off(shape):
    """The same shape with parameters that are 10 to 20 % off."""
    change = 1 + 0.1 * (1 + np.arange(len(shape.vector)) / len(shape.vector))
    return shape.at(shape.vector * change)
