"""Whatever searches for an optimum finds the same material in any units."""

import dataclasses

import numpy as np
import pytest

from tests.support.nonlinear import solid
from tests.support.plates import plate
from tests.support.problems import kernel, lattice, manufactured, smooth
from tests.support.sheets import hgo_dictionary, square
from tests.support.solving import solve_nonlinear
from tests.support.waves import fluctuation, noisy, waves
from warp_peri import Bernstein, InputError, Samples, diagnose, evaluate
from warp_peri.edges.body import solve_body
from warp_peri.learning.fit import learn as fit
from warp_peri.materials.hyperelastic.energy_fit import fit_energy
from warp_peri.materials.hyperelastic.equilibrium import StaticProblem
from warp_peri.materials.hyperelastic.from_displacement import fit_displacement
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.lps import Model, stiffnesses
from warp_peri.materials.third_order import PlacedThirdOrder
from warp_peri.materials.third_order_fit import ThirdOrder
from warp_peri.methods import Conditions, Constrained, Smoothing, sweep
from warp_peri.micromodulus.crystal_fit import Micromodulus
from warp_peri.points.dataset import in_units_of, scaled
from warp_peri.points.families import bond_classes
from warp_peri.points.mesh import Mesh
from warp_peri.points.unit_names import USUAL, check_units, factors
from warp_peri.shapes import InfluenceFunction
from warp_peri.transfers import on_lattice

UNITS = [("nm", "Pa"), ("m", "Pa"), ("mm", "GPa")]
AGREE = 1e-6
HOME = dataclasses.replace(
    kernel("1/r", 3.0), largest_wave_number=2.0, certificate={"1": {"symbol_bound": 0.007}}
)
TRUE = kernel("positive", 2.5, lam=0.1, mu=0.7)
LATTICE = lattice(5, 2.5)


def test_units_by_one_name_and_moduli_in_gpa():
    assert check_units("ase") == ("angstrom", "eV/angstrom^3")
    assert factors("si", "metal") == pytest.approx((1e10, 1e-5))
    assert "GPa" in repr(TRUE)
    assert "700 GPa" in repr(TRUE)
    assert "GPa" in repr(TRUE.in_units("ase"))
    assert "7e+05 MPa" in repr(TRUE.in_units(("mm", "MPa")))
    with pytest.raises(InputError, match="or ase, metal, si, reduced, got 'cgs'"):
        check_units("cgs")


def there(samples, units):
    """Samples in Å and TPa, in other units."""
    return in_units_of(scaled(samples, *factors(USUAL, units)), units)


def numbers(model, spacing=1.0):
    """Stiffnesses of all bonds, moduli and proof of a model on a lattice of a spacing [Å]."""
    home = model.in_units(USUAL)
    v, kappa = stiffnesses(home, bond_classes(spacing, home.horizon))
    return np.concatenate([v, [kappa * home.mu, home.lam, home.mu, home.horizon]])


def length_of(units):
    return factors(USUAL, units)[0]


def transfer(spacing, model=HOME, **asked):
    def run(units, _):
        h = length_of(units)
        lengths = {k: v * h for k, v in asked.items() if k != "tolerance"}
        other = {k: v for k, v in asked.items() if k == "tolerance"}
        found = on_lattice(model.in_units(units), spacing=spacing * h, **lengths, **other)
        record = found.provenance["transfer"]
        bound = found.certificate[f"{spacing * h:g}"]["symbol_bound"] / factors(USUAL, units)[1]
        return np.concatenate([numbers(found, spacing), record["error"], [bound]])

    return run


def body(units, _):
    h, stress = factors(USUAL, units)
    mesh = plate(12.0, 60.0, 8, 32)
    moved = Mesh(mesh.x * h, mesh.triangles, mesh.edges, mesh.middle * h, mesh.parts)
    found = solve_body(
        HOME.in_units(units), moved, displacement={"sides": lambda x: 0.01 * x * (1, -0.3)}
    )
    u, sigma = found.on_corners()
    return np.concatenate([u.ravel() / h, sigma.ravel() / stress, [found.spacing / h]])


MADE = noisy(manufactured(TRUE, LATTICE, 5), 0.02, 5)
WAVES = waves(TRUE, cells=5, highest=3)
QUIET = fluctuation(LATTICE, 4, 0.02, 1)


def learned(samples=MADE, noise=None, kernel=None, **asked):
    def run(units, _):
        quiet = {} if noise is None else {"noise": there(noise, units)}
        made = Bernstein(3) if kernel is None else kernel(units)
        horizon = 2.5 * length_of(units)
        found = fit(there(samples, units), horizon, made, progress=False, **quiet, **asked)
        return numbers(found.material)

    return run


def gaussian(units):
    def K(r, width):
        return np.exp(-((r / width) ** 2))

    return InfluenceFunction(K, {"width": 2.0 * length_of(units)})


def swept(units, path):
    h = length_of(units)
    asked = {"horizons": (2.0 * h, 2.5 * h), "degrees": (0, 2), "jobs": 1}
    train, val = (there(manufactured(TRUE, LATTICE, 5, seed=n), units) for n in (0, 1))
    found = sweep(train, val, path / units[0], progress=False, **asked)
    best = Model.load(path / units[0] / found.cheapest.model)
    return np.append(numbers(best), found.average)


def constants(form):
    def run(units, _):
        h = length_of(units)
        points = lattice(9, 2.5)
        u = 0.02 * smooth(points.x, 6, 0, wave_number=0.8)
        b = np.zeros_like(u)
        b[:, points.interior] = PlacedThirdOrder(solid(form, 2.5), points)(u)
        b *= 1 + 1e-4 * np.random.default_rng(0).normal(size=b.shape)
        law = ThirdOrder(Micromodulus(2.5 * h), Smoothing(2.0 * h, 0.2), form)
        found = law.learn(there(Samples(points, u, b), units)).material
        strain = found.proven_strain(h)
        return np.concatenate([found.in_units(USUAL).numbers, [strain]])

    return run


def third_order_transfer(form):
    def run(units, _):
        h = length_of(units)
        points = lattice(4, 2.5, spacing=0.8)
        x = dataclasses.replace(points, x=points.x * h, spacing=0.8 * h, units=units)
        found = solid(form).in_units(units).at(x)
        u = 0.002 * h * smooth(points.x, 1, 0, wave_number=0.8)
        b = np.zeros_like(u)
        solved = solve_nonlinear(found, x, b, u)
        return np.append(solved.ravel() / h, found.proven_strain(0.8 * h))

    return run


def scattered(units, _):
    points = lattice(9, 4.0)
    x = points.x + 0.15 * np.random.default_rng(0).normal(size=points.x.shape)
    loose = dataclasses.replace(points, x=x, spacing=0.0)
    u = 1e-3 * smooth(x, 1, 0, wave_number=0.6)
    given = there(Samples(loose, u, 0.01 * u), units)
    op = HOME.in_units(units).on(given, allow_uncertified=True)
    return op.rest(given.b, given.u).u / length_of(units)


def errors(units, _):
    table = evaluate(TRUE.in_units(units), there(MADE, units))
    return np.array([table[key] for key in ("E_res", "E_u", "E_shape")])


def causes(units, _):
    found = diagnose(TRUE.in_units(units), there(noisy(WAVES, 0.02, 5), units))
    return np.array([found.residual, *found.shares.values()])


SHEET = square(4, spacing=1.0)


def energies(**asked):
    def run(units, _):
        truth = np.array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])
        u = 0.1 * smooth(SHEET.x, 3, 0, wave_number=0.4)
        b = HyperelasticOperator(hgo_dictionary(), SHEET).everywhere(u, truth)
        b += 1e-2 * np.abs(b).max() * np.random.default_rng(0).normal(size=b.shape)
        stress = factors(USUAL, units)[1]
        stiff = {k: v if v is True else v * stress for k, v in asked.items()}
        found = fit_energy(there(Samples(SHEET, u, b), units), hgo_dictionary(), **stiff)
        return np.append(found.material.coefficients / stress, found.residual)

    return run


def from_displacement(units, _):
    truth = np.array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])
    problem = StaticProblem(HyperelasticOperator(hgo_dictionary(), SHEET))
    edges = SHEET.x @ np.array([[0.1, 0.02], [0.0, 0.08]])
    edges = edges + 0.1 * smooth(SHEET.x, 2, 0, wave_number=0.4)
    u = np.stack([problem.solve(truth, None, edge).u for edge in edges])
    found = fit_displacement(
        there(Samples(SHEET, u), units), hgo_dictionary(), stiffness=0.0, thickness=1, most_steps=3
    )
    return np.append(found.material.coefficients, found.thickness.numbers)


CASES = {
    "finer": transfer(0.6),
    "coarser": transfer(1.9),
    "given horizon": transfer(1.3, horizon=3.9),
    "given tolerance": transfer(0.8, tolerance=0.003),
    "given waves": transfer(0.7, shortest_wave=4.0, largest_horizon=2.9),
    "body": body,
    "fit": learned(),
    "fit, paper": learned(conditions=Conditions("paper")),
    "fit, normalised": learned(normalise=True),
    "fit, two stages": learned(method=Constrained()),
    "fit, corrected": learned(MADE, QUIET, loss="corrected"),
    "fit, output at waves": learned(noisy(WAVES, 0.02, 5), loss="output"),
    "fit, output": learned(MADE, loss="output"),
    "fit, own function": learned(kernel=gaussian),
    "sweep": swept,
    "constants, energy": constants("energy"),
    "constants, filtered": constants("filtered"),
    "third-order transfer, energy": third_order_transfer("energy"),
    "third-order transfer, filtered": third_order_transfer("filtered"),
    "scattered": scattered,
    "errors": errors,
    "causes": causes,
    "sheet": energies(),
    "sheet, positive": energies(positive=True, stiffness=0.12),
    "sheet, stable": energies(positive=True, stable=0.05),
    "sheet from displacement": from_displacement,
}


QUICK = ("given horizon", "fit")
"""Not marked as slow."""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name, marks=[] if name in QUICK else pytest.mark.slow)
        for name, case in CASES.items()
    ],
)
def test_any_units_give_the_same(case, tmp_path):
    usual = case(USUAL, tmp_path)
    assert np.isfinite(usual).all()
    for units in UNITS:
        found = case(units, tmp_path)
        assert found.shape == usual.shape, units
        off = np.abs(found - usual).max() / np.abs(usual).max()
        assert off <= AGREE, (units, off)
