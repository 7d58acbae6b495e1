"""Stage 2 goes on where it was, to the same bits."""

import numpy as np
import pytest
import torch

from tests.support.problems import kernel, lattice, manufactured
from warp_peri import InputError, fit
from warp_peri.learning import two_stage
from warp_peri.learning.checkpoint import Checkpoint
from warp_peri.learning.parameters import Parameters
from warp_peri.losses.full import sample_weights
from warp_peri.losses.reduced import reduce


@pytest.fixture
def points():
    return manufactured(kernel("positive", 2.5, lam=-0.2), lattice(6, 2.5), 6)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(two_stage, "EPOCHS", 100)
    monkeypatch.setattr(two_stage, "INNER_EPOCHS", 30)
    monkeypatch.setattr(two_stage, "OUTER_ITERATIONS", 5)


def run(points, checkpoint=None, **options):
    settings = {"horizon": 2.5, "degree": 3, "method": "two-stage"} | options
    return fit(points, checkpoint=checkpoint, **settings).history[-1].parameters


@pytest.mark.parametrize("after", [1, 3])
def test_resumed_is_unbroken(points, tmp_path, monkeypatch, after):
    unbroken = run(points)
    path = tmp_path / "state.npz"
    save, saved = Checkpoint.save, []

    def killed(self, *arguments, **options):
        save(self, *arguments, **options)
        saved.append(1)
        if len(saved) == after:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", killed)
        with pytest.raises(KeyboardInterrupt):
            run(points, path)
    resumed = run(points, path)
    assert (resumed.lam, resumed.mu, resumed.alpha) == (unbroken.lam, unbroken.mu, unbroken.alpha)
    np.testing.assert_array_equal(resumed.D, unbroken.D)
    assert resumed.losses == unbroken.losses


def test_a_finished_run_is_not_run_again(points, tmp_path, monkeypatch):
    first = run(points, tmp_path / "state.npz")
    monkeypatch.setattr(two_stage, "INNER_EPOCHS", 0)
    again = run(points, tmp_path / "state.npz")
    assert again.losses == first.losses
    np.testing.assert_array_equal(again.D, first.D)


def test_a_checkpoint_of_another_run_is_refused(points, tmp_path):
    path = tmp_path / "state.npz"
    run(points, path)
    with pytest.raises(InputError, match="other data or settings"):
        run(points, path, degree=4)
    with pytest.raises(InputError, match="other data or settings"):
        run(points, path, zeta=0.02)


def test_a_broken_checkpoint_is_named(points, tmp_path):
    path = tmp_path / "state.npz"
    path.write_bytes(b"PK\x03\x04 half of it")
    with pytest.raises(InputError, match="state.npz: not a readable checkpoint"):
        run(points, path)


class _Fixed:
    """One condition with a margin that nothing changes."""

    count = 1
    lattices = ()

    def __call__(self, lam, mu, weights):
        return torch.tensor([0.5], dtype=torch.float64)


def test_the_multiplier_climbs_with_the_violation(points, tmp_path, monkeypatch):
    monkeypatch.setattr(two_stage, "INNER_EPOCHS", 0)
    monkeypatch.setattr(two_stage, "OUTER_ITERATIONS", 1)
    weight = sample_weights([points], normalise=False)[0]
    kept = Checkpoint(tmp_path / "state.npz", "key")
    start = Parameters(-0.1, 0.7, 1.0, np.ones(2))
    two_stage.sign_changing_stage(
        [reduce(points, 2.5, weight)], start, _Fixed(), checkpoint=kept, tick=lambda loss: None
    )
    *_, slack, multiplier, previous = kept.load().tensors
    assert slack == 1.0
    assert multiplier == 1.0 * (0.5 - slack**2)  # φ ← φ + ψ H, H = margin − ϖ²
    assert previous == 0.5
