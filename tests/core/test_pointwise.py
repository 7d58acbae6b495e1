"""An energy density of strain on a lattice: in space, of several gradients, on one thread."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
import torch

from tests.support import in_plane_and_space, parametrize
from tests.support.materials import saint_venant
from tests.support.problems import lattice, normal
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.stencil import Stencil, half_ball
from warp_peri.runtime import one_thread
from warp_peri.testing import check_energy, check_product

LAM, MU = 0.4, 0.9


def cubic(E, *, lam, mu, more):
    t, square = E.diagonal(dim1=-2, dim2=-1).sum(-1), (E * E).sum((-1, -2))
    return saint_venant(E, lam, mu) + more * (t**3 + t * square + E[..., 0, 1] ** 2 * E[..., 0, 0])


def one_sided(d):
    """Steps and weights of gradients of one side each, at a spacing of .5."""
    steps = np.concatenate([np.zeros((1, d), int), np.eye(d, dtype=int), -np.eye(d, dtype=int)])
    weights = np.zeros((2, 1 + 2 * d, d))
    for q, sign in enumerate((1, -1)):
        weights[q, 0] = -sign / 0.5
        weights[q, (1 if sign > 0 else 1 + d) + np.arange(d), np.arange(d)] = sign / 0.5
    return steps, weights


def operator(d, **options):
    """On a cube, with a shorter linear part where it is asked for."""
    points = lattice(np.ones(d * (7 - d,), bool), 0.5, 0.5)
    numbers, (steps, weights) = {"lam": LAM, "mu": MU, "more": 2.0}, one_sided(d)
    return Pointwise(points, 0.5, cubic, steps, weights, numbers=numbers, **options)


@in_plane_and_space
@parametrize("linear", [False, True])
def test_force_is_the_gradient_of_the_energy_and_products_are_those_of_the_tangent(d, linear):
    steps = half_ball(1.0, d)
    stencil = Stencil(0.5, steps, np.stack([(1.0 + n) * np.eye(d) for n in range(len(steps))]))
    op = operator(d, stencil=stencil if linear else None)
    u = 0.05 * normal(op.points.x.shape)
    check_product(op, u)
    if not linear:  # whose energy is its stencil's
        check_energy(op, u)


def test_one_thread_is_given_back_by_the_last_of_four_and_after_an_error(threads):
    meet, count = Barrier(4), torch.get_num_threads
    torch.set_num_threads(3)

    def task(number):
        meet.wait()
        for _ in range(50):
            with one_thread():
                inside = count()
        meet.wait()
        return inside, count()

    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(task, range(4))) == {(1, 3)}
    with one_thread(), one_thread():
        assert count() == 1
    assert count() == 3
    with pytest.raises(ZeroDivisionError), one_thread():
        1 / 0  # noqa: B018
    assert count() == 3
    with one_thread(False):
        assert count() == 3
