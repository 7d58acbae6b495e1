"""One operator, used by four Python threads at once, gives each what it gives one alone."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import torch
from torch.autograd import grad

import warp_peri as wp
from tests.support import filterwarnings, parametrize, warned
from tests.support.clouds import plain
from tests.support.fields import answers, field
from tests.support.materials import LAWS, OPERATORS, operator, placed
from tests.support.problems import lattice
from warp_peri.errors import heard, quietly, warn

pytestmark = filterwarnings("ignore::UserWarning")
USERS = 4


def of_four(work):
    """What four threads that begin together find, each for its own number, twice each."""
    begin = Barrier(USERS)

    def user(number):
        begin.wait()
        return [work(number) for _ in range(2)]

    with ThreadPoolExecutor(USERS) as pool:
        return [one for both in pool.map(user, range(USERS)) for one in both]


def assert_as_alone(work):
    alone = [one for number in range(USERS) for one in [work(number)] * 2]
    for expected, found in zip(alone, of_four(work), strict=True):
        for one, other in zip(expected, found, strict=True):
            assert np.array_equal(one, other)


@parametrize("name", [*OPERATORS, "LPS, fields"])
def test_a_force_and_its_derivatives(name):
    op = operator(name) if name in OPERATORS else placed(name)[0]
    assert_as_alone(lambda n: answers(op, field(op, 1, seed=n), field(op, 1, seed=n + USERS)))


@parametrize("name", LAWS)
def test_a_solve_and_its_gradient(name):
    op, points = placed(name, 1)

    def work(number):
        u = (1 + number) * 1e-4 * torch.tensor(points.x)
        u = (u + 1e-5 * torch.sin(u / 1e-4)).requires_grad_()
        solution = wp.solve(op, wp.Dirichlet(points, None, u))
        (slope,) = grad(solution.u.square().sum(), u)
        return solution.u.detach().numpy(), slope.numpy()

    assert_as_alone(work)


def test_warnings_belong_to_the_thread_that_has_them():
    def work(number):
        with heard() as texts:
            warn(f"number {number}")
            with quietly():
                warn("nobody hears this")
        return (texts,)

    for number, (texts,) in enumerate(of_four(work)):
        assert texts == [f"number {number // 2}"]


def test_a_warning_names_the_line_that_called_the_library():
    with warned("allow_uncertified|certified") as told:
        plain(2.0, 0.4, 0.4).on(lattice(1, 1.0), allow_uncertified=True)
    assert told[0].filename == __file__
