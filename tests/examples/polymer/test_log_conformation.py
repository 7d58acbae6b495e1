"""The logarithm of C as the state: positive where the plain form is not, of the same order."""

import numpy as np
import pytest

from examples.polymer.closure import Closure, homogeneous
from examples.polymer.dumbbells import carried_exactly, propagator
from examples.polymer.laws import (
    FENEP,
    IDENTITY,
    Giesekus,
    LogConformation,
    UpperConvectedMaxwell,
    eigenvalues,
    elongation,
    exponential_of,
    logarithm,
)
from examples.polymer.plane import PlaneFlow, run_plane
from tests.support.problems import fitted_order
from warp_peri import InputError

MAXWELL = UpperConvectedMaxwell()


def stretched_and_turned():
    """Elongation at Wi 3, which stretches to 10⁵, and a rotation of what was stretched."""
    K = np.zeros((20, 1, 4))
    K[:10], K[10:] = elongation(3.0), [0, 5.0, -5.0, 0]
    exact = IDENTITY[None]
    for now in K:
        for _ in range(100):
            exact = carried_exactly(exact, *propagator(now, 0.002))
    return K, exact


def test_log_c_stays_positive_where_c_does_not():
    K, exact = stretched_and_turned()
    with pytest.raises(InputError, match="positive eigenvalues, got -75"):
        homogeneous(MAXWELL, K, 0.2, parts=4)
    small = eigenvalues(exact)[1]
    crude = exponential_of(homogeneous(LogConformation(MAXWELL), K, 0.2, parts=4)[-1])
    assert abs(eigenvalues(crude)[1] / small - 1) < 0.15
    plain = homogeneous(MAXWELL, K, 0.2, parts=32)[-1]
    fine = exponential_of(homogeneous(LogConformation(MAXWELL), K, 0.2, parts=32)[-1])
    assert eigenvalues(plain)[1] > 5 * small  # positive again, and of no use
    assert abs(eigenvalues(fine)[1] / small - 1) < 0.01
    assert np.linalg.norm(fine - exact) < 0.02 * np.linalg.norm(exact)


@pytest.mark.slow
def test_it_is_of_second_order():
    K, exact = stretched_and_turned()
    errors, parts = [], [16, 32, 64]
    for n in parts:
        C = exponential_of(homogeneous(LogConformation(MAXWELL), K, 0.2, parts=n)[-1])
        errors.append(np.linalg.norm(C - exact))
    assert 1.85 < fitted_order(1 / np.array(parts), errors) < 2.15


@pytest.mark.parametrize("law", [MAXWELL, Giesekus(0.3), FENEP(20.0)], ids=lambda law: law.name)
def test_it_is_the_same_law(law):
    K = np.random.default_rng(0).uniform(-1, 1, (1, 12, 4))
    C = homogeneous(law, K, 0.5)[-1]
    log, step = LogConformation(law), 1e-6
    ahead, behind = (logarithm(C + d * law.rate(K[0], C)) for d in (step, -step))
    assert np.abs(log.rate(K[0], logarithm(C)) - (ahead - behind) / (2 * step)).max() < 1e-8
    assert np.allclose(log.stress(logarithm(C)), law.stress(C), atol=1e-12)
    assert np.abs(log.rate(0 * K[0], np.tile(log.rest, (12, 1)))).max() < 1e-12
    flow = PlaneFlow(1.0, 1.0, 16, force=lambda t: 8.0)
    run = lambda fluid: run_plane(flow, Closure(fluid, 1.0, 16), until=3.0, dt=0.01, every=50).u
    plain = run(law)
    assert np.linalg.norm(run(log) - plain) < 1e-3 * np.linalg.norm(plain)
