"""What a lattice feels of a body force between its nodes."""

import numpy as np
import pytest

from warp_peri.fe_coupling.boundary_elements import BodyLoads

H = 2.5
LINE = H * np.arange(-12, 13)
NODES = np.stack(np.meshgrid(LINE, LINE, indexing="ij"), axis=-1).reshape(-1, 2)


def felt(b, x=NODES):
    return BodyLoads({}, {}, b).density(x, H)


def test_quadratic_densities_are_felt_as_they_are():
    def b(x):
        return np.stack([1 + x[:, 0] - 0.2 * x[:, 0] * x[:, 1], x[:, 1] ** 2], axis=-1)

    assert felt(b) == pytest.approx(b(NODES), abs=1e-9)
    assert not BodyLoads({}, {}, None).density(NODES, H).any()


@pytest.mark.parametrize("middle", [(0.0, 0.0), (0.9, -0.4), (1.25, 1.25)])
def test_no_force_is_lost_between_nodes(middle):
    """A bump of a triangle's size, wherever it lies; nodes alone would read .6 to 1.7 of it."""

    def b(x):
        bump = np.maximum(0.0, 1 - np.hypot(*(x - middle).T) / 3.0)
        return np.stack([bump, 0 * bump], axis=-1)

    force = 3 * np.pi  # of a cone of height 1 and radius 3
    assert felt(b)[:, 0].sum() * H**2 == pytest.approx(force, rel=0.02)


def test_long_waves_stay_and_those_of_a_mesh_are_damped():
    for length, share in ((40.0, 0.998), (20.0, 0.97)):
        k = 2 * np.pi / length
        there = felt(lambda x: np.stack([np.cos(k * x[:, 0]), 0 * x[:, 0]], -1))  # noqa: B023
        assert there[len(NODES) // 2, 0] == pytest.approx(1, abs=1 - share)
    short = felt(lambda x: np.stack([np.cos(2 * np.pi / 2.5 * x[:, 0]), 0 * x[:, 0]], -1))
    assert np.abs(short).max() < 0.1
