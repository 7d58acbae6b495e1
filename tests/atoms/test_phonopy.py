"""Files of phonopy: the shipped ones, force constants in their place, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from ase.build import bulk
from ase.calculators.emt import EMT

import warp_peri as wp
from warp_peri.core.elastic import allowed_tensors, point_group, voigt
from warp_peri.crystals import from_calculator

EXAMPLES = Path(__file__).parent.parent.parent / "examples" / "phonopy"
STRAINED = (392.963, 164.309, 164.298)
"""C11 and C12 by strains of a period of 3³ cells; C44 of a wider supercell's waves [GPa]."""
COPPER = (172.588, 115.426, 89.904)
"""Under EMT, by finite strains."""


def moduli(atoms):
    """C11, C12, C44 [GPa]."""
    C = 1e3 * voigt(atoms.elastic(allowed_tensors("m-3m", point_group("m-3m", 3), np.eye(3))))
    return C[0, 0], C[0, 1], C[3, 3]


@pytest.fixture(scope="module")
def copper():
    """From the forces of its calculator."""
    return wp.atoms.from_phonopy(EXAMPLES / "copper")


def test_force_sets_are_those_of_the_calculator_and_what_a_supercell_cuts_off_is_an_error(copper):
    """Of copper's forces 3 % of the moment are at half the width; moduli by strains are within."""
    assert len(copper.positions) == 1
    assert moduli(copper) == pytest.approx(COPPER, rel=1e-2)  # its supercell is a little narrow
    with pytest.raises(wp.InputError, match="nodes about as far apart as a cell of the atoms"):
        wp.atoms.crystal_from_force_constants(copper, spacing=3.59e-10)
    found = wp.atoms.crystal_from_force_constants(copper)
    bars = found.content()["standard_errors_GPa"]
    for name, true in zip(("C11", "C12", "C44"), COPPER):
        assert abs(found.law.moduli("GPa")[name] - true) < bars[name] < 0.05 * true


def test_born_charges_make_the_field_of_ions_part_of_every_wave():
    """Magnesium oxide of rigid ions: moduli of finite strains, which a Coulomb cut-off has not."""
    found = wp.atoms.from_phonopy(EXAMPLES / "magnesia")
    assert found.polar is not None
    assert moduli(found) == pytest.approx(STRAINED, rel=5e-3)


def test_what_is_no_file_of_phonopy_and_charges_of_a_sheet_are_refused(tmp_path):
    with pytest.raises(wp.InputError, match="a file of phonopy .* `phonopy-init"):
        wp.atoms.from_phonopy(tmp_path)
    given = (EXAMPLES / "copper" / "phonopy_disp.yaml").read_text()
    assert "- [   3,   0,   0 ]" in given
    for text, words in (
        ("nothing: here\n", "phonopy does not read it"),
        (given.replace("3,", "1.5,", 1), "supercell_matrix: expected whole numbers, got 1.5"),
    ):
        (tmp_path / "phonopy.yaml").write_text(text)
        with pytest.raises(wp.InputError, match=words):
            wp.atoms.from_phonopy(tmp_path)
    with pytest.raises(wp.InputError, match="supercell: expected int values"):
        wp.fit_crystal(bulk("Cu"), EMT(), supercell=(1.5, 2, 2))
    with pytest.raises(wp.InputError, match="BORN: expected a solid"):
        wp.atoms.from_phonopy(EXAMPLES / "magnesia", thickness=4.0)


def test_forces_that_have_not_decayed_at_half_the_width_are_told_by_number(copper):
    """Of eight atoms of copper every other one is as near as its images: nothing can decay."""
    narrow = from_calculator(bulk("Cu", a=3.59), EMT(), (2, 2, 2))
    assert (copper.edge, narrow.edge) == (pytest.approx(0.026, abs=0.002), pytest.approx(1))
    with pytest.warns(UserWarning, match=r"100% of what moduli are made of, .* is at half the"):
        found = wp.atoms.crystal_from_force_constants(narrow, symmetry="m-3m")
    assert found.said["at the supercell's edge"] == "100.0% of Σ |Φ| r²"
