"""What every law must do: a new law is done when it is in the table below and passes."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

import warp_peri as wp
from examples.own_law import Springs
from tests.support.nonlinear import psi, rotation, solid
from tests.support.problems import AXIS, difference, kernel, lattice, noise, periodic
from tests.support.sheets import NEAREST, SPACING, waves
from warp_peri import runtime
from warp_peri.core.groups import point_group, shared_with_nodes
from warp_peri.core.stencil import invariant_basis
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.materials.lps import bernstein_basis
from warp_peri.neural.material import NeuralOperator
from warp_peri.points.dataset import in_units
from warp_peri.points.families import bond_classes
from warp_peri.points.unit_names import factors

pytestmark = pytest.mark.filterwarnings("ignore:strain:UserWarning")
H = np.array([[0.02, 0.03], [-0.01, -0.015]])
"""A displacement gradient."""
TURN = 0.4
OTHER = ("nm", "GPa")
PROVEN = {"1": {"spacing": 1.0, "symbol_bound": 0.15, "statement": "One solution."}}


@dataclass(frozen=True)
class Law:
    """A law under test.

    Attributes:
        material: makes it.
        points: side of the interior and angle [rad] to a lattice that material and nodes turn with.
        stress: material and displacement gradient to the stress of uniform strain.
        energy: whether there is one.
        sheet: a periodic lattice, where the law takes one.
        single: material, points and field to the force in float32, where the law offers it.
        stress_turns, force_turns: whether a finite rotation turns the stress of uniform strain and
            the force of any field.
        horizon: in spacings.
        step: of differences of the force; short for one with kinks.
        load: reads its file.
        fields: whether its moduli differ from node to node.
    """

    material: Callable
    points: Callable
    stress: Callable
    energy: bool = True
    sheet: Callable | None = None
    single: Callable | None = None
    stress_turns: bool = False
    force_turns: bool = False
    horizon: float = 3.0
    step: float = 1e-3
    load: Callable = wp.load
    fields: bool = False

    def on(self, points):
        """The material for some points."""
        if not self.fields:
            return self.material()
        wave = 1 + 0.5 * np.sin(2 * points.x / points.spacing / 3)
        return self.material().spread(points, 0.4 * wave[:, 0], 0.7 * wave[:, 1])


def crystal(side, angle=0.0):
    return replace(lattice(side, 3.0, angle=angle), axis=np.rad2deg(AXIS + angle))


def tissue(side, angle=0.0):
    points = lattice(side, 3 * SPACING, SPACING, angle)
    return replace(points, axis=np.rad2deg(angle))


def linear(name, **moduli):
    """A linear solid whose moduli on the lattice are those of the isotropic continuum."""

    def made():
        model = replace(kernel(name, 3.0, **moduli), certificate=PROVEN)
        classes = bond_classes(1.0, 3.0)
        x, y = classes.xi.T
        uneven = np.bincount(classes.bond_class, (x**4 - 3 * x**2 * y**2) / (x**2 + y**2))
        basis = bernstein_basis(classes.r, 3.0, max(model.degree, 1))
        moment = (uneven * classes.weight * classes.r**-model.alpha) @ basis
        D = np.resize(model.D, len(moment))
        D[-1] -= moment @ D / moment[-1]
        return replace(model, D=D)

    return made


def third_order(form):
    return lambda: replace(solid(form), proven={"strain": 0.03}, provenance={})


def hyperelastic():
    """Of energies with a second derivative everywhere, and directions of its own."""
    terms = [
        EnergyTerm("neo_hookean"),
        EnergyTerm("volumetric"),
        EnergyTerm("along", 1.2),
        EnergyTerm("quadratic 11,22"),
    ]
    terms += [EnergyTerm("shear"), EnergyTerm("volumetric", corner=True)]
    dictionary = Hyperelastic(3.0, ("square", "log"), NEAREST, tuple(terms))
    c = 0.1 + np.random.default_rng(0).random(len(dictionary))
    return HyperelasticMaterial(dictionary, c, SPACING, provenance={"data": "made"})


def hookean(material, H):
    return isotropic(material.lam, material.mu, H)


def isotropic(lam, mu, H):
    strain = (H + H.T) / 2
    return lam * np.trace(strain) * np.eye(2) + 2 * mu * strain


def of_third_order(material, H):
    slope = difference(lambda flat: psi(flat.reshape(2, 2), material), H.ravel(), 1e-3)
    return isotropic(*material.lame, H) + slope.reshape(2, 2)


def of_energies(material, H):
    points = tissue(13)
    op = material.on(points)
    middle = len(points.x) // 2

    def density(flat):
        u = points.x @ flat.reshape(2, 2).T
        return op.nodal_energy(u)[middle]

    return difference(density, H.ravel(), 1e-3).reshape(2, 2)


def cell():
    return periodic((14, 16))[0]


def tensors():
    """A crystal with four axes, its tensors no states of bonds."""
    group = point_group("4mm", 2)
    bonds = invariant_basis(3.0, shared_with_nodes(group, np.eye(2)))
    p = np.random.default_rng(4).normal(size=len(bonds.basis))
    stiff = 1 / (bonds.steps**2).sum(axis=1)[:, None, None] ** 2 * np.eye(2)
    C = stiff + 0.02 * np.tensordot(p, bonds.basis, 1)
    return replace(CrystalMaterial(1.0, bonds.steps, C, symmetry="4mm").certified(), provenance={})


def springs():
    """The law that the example has made outside the library."""
    return Springs(1.0, 3.0, [0.1, 0.2, 0.3]).certified()


def plain(side, angle=0.0):
    return replace(lattice(side, 3.0, angle=angle), axis=np.rad2deg(angle))


def plain_cell():
    return replace(cell(), axis=0.0)


def of_tensors(material, H):
    return np.einsum("ijkl,kl->ij", material.tensor(), H)


def single_tensors(material, points, u):
    return material.on(points, dtype=np.float32)(u)


def network():
    """Springs of either sign, as untrained networks are; few numbers, so few kinks."""
    return NeuralOperator(3.0, (6, 8), (10, 12), proportional=True).double()


def of_network(material, H):
    """Of one node in uniform strain: half of the tensions of its bonds, along their turned ξ."""
    classes = bond_classes(1.0, 3.0)
    xi = torch.from_numpy(classes.xi)
    y = xi + xi @ torch.from_numpy(H).T
    r, e = xi.norm(dim=1), y.norm(dim=1) - xi.norm(dim=1)
    with torch.no_grad():
        omega = material.omega(xi)
        theta = (omega * r * e).sum() / (omega * r**2).sum()
        t = 2 * material.force_state(omega, theta.expand_as(e), e, r)
    return (
        (0.5 * t[:, None, None] * (y / y.norm(dim=1)[:, None])[:, :, None] * xi[:, None])
        .sum(0)
        .numpy()
    )


def single_network(material, points, u):
    force = material.to(torch.float32).on(points)(torch.from_numpy(u.astype(np.float32)))
    return force.detach().numpy()


def saint_venant(E, lam, mu):
    return lam / 2 * E.diagonal(dim1=-2, dim2=-1).sum(-1) ** 2 + mu * (E * E).sum((-1, -2))


def own_energy():
    return wp.DensityMaterial.of(saint_venant, 1.0, {"lam": 0.4, "mu": 0.9})


def of_saint_venant(material, H):
    return (np.eye(2) + H) @ isotropic(*material.parameters.values(), H + H.T @ H / 2)


def load_own_energy(path, units=None):
    found = wp.DensityMaterial.read(path, saint_venant)
    return found if units is None else found.in_units(units)


LINEAR = {"points": crystal, "stress": hookean, "sheet": cell}
CUBIC = {"points": crystal, "stress": of_third_order, "sheet": cell, "stress_turns": True}
LAWS = {
    "LPS": Law(linear("sign-changing"), **LINEAR),
    "LPS, bond-based": Law(linear("positive", lam=0.8), **LINEAR),
    "third order, filtered": Law(third_order("filtered"), energy=False, **CUBIC),
    "third order, energy": Law(third_order("energy"), **CUBIC),
    "crystal": Law(tensors, plain, of_tensors, sheet=plain_cell, single=single_tensors),
    "own": Law(springs, plain, of_tensors, sheet=plain_cell, single=single_tensors),
    "neural operator": Law(
        network,
        plain,
        of_network,
        energy=False,
        single=single_network,
        step=1e-6,
        stress_turns=True,
        force_turns=True,
    ),
    "density": Law(
        own_energy,
        plain,
        of_saint_venant,
        sheet=plain_cell,
        stress_turns=True,
        force_turns=True,
        horizon=1.0,
        load=load_own_energy,
    ),
    "hyperelastic": Law(hyperelastic, tissue, of_energies, stress_turns=True, force_turns=True),
}

SPREAD = LAWS | {"LPS, fields": Law(linear("positive"), fields=True, **LINEAR)}
"""And a material that is for its points alone."""


@pytest.fixture(params=LAWS)
def law(request):
    return LAWS[request.param]


def near(actual, expected, tolerance, size=None):
    """Equal within a part of the size, that of what is expected by default."""
    size = np.abs(expected).max() if size is None else size
    assert np.shape(actual) == np.shape(expected)
    assert np.abs(np.asarray(actual) - expected).max() <= tolerance * size


def placed(law, side=4, angle=0.0):
    points = law.points(side, angle)
    return law.material().on(points), points


def uneven(points, samples=None):
    """Smooth fields with gradients of some percent, one or several."""
    seeds = range(samples or 1)
    fields = np.stack([waves(points, 0.05, seed) for seed in seeds])
    return fields if samples else fields[0]


def solved_samples(law, op, points):
    """Samples that the law's own operator is in equilibrium with."""
    u = uneven(points, 2)
    b = np.zeros_like(u)
    b[:, points.interior] = op(u)
    return wp.Samples(points, u, b)


def test_an_operator_offers_the_contract(law):
    op, points = placed(law)
    assert op.model.units == points.units
    assert op.model.dimension == points.x.shape[1]
    assert op.model.horizon == pytest.approx(law.horizon * points.spacing)
    assert op.points is points
    b = noise(points, 2)
    assert np.array_equal(op.rhs(b), b[:, points.interior])


def test_one_field_is_the_first_of_several(law):
    op, points = placed(law)
    u, v = uneven(points, 2), noise(points, 2)
    near(op(u)[0], op(u[0]), 1e-13)
    near(op.jvp(u, v)[1], op.jvp(u[1], v[1]), 1e-13)
    near(op.stress(u)[1], op.stress(u[1]), 1e-13)
    if law.energy:
        near(op.energy(u)[1], op.energy(u[1]), 1e-13)


def test_a_rigid_motion_and_uniform_strain_give_no_force(law):
    op, points = placed(law)
    size = np.abs(op(uneven(points))).max()
    for gradient in (0 * H, np.array([[0, -0.05], [0.05, 0]]), rotation(0.5) - np.eye(2), H):
        near(op(points.x @ gradient.T + (0.3, -0.2)), 0 * points.x[points.interior], 1e-11, size)


def test_stress_of_uniform_strain(law):
    op, points = placed(law)
    expected = law.stress(law.material(), H)
    near(op.stress(points.x @ H.T), np.tile(expected, (points.interior.sum(), 1, 1)), 1e-9)


def test_momentum_and_its_moment_balance(law):
    """Nodes are moved so far inside that every force they cause is on the interior."""
    op, points = placed(law, 13)
    u = np.zeros_like(points.x)
    u[len(u) // 2] = (0.02 * points.spacing, -0.03 * points.spacing)
    f = op(u)
    assert np.abs(f).max() > 0
    near(f.sum(axis=0), np.zeros(2), 1e-12, np.abs(f).sum())
    x = (points.x + law.force_turns * u)[points.interior]
    x = x - x.mean(axis=0)
    moments = x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]
    if law.force_turns or not law.stress_turns:  # else of second order in the strain
        near(moments.sum(), 0.0, 1e-12, np.abs(moments).sum())


def test_momentum_on_a_periodic_lattice(law):
    if law.sheet is None:
        with pytest.raises(wp.InputError, match="box"):
            law.material().on(wp.Points.sheet((14, 16), SPACING))
        return
    points = law.sheet()
    f = law.material().on(points)(1e-2 * noise(points))
    near(f.sum(axis=0), np.zeros(2), 1e-12, np.abs(f).sum())


def test_a_finite_rotation_turns_stress_and_force(law):
    op, points = placed(law)
    R, u = rotation(0.5), points.x @ H.T
    if law.stress_turns:
        turned = op.stress((points.x + u) @ R.T - points.x)
        near(turned, R @ op.stress(u), 1e-10)  # of Piola: its first index turns
    if law.force_turns:
        u = uneven(points)
        near(op((points.x + u) @ R.T - points.x), op(u) @ R.T, 1e-11)


def test_the_product_is_the_derivative_of_the_force(law):
    op, points = placed(law)
    u, v = uneven(points), points.spacing * noise(points)
    slope = difference(lambda t: op(u + t[0] * v), [0.0], law.step)[0]
    near(op.jvp(u, v), slope, 1e-8)


def test_the_force_is_the_derivative_of_the_energy(law):
    op, points = placed(law)
    u, v = uneven(points), points.spacing * noise(points) * points.interior[:, None]
    if not law.energy:
        assert op.energy(u) is None
        return
    slope = difference(lambda t: op.energy(u + t[0] * v), [0.0], 1e-3)[0]
    near(points.spacing**2 * (op(u) * v[points.interior]).sum(), slope, 1e-8)


def test_a_file_keeps_all_of_it(law, tmp_path):
    material = law.material()
    first, again, theirs, ours = (tmp_path / name / "m.json" for name in "abcd")
    for path in (first, again, theirs, ours):
        path.parent.mkdir()
    wp.save(first, material)
    wp.save(again, law.load(first))
    assert first.read_bytes() == again.read_bytes()
    assert b"One solution." in first.read_bytes() or not isinstance(material, wp.LPSMaterial)
    wp.save(theirs, law.load(first, units=OTHER))
    wp.save(ours, material.in_units(OTHER))
    assert theirs.read_bytes() == ours.read_bytes()
    assert law.load(theirs).units == OTHER


def test_other_units_are_the_same_material_there_and_back(law):
    material = law.material()
    op, points = placed(law)
    u = uneven(points, 1)
    length, stress = factors(points.units, OTHER)
    theirs = in_units(wp.Samples(points, u), OTHER)
    other = material.in_units(OTHER)
    there = other.on(theirs.points)
    near(there(theirs.u), op(u) * stress / length, 1e-12)
    near(there.stress(theirs.u), op.stress(u) * stress, 1e-12)
    back = other.in_units(points.units).on(points)
    near(back(u), op(u), 1e-13)
    assert back.proven == op.proven if hasattr(op, "proven") else True
    with pytest.raises(wp.InputError, match="in_units"):
        material.on(theirs.points)


@pytest.mark.parametrize("name", SPREAD)
def test_threads_change_no_bit(name, monkeypatch):
    monkeypatch.setattr(runtime, "SLICE", 16)  # so that a small lattice is shared out
    law = SPREAD[name]
    points = law.points(8)
    u, v = uneven(points, 2), noise(points, 2)
    before, found = runtime.get_num_threads(), []
    try:
        for count in (1, 2):
            runtime.set_num_threads(count)
            fresh = law.on(points).on(points)
            found.append([fresh(u), fresh.jvp(u, v), fresh.stress(u), fresh.energy(u)])
    finally:
        runtime.set_num_threads(before)
    for one, two in zip(*found):
        assert np.array_equal(one, two)


def test_a_turned_lattice_gives_the_turned_force(law):
    op, points = placed(law)
    other, turned = placed(law, angle=TURN)
    R, u, v = rotation(TURN), uneven(points), noise(points)
    near(turned.x, points.x @ R.T, 1e-14)
    near(other(u @ R.T), op(u) @ R.T, 1e-11)
    near(other.jvp(u @ R.T, v @ R.T), op.jvp(u, v) @ R.T, 1e-11)
    near(other.stress(u @ R.T), R @ op.stress(u) @ R.T, 1e-11)


def test_single_precision(law):
    if law.single is None:
        pytest.skip("the law has double precision only")
    op, points = placed(law)
    u = uneven(points)
    force = law.single(law.material(), points, u)
    assert force.dtype == np.float32
    # forces of single bonds cancel: what is lost is counted against the force of a rough field
    near(force, op(u), 1e-5, np.abs(op(np.abs(u).max() * noise(points))).max())


def test_the_truth_has_no_error(law):
    op, points = placed(law)
    errors = wp.evaluate(op, solved_samples(law, op, points))
    assert errors["E_res"] < 1e-13
    assert errors["E_u"] < 1e-8


def test_a_solve_finds_the_truth(law):
    op, points = placed(law)
    samples = solved_samples(law, op, points)
    held = np.where(points.interior[:, None], np.nan, samples.u)
    solution = wp.solve(op, wp.Dirichlet(points, samples.b, held))
    near(solution.u, samples.u, 1e-8)
    assert solution.residual < 1e-8
    near(solution.stress(), op.stress(samples.u), 1e-7)
    if law.energy:
        near(solution.energy(), op.energy(samples.u), 1e-7)
    else:
        with pytest.raises(wp.InputError, match="energy"):
            solution.energy()
