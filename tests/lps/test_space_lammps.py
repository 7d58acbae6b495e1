"""The solid in three dimensions against LAMMPS (pair_style peri/lps): moduli, forces, its box."""

import numpy as np
import pytest

from tests.support.cubes import cube
from tools import peri_lps
from warp_peri.atoms.calculators import LammpsError, lammps_class
from warp_peri.materials.lps import moduli
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_matrices import assemble

HORIZON = 2.0


@pytest.fixture(autouse=True)
def _lammps():
    try:
        if not lammps_class()(cmdargs=["-screen", "none", "-log", "none"]).has_style(
            "pair", "peri/lps"
        ):
            pytest.skip("this LAMMPS has no pair_style peri/lps")
    except LammpsError as error:
        pytest.skip(str(error))


def test_moduli_are_those_of_lammps_and_those_asked_for():
    theirs = peri_lps.measured_moduli(HORIZON)
    bulk, shear = peri_lps.isotropic(theirs)
    assert bulk == pytest.approx(peri_lps.BULK, rel=1e-6)
    assert shear == pytest.approx(peri_lps.SHEAR, rel=1e-6)
    model = peri_lps.solid(HORIZON)
    assert theirs == pytest.approx(moduli(model, peri_lps.lammps_classes(HORIZON)), rel=1e-5)


def test_every_force_is_that_of_lammps_with_its_volumes():
    points, classes = cube(3, HORIZON), peri_lps.lammps_classes(HORIZON)
    lammps = peri_lps.PeriLps(11, HORIZON)
    place = {tuple(p): i for i, p in enumerate(np.rint(lammps.x - 4).astype(int))}
    there = [place[tuple(p)] for p in points.x.astype(int)]
    u = peri_lps.SIZE * np.random.default_rng(0).normal(size=lammps.x.shape)
    theirs = lammps.force(u)[there][points.interior]
    lammps.close()
    kw = classes.weight / classes.r
    m = classes.count @ (classes.weight * classes.r)
    model = peri_lps.solid(HORIZON)
    L = assemble(Bonds(points, HORIZON), kw, m).operator(model.lam, model.mu)
    ours = -(L @ u[there].ravel()).reshape(-1, 3)
    assert np.abs(theirs - ours).max() < 1e-5 * np.abs(ours).max()


def test_its_periodic_box_is_soft_by_the_unwrapped_lengths_in_its_weighted_volume():
    share, errors = peri_lps.periodic_errors(10, HORIZON)
    if errors[True] < 1e-5:
        pytest.skip("this LAMMPS wraps them")
    assert share < 0.7
    assert errors[False] < 1e-5
    assert errors[True] > 0.5
