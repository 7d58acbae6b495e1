"""A material on another lattice: its loss, what is claimed, what takes it; fields on one."""

from dataclasses import replace

import numpy as np
import pytest
from numpy import cos, eye, pi, sin, sqrt
from numpy.linalg import norm

import warp_peri as wp
from tests.support import approx, parametrize, shared
from tests.support.clouds import cloud
from tests.support.problems import OTHER, everywhere, kernel, lattice, manufactured, noise, rotation
from tests.support.solving import solve
from tests.support.told import assert_refused, each_refused, refused, warned
from warp_peri import LPSMaterial, Points, Samples, evaluate
from warp_peri.certificates import critical_time_step
from warp_peri.core import record
from warp_peri.materials import transfer
from warp_peri.materials.lps_law import product_basis, products
from warp_peri.materials.transfer import TOLERANCE, wave_loss, wave_vectors
from warp_peri.methods import Smoothing
from warp_peri.points.dataset import largest_wave_number
from warp_peri.points.families import bond_classes
from warp_peri.points.points import grid_places
from warp_peri.transfers import mean_spacing, on_lattice, onto_lattice

HOME = replace(kernel("1/r", 3.0), largest_wave_number=2.0)
dispersion = lambda model, spacing, k: model.stencil(spacing).symbol(spacing * k)
ASKED = {"spacing": 0.8, "largest_horizon": 1.6}


@shared
def finer():
    return on_lattice(HOME, spacing=0.6)


def test_the_loss_is_the_mean_square_of_the_error_in_displacement():
    model, classes = kernel("sign-changing", 1.5, spacing=0.6), bond_classes(0.6, 1.5)
    k, weight = wave_vectors(1.5)
    target = dispersion(HOME, 1.0, k)
    loss = wave_loss(target, k, 0.6, product_basis(classes), weight)
    value = norm(loss.R @ products(model, classes) - loss.y) ** 2
    wrong = np.linalg.solve(target, dispersion(model, 0.6, k)) - eye(2)
    assert value == approx(weight @ (wrong**2).sum((1, 2)) / 2, rel=1e-10)


@parametrize("angle", [0.0, 0.3])
def test_claims_hold_of_the_operator_on_points(finer, angle):
    """Loads that the material at home answers with a wave, along the axes and off them."""
    record = finer.provenance["transfer"]
    points = lattice(1, finer.horizon, spacing=0.6, angle=angle)
    operator = finer.on(points)
    turn = rotation(angle)
    for wavelength, claimed in list(zip(record["wavelength"], record["error"]))[::8]:
        k = 2 * pi / wavelength * np.array([cos(pi / 8), sin(pi / 8)])
        D = turn @ dispersion(HOME, 1.0, k[None])[0] @ turn.T
        wave = cos(points.x @ turn @ k)  # 1 at the node in the middle
        there = np.array([operator(wave[:, None] * e)[0] for e in eye(2)]).T
        assert norm(np.linalg.solve(there, D) - eye(2), ord=2) <= claimed * (1 + 1e-9)
        assert there == approx(turn @ dispersion(finer, 0.6, k[None])[0] @ turn.T, rel=1e-9)


def test_what_a_record_holds(finer):
    record = finer.provenance["transfer"]
    assert finer.transferred_from == record["from_spacing"] == 1.0
    there = finer.in_units(OTHER).in_units(("mm", "MPa"))
    assert there.transferred_from == approx(1e-7)
    assert on_lattice(there, spacing=0.6e-7).transferred_from == there.certified_on[0]
    assert finer.certified_on == (0.6,)
    assert finer.horizon < 5 * 0.6  # no more bonds than the tolerance needs
    assert record["bonds"] == len(bond_classes(0.6, finer.horizon).steps)
    assert max(record["wavelength"]) > 20 * pi > min(record["wavelength"]) >= 2 * pi / 2.0
    # the tolerance is for waves twice as long as those that the kernel is fitted on
    long = np.array(record["wavelength"]) >= 2 * record["fitted_to"]
    assert np.array(record["error"])[long].max() <= TOLERANCE


def test_what_cannot_be_had():
    assert_refused({
        "spacing: expected at least a 10th of": lambda: on_lattice(HOME, spacing=0.29),
        "needs one of 4 or more": lambda: on_lattice(HOME, spacing=2.0, largest_horizon=3.0),
        "certified on none": lambda: on_lattice(replace(HOME, certified_on=()), spacing=2.0),
    })  # fmt: skip


def test_the_shortest_waves_of_loads():
    points = lattice(12, 2.0, spacing=0.5)
    k = np.array([[0.9, 0.0], [0.5, 1.1]])
    b = cos(points.x @ k.T).T[:, :, None] * (1.0, 0.5)
    samples = Samples(points, b, b)
    assert largest_wave_number(samples) == approx(np.hypot(0.5, 1.1), rel=0.05)
    assert largest_wave_number(replace(samples, arrays={"wave_vector": k})) == np.hypot(0.5, 1.1)
    for change in ({"b": 0 * b}, {"b": None}, {"points": replace(points, spacing=0.0)}):
        assert largest_wave_number(replace(samples, **change)) is None
    samples.arrays["wave_vector"] = k[0]
    with refused(r"wave_vector: expected shape \[2, 2\], got \[2\]"):
        largest_wave_number(samples)


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    monkeypatch.setattr(record, "MADE", {})
    monkeypatch.setattr(transfer, "_said", set())


class Halved(LPSMaterial):
    def stencil(self, spacing):
        whole = super().stencil(spacing)
        return replace(whole, tensors=whole.tensors / 2)


def test_a_process_fits_each_lattice_once_of_the_same_class_and_values(monkeypatch):
    first = on_lattice(HOME, **ASKED)
    assert on_lattice(Halved(**vars(HOME)), **ASKED).mu == approx(first.mu / 2, rel=0.1)
    monkeypatch.setattr(transfer, "_fitted", None)  # would be called to make it anew
    again = on_lattice(replace(HOME), **ASKED)
    assert again.content() == first.content()
    again.certificate["0.8"]["symbol_bound"] = 99  # nobody else's
    assert on_lattice(HOME, **ASKED).content() == first.content()
    for other in (replace(HOME, mu=0.9), replace(HOME, D=0.9 * HOME.D)):
        with pytest.raises(TypeError):
            on_lattice(other, **ASKED)


def test_everything_takes_points_of_another_spacing():
    """Waves in equilibrium with the model at home, on nodes 0.8 apart."""
    model = replace(HOME)
    there = on_lattice(model, spacing=0.8)
    points = manufactured(there, lattice(6, 2.4, spacing=0.8), 2, wave_number=0.5)
    with warned("transferred from 1 Å to 0.8 Å"):
        u = solve(model, points, points.b, points.u)
    # said once: a warning is an error from here on
    assert np.array_equal(u, solve(there, points, points.b, points.u))
    assert np.array_equal(model.on(points)(u), there.on(points)(u))
    table = evaluate(model, points)
    assert table["transferred_from"] == 1.0
    assert table == evaluate(there, points)
    assert table["E_u"] < 1e-9
    sheet = Points.sheet((24, 28), 0.8)
    load = wp.Periodic(sheet, noise(sheet))
    assert np.array_equal(wp.solve(model, load).u, wp.solve(there, load).u)
    step = critical_time_step(model, spacing=0.8, density=1000.0)
    assert step == critical_time_step(there, spacing=0.8, density=1000.0)
    for on, known in ((1.0,), "1 Å"), ((), "no spacing"):
        with refused(f"certified on {known}, not on 0.8 Å"):
            evaluate(replace(HOME, certified_on=on), points, transfer=False)


def test_the_horizon_that_the_collar_carries():
    few = lattice(6, 0.8 * sqrt(5), spacing=0.8)
    with warned("transferred"):
        assert HOME.on(few).model.horizon == approx(0.8 * sqrt(5))


def test_nodes_around_a_free_edge_are_told_of_it():
    """On a lattice that the model is carried to."""
    x = 0.8 * grid_places((24, 24))
    x = x[norm(x - x.mean(0), axis=1) > 3.2]
    holed = Points(x, (np.abs(x - x.mean(0)) < 4.4).all(1), 0.8)
    with refused(r"edges.* Body"):
        solve(HOME, holed, 0 * x, 0 * x)


def test_scattered_points_are_refused_with_both_ways_on():
    u = noise(points := cloud(5, 3.0), 2)
    both = r"not on scattered points, .*transfers\.onto_lattice\(samples, spacing=…\).*allow_unc"
    with refused(both):
        HOME.on(points)
    with warned("not on scattered points"):
        assert HOME.on(points, allow_uncertified=True).model is HOME
    crystal = wp.Crystal(3.0)
    for law in (wp.LPS(3.0), crystal, wp.ThirdOrder(crystal, Smoothing(2.0))):
        with refused(r"got scattered points; transfers\.onto_lattice"):
            wp.fit(wp.Samples(points, u, u), law)


def test_fields_carried_to_a_lattice():
    """By quintic splines, which have quadratic ones as they are."""
    points, powers = cloud(11, 1.0, 0.35), np.array([(0, 0), (1, 0), (1, 1), (0, 2)])
    fields = lambda x: np.stack([(x**p).prod(1)[:, None] * (1.0, -0.5) for p in powers])
    carried = onto_lattice(Samples(points, fields(points.x)), spacing=0.9)
    assert carried.u == approx(fields(carried.x), abs=1e-8)
    assert carried.b is None
    assert mean_spacing(points) == approx(1.0, rel=0.05)
    wave = lambda x: sin(x @ (0.5, 0.4))[None, :, None] * (1.0, 0.3)
    carried = onto_lattice(Samples(points, wave(points.x), 2 * wave(points.x)), spacing=1.0)
    inside = carried.interior
    assert carried.spacing == 1.0
    assert inside.sum() >= points.interior.sum()
    assert np.array_equal(carried.x, np.rint(carried.x))
    assert carried.u[:, inside] == approx(wave(carried.x)[:, inside], abs=1e-3)
    assert carried.b == approx(2 * carried.u)
    left = {"seen": points.x[None, :, 0] < 0, "load_id": np.array(["a"])}
    carried = onto_lattice(Samples(points, wave(points.x)[:1], arrays=left), spacing=1.0)
    near = np.abs(carried.x[:, 0]) > 0.8
    assert np.array_equal(carried.arrays["seen"][0, near], carried.x[near, 0] < 0)
    assert carried.arrays["load_id"].tolist() == ["a"]
    whole = Samples(points, wave(points.x))
    cut = replace(points, outside=points.x[:, 0] > points.x[points.interior, 0].max() + 1)
    assert_refused({
        "points: expected no period": lambda: onto_lattice(replace(whole, points=cut), spacing=1.0),
        "samples: expected one or more": lambda: onto_lattice(whole[[]], spacing=1.0),
        "spacing: expected at most": lambda: onto_lattice(whole, spacing=1e-6),
        "spacing: expected one of nodes in": lambda: onto_lattice(whole, spacing=1000.0),
    })  # fmt: skip
    line = np.c_[np.arange(99.0), np.zeros(99)]
    each_refused(lambda x: onto_lattice(Samples(everywhere(x, 0.0), 0 * x[None]), spacing=1.0), {
        "at least 80 nodes to inter.*, got 30": points.x[:30], "on a line or a conic": line,
    })  # fmt: skip
