"""The solid in three dimensions against LAMMPS (pair_style peri/lps): moduli and forces."""

import numpy as np
import pytest

from tests.support.clouds import cube
from tools.rivals import BULK, SHEAR, SIZE, PeriLps
from warp_peri import LPSMaterial
from warp_peri.atoms.calculators import LammpsError, lammps_class
from warp_peri.materials.lps_force import Bonds
from warp_peri.materials.lps_operator import assemble
from warp_peri.points.families import bond_classes

HORIZON = 2.0
SOLID = LPSMaterial(BULK - 2 * SHEAR / 3, SHEAR, 1.0, np.ones(1), horizon=HORIZON, dimension=3)
"""With LAMMPS's influence function 1/r."""


def test_every_force_is_that_of_lammps_with_its_volumes():
    """They fall off over the last half spacing."""
    try:
        bare = lammps_class()(cmdargs=["-screen", "none", "-log", "none"])
    except LammpsError as error:
        pytest.skip(str(error))
    if not bare.has_style("pair", "peri/lps"):
        pytest.skip("this LAMMPS has no pair_style peri/lps")
    lammps, points = PeriLps(11, HORIZON), cube(3, HORIZON)
    classes = bond_classes(1.0, HORIZON, dimension=3)
    place = {tuple(p): i for i, p in enumerate(np.rint(lammps.x - 4).astype(int))}
    there = [place[tuple(p)] for p in points.x.astype(int)]
    u = SIZE * np.random.default_rng(0).normal(size=lammps.x.shape)
    theirs = lammps.force(u)[there][points.interior]
    lammps.close()
    weight = np.minimum(1.0, HORIZON + 0.5 - classes.r)
    kw, m = weight / classes.r, classes.count @ (weight * classes.r)
    L = assemble(Bonds(points, HORIZON), kw, m).operator(SOLID.lam, SOLID.mu)
    ours = -(L @ u[there].ravel()).reshape(-1, 3)
    assert np.abs(theirs - ours).max() < 1e-5 * np.abs(ours).max()
