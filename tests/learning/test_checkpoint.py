"""Stage 2 goes on where it was, to the same bits."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.problems import kernel, lattice, manufactured
from warp_peri import Bernstein, InputError
from warp_peri.files.atomic import ArrayFile
from warp_peri.fitting import augmented_lagrangian
from warp_peri.fitting.augmented_lagrangian import PrintedState, as_printed
from warp_peri.learning.fit import learn as fit
from warp_peri.methods import Conditions, TwoStage


@pytest.fixture
def points():
    return manufactured(kernel("positive", 2.5, lam=-0.2), lattice(6, 2.5), 6)


QUICK = TwoStage(epochs=100, inner_epochs=30, outer_iterations=5)


def run(points, checkpoint=None, degree=3, **options):
    method = replace(QUICK, checkpoint=checkpoint)
    return fit(points, 2.5, Bernstein(degree), method=method, **options).history[-1]


@pytest.mark.parametrize("after", [1, 3])
def test_resumed_is_unbroken(points, tmp_path, monkeypatch, after):
    unbroken = run(points)
    path = tmp_path / "state.npz"
    save, saved = ArrayFile.write, []

    def killed(self, *arguments, **options):
        save(self, *arguments, **options)
        saved.append(1)
        if len(saved) == after:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ArrayFile, "write", killed)
        with pytest.raises(KeyboardInterrupt):
            run(points, path)
    resumed = run(points, path)
    first, again = unbroken.parameters, resumed.parameters
    assert (again.lam, again.mu, again.alpha) == (first.lam, first.mu, first.alpha)
    np.testing.assert_array_equal(again.D, first.D)
    assert resumed.loss == unbroken.loss


def test_a_finished_run_is_not_run_again(points, tmp_path, monkeypatch):
    first = run(points, tmp_path / "state.npz")

    def not_again(*given, **how):
        raise AssertionError("stage 2 was finished")

    monkeypatch.setattr(augmented_lagrangian, "adam", not_again)
    again = run(points, tmp_path / "state.npz")
    assert again.loss == first.loss
    np.testing.assert_array_equal(again.parameters.D, first.parameters.D)


def test_a_checkpoint_of_another_run_is_refused(points, tmp_path):
    path = tmp_path / "state.npz"
    run(points, path)
    with pytest.raises(InputError, match="other data or settings"):
        run(points, path, degree=4)
    with pytest.raises(InputError, match="other data or settings"):
        run(points, path, conditions=Conditions(zeta=0.02))


def test_a_broken_checkpoint_is_named(points, tmp_path):
    path = tmp_path / "state.npz"
    path.write_bytes(b"PK\x03\x04 half of it")
    with pytest.raises(InputError, match="state.npz: not a readable checkpoint"):
        run(points, path)


def test_the_multiplier_climbs_with_the_violation():
    """One condition with a margin that nothing changes."""
    zero = torch.zeros(1, dtype=torch.float64)
    state = PrintedState([torch.ones_like(zero).requires_grad_(), zero, zero + torch.inf])
    how = {"steps": 0, "rounds": 1, "tick": lambda loss: None}
    as_printed(state, lambda: zero.sum(), lambda: zero + 0.5, lambda: None, **how)
    slack, multiplier, previous = state.tensors
    assert slack == 1.0
    assert multiplier == 1.0 * (0.5 - slack**2)  # φ ← φ + ψ H, H = margin − ϖ²
    assert previous == 0.5
