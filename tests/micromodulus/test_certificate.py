"""What is proven of a symbol holds, and what does not hold is not proven."""

import numpy as np
import pytest

from tests.micromodulus.crystals import learned
from warp_peri.micromodulus.certificate import certify, parts
from warp_peri.micromodulus.family import bend, half_ball
from warp_peri.micromodulus.regression import laplacian

NOTHING = {d: np.array([np.eye(d), -np.eye(d)], dtype=int) for d in (2, 3)}


@pytest.mark.parametrize("d", [2, 3])
def test_nine_tenths_of_the_sampled_minimum_are_proven_with_the_wedge_and_without(d):
    law = learned(d)
    scaled = law.tensors * law.spacing**2
    for group in (law.group, NOTHING[d]) if d == 2 else (law.group,):
        proof = certify(law.steps, scaled, group)
        assert proof.proven >= 0.9 * proof.sampled > 0
        assert proof.sampled == pytest.approx(0.024, rel=0.01)  # (C11 − C12)/2, the softest shear
    phase = np.random.default_rng(0).uniform(-np.pi, np.pi, (4000, d))
    phase[::2] *= 1e-2
    D = np.tensordot(bend(phase, law.steps), scaled, 1)
    assert (np.linalg.eigvalsh(D)[:, 0] > proof.proven * laplacian(phase)).all()


@pytest.mark.parametrize("d", [2, 3])
def test_a_dip_between_the_points_of_the_sample_is_not_overlooked(d):
    """Positive at the sampled waves, negative in between: nothing may be proven."""
    law = learned(d)
    scaled = law.tensors * law.spacing**2
    far = np.zeros((2, d), int)
    far[:, 0] = {2: (120, 240), 3: (40, 80)}[d]  # 1 − cos k·ξ vanishes on the sampled grid
    dip = np.zeros((2, d, d))
    dip[:, 0, 0] = -0.2, 0.2  # positive at long waves
    steps, below = np.concatenate([law.steps, far]), np.concatenate([scaled, dip])
    wave = np.zeros((1, d))
    wave[0, 0] = np.pi / far[0, 0]
    D = np.tensordot(bend(wave, steps), below, 1)
    assert np.linalg.eigvalsh(D)[0, 0] < 0
    proof = certify(steps, below, NOTHING[d])
    assert proof.sampled > 0
    assert not proof.holds


def test_long_waves_that_are_unstable_are_not_proven():
    steps = half_ball(1.5, 3)
    tensors = np.tile(-0.01 * np.eye(3), (len(steps), 1, 1))
    assert not certify(steps, tensors, NOTHING[3]).holds


def test_parts_of_a_matrix():
    rng = np.random.default_rng(1)
    C = rng.normal(size=(5, 3, 3))
    C = C + C.transpose(0, 2, 1)
    above, below = parts(C)
    np.testing.assert_allclose(above - below, C, atol=1e-12)
    assert np.linalg.eigvalsh(np.concatenate([above, below])).min() > -1e-12
