"""Every material under test, once: what makes it, its points, and its operators by name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import torch
from numpy.random import default_rng

import warp_peri as wp
from examples.own_law import Springs
from tests.crystal.crystals import learned
from tests.support import clouds, problems
from tests.support.fields import solved_samples as solved_samples
from tests.support.nonlinear import psi, solid
from tests.support.problems import AXIS, difference, kernel, lattice, periodic
from tests.support.sheets import SPACING, dictionary_of
from warp_peri.crystals import crystal_from_lps
from warp_peri.fracture import lattice_body
from warp_peri.fracture.statics import CutSolid
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.materials.lps import bernstein_basis
from warp_peri.neural.material import NeuralOperator
from warp_peri.points.families import bond_classes

H = np.array([[0.02, 0.03], [-0.01, -0.015]])
"""A displacement gradient."""
CRACK = [[(-2.0, 0.1), (1.0, 0.1)]]
DEEP = clouds.solid(2.0, 0.5, 0.8, D=[1.0, 0.6, 1.4], certified_on=(1.0,))
"""A linear solid in space."""
third_order = lambda form: lambda: replace(solid(form), proven={"strain": 0.03}, provenance={})
network = lambda: NeuralOperator(3.0, (6, 8), (10, 12), proportional=True).double()
"""Springs of either sign, as untrained networks are; few numbers, so few kinks."""
own_energy = lambda: wp.DensityMaterial.of(saint_venant, 1.0, {"lam": 0.4, "mu": 0.9})
frozen = lambda: network().requires_grad_(False).on(LAWS["neural operator"].points(4))
"""A network of single precision whose numbers ask for no gradient."""


@dataclass(frozen=True)
class Law:
    """A law under test, its lengths in spacings."""

    material: Callable
    stress: Callable  # of a material and a displacement gradient, in uniform strain
    axis: float = 0.0  # of the material on an unturned lattice [rad]
    energy: bool = True
    periodic: bool = True  # whether it takes a periodic lattice
    stress_turns: bool = False  # that of uniform strain, with a finite rotation
    force_turns: bool = False  # that of any field
    horizon: float = 3.0
    collar: float = 3.0  # half of its width
    spacing: float = 1.0  # [Å]
    fields: bool = False  # whether its moduli differ from node to node

    def points(self, side, angle=0.0):
        """A lattice of a side's interior, turned with the material by an angle [rad]."""
        points = lattice(side, self.collar * self.spacing, self.spacing, angle)
        return replace(points, axis=np.rad2deg(self.axis + angle))

    def sheet(self):
        return replace(periodic((14, 16), self.spacing)[0], axis=np.rad2deg(self.axis))

    def on(self, points):
        """The material for some points."""
        if not self.fields:
            return self.material()
        wave = 1 + 0.5 * np.sin(2 * points.x / points.spacing / 3)
        return self.material().spread(points, 0.4 * wave[:, 0], 0.7 * wave[:, 1])


def linear(name, **moduli):
    """A linear solid whose moduli on the lattice are those of the isotropic continuum."""

    def made():
        proven = {"1": {"spacing": 1.0, "symbol_bound": 0.15, "statement": "One solution."}}
        model = replace(kernel(name, 3.0, **moduli), certificate=proven)
        classes = bond_classes(1.0, 3.0)
        x, y = classes.xi.T
        uneven = np.bincount(classes.bond_class, (x**4 - 3 * x**2 * y**2) / (x**2 + y**2))
        basis = bernstein_basis(classes.r, 3.0, max(model.degree, 1))
        moment = (uneven * classes.weight * classes.r**-model.alpha) @ basis
        D = np.resize(model.D, len(moment))
        D[-1] -= moment @ D / moment[-1]
        return replace(model, D=D)

    return made


def hyperelastic():
    """Of energies with a second derivative everywhere, and directions of its own."""
    kinds = ("neo_hookean",), ("volumetric",), ("fibre_power", 1.2, 4.0), ("mooney",)
    places = ("volumetric", 0.0, 0.0, True), ("volumetric", 0.0, 0.0, False, (1, 2))
    dictionary = dictionary_of(*kinds, *places)
    c = 0.1 + default_rng(0).random(len(dictionary))
    return HyperelasticMaterial(dictionary, c, SPACING, provenance={"data": "made"})


@cache
def springs():
    """The law that the example has made outside the library."""
    return Springs(1.0, 3.0, [0.1, 0.2, 0.3]).certified()


def saint_venant(E, lam, mu):
    return lam / 2 * E.diagonal(dim1=-2, dim2=-1).sum(-1) ** 2 + mu * (E * E).sum((-1, -2))


def isotropic(lam, mu, H):
    strain = (H + H.T) / 2
    return lam * np.trace(strain) * np.eye(2) + 2 * mu * strain


def of_third_order(material, H):
    slope = difference(lambda flat: psi(flat.reshape(2, 2), material), H.ravel(), 1e-3)
    return isotropic(*material.lame, H) + slope.reshape(2, 2)


def of_energies(material, H):
    op, points = placed("hyperelastic", 1)
    (middle,) = np.flatnonzero(points.interior)
    density = lambda flat: op.nodal_energy(points.x @ flat.reshape(2, 2).T)[middle]
    return difference(density, H.ravel(), 1e-3).reshape(2, 2)


def of_saint_venant(material, H):
    return (np.eye(2) + H) @ isotropic(*material.parameters.values(), H + H.T @ H / 2)


def of_network(material, H):
    """Of one node in uniform strain: half of the tensions of its bonds, along their turned ξ."""
    xi = torch.from_numpy(bond_classes(1.0, 3.0).xi)
    y = xi + xi @ torch.from_numpy(H).T
    r, e = xi.norm(dim=1), y.norm(dim=1) - xi.norm(dim=1)
    with torch.no_grad():
        omega = material.omega(xi)
        theta = (omega * r * e).sum() / (omega * r**2).sum()
        t = 2 * material.force_state(omega, theta.expand_as(e), e, r)
    return torch.einsum("b,bi,bj->ij", t / y.norm(dim=1) / 2, y, xi).numpy()


LPS = {"stress": lambda m, H: isotropic(m.lam, m.mu, H), "axis": AXIS}
CUBIC = {"stress": of_third_order, "axis": AXIS, "stress_turns": True}
CRYSTAL = {"stress": lambda m, H: np.einsum("ijkl,kl->ij", m.tensor(), H)}
TURNS = {"stress_turns": True, "force_turns": True}
LAWS = {
    "LPS": Law(linear("sign-changing"), **LPS),
    "LPS, bond-based": Law(linear("positive", lam=0.8), **LPS),
    "third order, filtered": Law(third_order("filtered"), energy=False, **CUBIC),
    "third order, energy": Law(third_order("energy"), **CUBIC),
    "crystal": Law(lambda: learned(2), **CRYSTAL, horizon=5**0.5, spacing=1.5),
    "own": Law(springs, **CRYSTAL),
    "neural operator": Law(network, of_network, energy=False, periodic=False, **TURNS),
    "density": Law(own_energy, of_saint_venant, horizon=1.0, collar=1.0, **TURNS),
    "hyperelastic": Law(hyperelastic, of_energies, periodic=False, spacing=SPACING, **TURNS),
}
SPREAD = LAWS | {"LPS, fields": Law(linear("positive"), fields=True, **LPS)}
"""And a material that is for its points alone."""


@cache
def placed(name, side=4, angle=0.0):
    """A material's operator and its points."""
    points = SPREAD[name].points(side, angle)
    return SPREAD[name].on(points).on(points), points


def scattered():
    return kernel("1/r", 3.0).on(clouds.cloud(5, 3.0, 0.45, seed=3), allow_uncertified=True)


def torn():
    """An LPS whose bonds to nodes outside of the body are broken."""
    points = lattice(5, 3.0)
    return kernel("sign-changing", 3.0).on(problems.cut(points, points.x[:, 0] > 2.5))


def conductor():
    points = lattice(4, 1.5)
    law = wp.diffusion.DiffusionMaterial(3.0, 1.3, 0.7, np.array([1.0, 0.4]))
    return law.on(points, kappa=np.exp(0.3 * np.sin(points.x[:, 0])))


def coupled():
    model = clouds.plain(3.0, 1.0, D=[1.0, 0.6])
    conductor = wp.diffusion.DiffusionMaterial(3.0, 1.0, D=np.array([1.0, 0.4]))
    return wp.diffusion.ThermoelasticMaterial(model, conductor, 0.4, 1.0).on(lattice(4, 3.0))


def cut():
    """A cracked body, one node of which is held along one axis."""
    points, model = lattice(4, 3.0), clouds.plain(3.0, 0.9, 0.4, D=[1.0, 0.6, 0.3])
    held = np.repeat(~points.interior[:, None], 2, axis=1)
    held[np.flatnonzero(points.interior)[3], 0] = True
    return CutSolid(model, lattice_body(points.x, 1.0, 3.0), held, cracks=CRACK)


OPERATORS = {name: lambda name=name: placed(name)[0] for name in LAWS} | {
    "crystal, periodic": lambda: learned(2).on(LAWS["crystal"].sheet()),
    "neural operator, frozen": frozen,
    "scattered, own weights": scattered,
    "LPS, broken bonds": torn,
    "LPS in space": lambda: DEEP.on(clouds.cube(2, 2.0)),
    "crystal in space": lambda: crystal_from_lps(DEEP, 1.0).on(clouds.cube(2, 2.0)),
    "conductor": conductor,
    "coupled": coupled,
    "cut": cut,
}
NONLINEAR = ("third order", "neural", "hyperelastic", "density")
LINEAR = [name for name in OPERATORS if not any(word in name for word in NONLINEAR)]
KINKED = ("neural operator", "neural operator, frozen")
"""Of which a step of differences is short."""
FLOWS = ("conductor", "coupled")
"""Materials that flow, by implicit steps."""


@cache
def operator(name):
    """The operator of a name, made once; tests that change it take a copy."""
    return OPERATORS[name]()
