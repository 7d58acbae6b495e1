"""The process against differences and scikit-learn's; greedy choice and the cloud of data."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from examples.polymer.gaussian_process import KERNELS, fit_process, greedy, unlikelihood
from examples.polymer.learned import Cloud, OutsideWarning
from warp_peri import InputError


def data(n=60, noise=0.05):
    random = np.random.default_rng(0)
    X = random.uniform(-1, 1, (n, 3)) * [1, 10, 0.1]
    y = np.sin(2 * X[:, 0]) + 0.1 * X[:, 1] * X[:, 0] + 5 * X[:, 2]
    return X, y + noise * random.standard_normal(n)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("known", [True, False])
def test_the_likelihood_differentiates(kernel, known):
    random = np.random.default_rng(1)
    Z, f = random.standard_normal((25, 3)), random.standard_normal(25)
    noise = np.full(25, 0.1) if known else None
    theta, step = random.uniform(-0.5, 0.5, 6), 1e-5
    value = lambda t: unlikelihood(t, Z, f, kernel, noise)[0]
    exact = unlikelihood(theta, Z, f, kernel, noise)[1]
    central = [(value(theta + e) - value(theta - e)) / (2 * step) for e in step * np.eye(6)]
    assert np.abs(exact - central).max() < 1e-7 * max(1, np.abs(exact).max())


def test_it_agrees_with_scikit_learn():
    X, y = data()
    process = fit_process(X, y, noise=np.full(len(y), 0.05**2))
    Z, f = (X - process.centre) / process.scale, (y - process.mean) / process.size
    kernel = ConstantKernel(1.0, (1e-4, 1e5)) * RBF(np.ones(3), (0.1, 60))
    theirs = GaussianProcessRegressor(kernel, alpha=(0.05 / process.size) ** 2).fit(Z, f)
    again = np.exp([2 * process.log_amplitude, *process.log_lengths])
    assert np.allclose(again, np.exp(theirs.kernel_.theta), rtol=0.02)
    new = np.random.default_rng(2).uniform(-1, 1, (40, 3)) * [1, 10, 0.1]
    kernel.theta = np.log(again)
    theirs = GaussianProcessRegressor(kernel, alpha=(0.05 / process.size) ** 2, optimizer=None)
    mean, sd = theirs.fit(Z, f).predict((new - process.centre) / process.scale, return_std=True)
    assert np.allclose(process(new), process.mean + process.size * mean, atol=1e-7)
    assert np.allclose(process.deviation(new), process.size * sd, atol=1e-6)


def test_noise_is_learned_or_known():
    X, y = data(150, 0.2)
    learned = fit_process(X, y)
    assert np.sqrt(learned.noise[0]) == pytest.approx(0.2, rel=0.25)
    smooth, exact = fit_process(X, y, noise=np.full(150, 0.04)), data(150, 0.0)[1]
    sd = smooth.deviation(X)
    assert np.mean(np.abs(smooth(X) - exact) < 2 * sd) > 0.9
    correlated = fit_process(X, y, noise=np.full((150, 150), 0.01) + 0.03 * np.eye(150))
    assert np.abs(correlated(X) - exact).mean() < 0.15


def test_constant_data_and_bad_input():
    X, y = data()
    assert np.allclose(fit_process(X, 0 * y + 3)(X), 3)
    with pytest.raises(InputError, match="kernel"):
        fit_process(X, y, kernel="cubic")
    with pytest.raises(InputError, match="variances above 0"):
        fit_process(X, y, noise=0 * y)
    with pytest.raises(InputError, match="finite"):
        fit_process(X, y * np.nan)


def test_greedy_points_spread():
    Z = np.random.default_rng(0).uniform(0, 1, (500, 2)) * 4
    chosen = greedy(Z, 20)
    assert len(set(chosen)) == 20
    gap = lambda Y: np.min(np.linalg.norm(Y[:, None] - Y, axis=2) + 9 * np.eye(20))
    assert gap(Z[chosen]) > 5 * gap(Z[:20])
    assert len(greedy(np.zeros((5, 2)), 4)) == 1


def test_states_outside_the_data_are_told():
    X = np.random.default_rng(0).uniform(0, 1, (400, 2))
    cloud = Cloud(X, np.ones(2))
    cloud.check(X + 1e-3, "refuse")
    far = np.array([[0.5, 0.5], [3.0, 0.5]])
    with pytest.warns(OutsideWarning, match="1 of 2 states"):
        cloud.check(far, "warn")
    with pytest.raises(InputError, match="at 3, 0.5"):
        cloud.check(far, "refuse")
    cloud.check(far, "allow")
