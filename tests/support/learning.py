"""Fits with what they are asked for one by one, which tests like to vary."""

from warp_peri.learning.fit import learn, learn_third_order


def fit(samples, horizon, *arguments, nonlinear=None, **options):
    """A linear fit, or with `nonlinear` one of third-order constants."""
    if nonlinear is None:
        return learn(samples, horizon, *arguments, **options)
    return learn_third_order(samples, nonlinear, horizon, *arguments, **options)
