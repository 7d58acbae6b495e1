"""A material on another lattice: the loss it is fitted with, what is claimed, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import kernel, lattice
from warp_peri import InputError, Samples
from warp_peri.materials.lps_law import product_basis, products
from warp_peri.materials.transfer import TOLERANCE, wave_loss, wave_vectors
from warp_peri.points.dataset import largest_wave_number
from warp_peri.points.families import bond_classes
from warp_peri.transfers import on_lattice

HOME = replace(kernel("1/r", 3.0), largest_wave_number=2.0)


def dispersion(model, spacing, k):
    return model.stencil(spacing).symbol(spacing * k)


@pytest.fixture(scope="module")
def finer():
    return on_lattice(HOME, spacing=0.6)


def test_the_loss_is_the_mean_square_of_the_error_in_displacement():
    model, classes = kernel("sign-changing", 1.5, spacing=0.6), bond_classes(0.6, 1.5)
    k, weight = wave_vectors(1.5)
    target = dispersion(HOME, 1.0, k)
    loss = wave_loss(target, k, 0.6, product_basis(classes), weight)
    value = np.linalg.norm(loss.R @ products(model, classes) - loss.y) ** 2
    wrong = np.linalg.solve(target, dispersion(model, 0.6, k)) - np.eye(2)
    assert value == pytest.approx(weight @ (wrong**2).sum(axis=(1, 2)) / 2, rel=1e-10)


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_claims_hold_of_the_operator_on_points(finer, angle):
    """Loads that the material at home answers with a wave, along the axes and off them."""
    record = finer.provenance["transfer"]
    points = lattice(1, finer.horizon, spacing=0.6, angle=angle)
    operator = finer.on(points)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for wavelength, claimed in list(zip(record["wavelength"], record["error"]))[::8]:
        k = 2 * np.pi / wavelength * np.array([np.cos(np.pi / 8), np.sin(np.pi / 8)])
        D = turn @ dispersion(HOME, 1.0, k[None])[0] @ turn.T
        wave = np.cos(points.x @ turn @ k)  # 1 at the node in the middle
        there = np.array([operator(wave[:, None] * e)[0] for e in np.eye(2)]).T
        wrong = np.linalg.solve(there, D) - np.eye(2)
        assert np.linalg.norm(wrong, ord=2) <= claimed * (1 + 1e-9)
        assert there == pytest.approx(turn @ dispersion(finer, 0.6, k[None])[0] @ turn.T, rel=1e-9)


def test_what_a_record_holds(finer):
    record = finer.provenance["transfer"]
    assert finer.transferred_from == record["from_spacing"] == 1.0
    assert finer.certified_on == (0.6,)
    assert finer.trained_on == HOME.trained_on
    assert record["symbol_bound"] >= 0.99 * 0.01
    assert record["bonds"] == len(bond_classes(0.6, finer.horizon).steps)
    assert record["statement"].startswith("from 1 Å to 0.6 Å")
    assert max(record["wavelength"]) > 20 * np.pi > min(record["wavelength"]) >= 2 * np.pi / 2.0
    # the tolerance is for waves twice as long as those that the kernel is fitted on
    long = np.array(record["wavelength"]) >= 2 * record["fitted_to"]
    assert np.array(record["error"])[long].max() <= TOLERANCE


def test_fewest_bonds_for_a_tolerance():
    bonds = []
    for tolerance in (0.05, 0.004):
        record = on_lattice(HOME, spacing=0.8, tolerance=tolerance).provenance["transfer"]
        bonds.append(record["bonds"])
        assert np.array(record["error"])[np.array(record["wavelength"]) >= 8].max() <= tolerance
    assert bonds[0] < bonds[1]


REFUSED = {
    "the best is": {"tolerance": 1e-5},
    "quadrature: no weights": {"horizon": 3.0},
    "needs one of 4 or more": {"largest_horizon": 3.0},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_had(words):
    with pytest.raises(InputError, match=words):
        on_lattice(HOME, spacing=2.0, **REFUSED[words])
    with pytest.raises(InputError, match="certified on none"):
        on_lattice(replace(HOME, certified_on=()), spacing=0.5)


def test_the_shortest_waves_of_loads():
    points = lattice(12, 2.0, spacing=0.5)
    k = np.array([[0.9, 0.0], [0.5, 1.1]])
    b = np.cos(points.x @ k.T).T[:, :, None] * (1.0, 0.5)
    samples = Samples(points, b, b)
    assert largest_wave_number(samples) == pytest.approx(np.hypot(0.5, 1.1), rel=0.05)
    assert largest_wave_number(replace(samples, arrays={"wave_vector": k})) == np.hypot(0.5, 1.1)
    assert largest_wave_number(replace(samples, b=0 * b)) is None
    assert largest_wave_number(replace(samples, points=replace(points, spacing=0.0))) is None
    assert largest_wave_number(replace(samples, b=None)) is None
