"""Structures to laws, by calculators or phonopy: moduli, sheets and solids, what is refused."""

from dataclasses import replace
from functools import partial

import ase.io
import numpy as np
from ase import Atoms
from ase.build import bulk, graphene, molecule, mx2
from ase.calculators.calculator import Calculator
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from numpy.testing import assert_allclose

import warp_peri as wp
from tests.crystal.crystals import CUBES
from tests.support import ROOT, approx, near, of_json, parametrize, shared
from tests.support.told import assert_refused, each_refused, refused, warned
from warp_peri.atoms import crystal_from_force_constants, from_phonopy
from warp_peri.atoms.calculators import lammps_calculator
from warp_peri.atoms.force_constants import NonAnalyticCorrection, Supercell
from warp_peri.atoms.relaxed import at_rest, usual_spacing
from warp_peri.cli.main import main
from warp_peri.core.elastic import group_of_structure, voigt
from warp_peri.crystals import from_calculator

TERSOFF = "SiC_1989.tersoff"
Opposite = type("Opposite", (EMT,), {"get_stress": lambda *of: -EMT.get_stress(*of)})
IN = {"cell": [4, 4, 4], "pbc": True}
SHARED, SKEWED = {"occupancy": {"0": {"Cu": 0.7, "Ni": 0.3}}}, [[4, 0, 0], [8, 0, 0], [0, 0, 4]]
UNSAID = {"occupancy": {"0": {"Al": "?"}, "1": {"Al": "."}}}
EXAMPLES = ROOT / "examples" / "phonopy"
STRAINED = (392.963, 164.309, 164.298)
"""C11 and C12 by strains of a period of 3³ cells; C44 of a wider supercell's waves [GPa]."""
COPPER = (172.588, 115.426, 89.904)
"""Under EMT, by finite strains."""


def test_the_command_leaves_a_law_a_picture_and_its_figures(tmp_path):
    """Of stretched graphene, from a file."""
    ase.io.write(tmp_path / "sheet.cif", graphene(a=2.529676 * 1.05, vacuum=10))
    line = f"fit-crystal {tmp_path}/sheet.cif --calculator lammps:tersoff --potential {TERSOFF}"
    assert main(f"{line} --hold xx --out {tmp_path}".split()) == 0
    figures = of_json(tmp_path / "crystal.json")
    C = {name: np.array(v) for name, v in figures["elastic_tensor_GPa"].items()}
    near(C["finite strains"], C["law"], 0.005)
    assert C["law"][0, 0] < 0.75 * C["law"][1, 1]  # softer along the stretch
    law = wp.load(tmp_path / "model.json")
    assert law.units == ("angstrom", "GPa")
    assert law.stress[0, 0] > 40
    assert law.certificate.proven > 1
    assert figures["proven_GPa"] == approx(law.certificate.proven)
    assert figures["statement"] == law.certificate.statement  # in the units of the file
    assert figures["holds_to"]["law"] < figures["holds_to"]["local"]
    assert law.symmetry == "2mm"
    assert (tmp_path / "law.png").stat().st_size > 10_000


def revealed(atoms, name):
    """The same with copper in place of the atoms whose array of this name is negative."""
    one = atoms.copy()
    one.numbers[one.arrays.get(name, np.ones(len(one))) < 0] = 29
    return one


class Disguised(EMT):
    """Of what is revealed."""

    def calculate(self, atoms=None, *given):
        super().calculate(revealed(atoms, self.parameters["array"]), *given)
        self.atoms = atoms.copy()


def ordered(name):
    """A cubic cell of four atoms of nickel in layers across z, with an array that orders them."""
    atoms = bulk("Ni", a=3.6, cubic=True)
    atoms.set_array(name, np.where(atoms.positions[:, 2] < 1, 1.0, -1.0))
    return atoms


def test_what_tells_atoms_of_one_element_apart_is_kept_in_the_smallest_cell():
    """By any array; those that are no calculator's own are named. The law is that of the alloy."""
    with warned("one element are told apart by own; delete"):
        rest = at_rest(ordered("own"), Disguised(array="own"))
    assert sorted(np.ravel(rest.cell.arrays["own"])) == [-1, 1]
    name = "initial_magmoms"
    found = wp.fit_crystal(ordered(name), Disguised(array=name), supercell=(5, 5, 4))
    assert len(found.atoms.positions) == 2
    alloy = wp.fit_crystal(revealed(ordered(name), name), EMT(), supercell=(5, 5, 4), units="si")
    tensors = found.tensor, alloy.tensor, alloy.law.tensor(), alloy.strained
    C, wanted, law, true = (1e3 * voigt(one) for one in tensors)
    assert_allclose(C, wanted, atol=1e-4 * C[0, 0])
    assert np.abs(C[2, 2] - C[0, 0]) > 0.01 * C[0, 0]  # it is no nickel
    assert_allclose(law, true, atol=0.005 * C[0, 0])
    assert alloy.material.moduli("GPa")["C11"] == approx(law[0, 0])
    assert alloy.material.units == ("m", "Pa")


@parametrize("flat", [True, False])
def test_disorder_that_relaxes_away_leaves_the_crystal(flat):
    many = (mx2("MoS2", vacuum=10) if flat else bulk("Cu", cubic=True)).repeat((2, 1, 1))
    many.rattle(0.02, seed=1)
    found = at_rest(many, lammps_calculator("sw/mod", ["Mo", "S"], "tmd.sw.mod") if flat else EMT())
    assert len(found.cell) == (3 if flat else 1)
    fractions = found.cell.get_scaled_positions()
    turns = group_of_structure(np.array(found.cell.cell), fractions, found.cell.numbers)
    exact = np.abs(turns - np.rint(turns)).max((1, 2)) < 1e-12
    assert exact.sum() == (4 if flat else 48) * (2 if flat else 1)


EARLY = {
    "symmetry": ("cubic", np.ones((1, 3, 3))), "horizon": (1.0, 1e3), "spacing": (1e-3, 1e6),
    "supercell": ((1.5, 2, 2), (3, 3), (True, 2, 2), (1, 1, 1)),
}  # fmt: skip


def _told(**said):
    of = {f"get_{name}": lambda self, atoms, one=one: one for name, one in said.items()}
    return bulk("Cu"), type("Told", (EMT,), of)


def test_what_is_no_crystal_and_what_a_calculator_or_a_force_lacks_are_refused():
    each_refused(lambda atoms, calculator: wp.fit_crystal(atoms, calculator()), {
        "free cluster": (molecule("H2O"), LennardJones),
        "of Cu 0.7, Ni 0.3": (Atoms("Cu", info=SHARED), EMT),
        "one of Cu half": (Atoms("Cu", info={"occupancy": {"0": {"Cu": "half"}}}), EMT),
        "is a site there": (Atoms("Al2", [[0, 0, 0], [0.1, 0, 0]], **IN, info=UNSAID), EMT),
        "at finite places": (Atoms("Al", [[np.nan, 0, 0]], **IN), EMT),
        "structure: expected masses": (Atoms("Al", masses=[np.nan], **IN), EMT),
        "some in a plane": (Atoms("Al", cell=SKEWED, pbc=True), EMT),
        "no forces for Fe .*No EMT-potential": (bulk("Fe", "fcc", a=5.0), EMT),
        r"calculator: Told: forces: expected shape \[1, 3\], got \[1, 2\]": _told(forces=[[0, 0]]),
        "calculator: Told: forces: expected finite .* got nan": _told(forces=[[0, 0, np.nan]]),
        r"calculator: Told: stress, .*: expected shape \[6\], got \[3\]": _told(stress=[0, 0, 0]),
        r"stress in eV/Å³.* where the energy says 0\.06": (bulk("Cu"), Opposite),
    })  # fmt: skip
    sheet = graphene(vacuum=10)
    one = Atoms("C", [[0, 0, 16.0]], cell=sheet.cell, pbc=True)
    with refused("parts of it feel no force from the rest"):
        wp.fit_crystal(one + sheet, lammps_calculator("tersoff", ["C"], TERSOFF))


def test_how_far_a_cell_went_is_said_and_a_skewed_one_is_made_short():
    far = at_rest(bulk("Al", "fcc", a=5.0), EMT())
    assert far.said["relaxed"].endswith("strains of -20.1% to -20.1%")
    cell = bulk("Cu", a=3.59)
    cell.set_cell([[1, 0, 0], [5, 1, 0], [3, -4, 1]] @ np.array(cell.cell))
    cell.wrap()
    near(at_rest(cell, EMT()).cell.cell.lengths(), 3 * [2.5384], 1e-4)


def test_a_sheet_across_a_face_is_put_together_turned_and_made_small():
    sheet = mx2("MoS2", a=3.17, thickness=3.17, vacuum=10).repeat((2, 3, 1))
    sheet.pbc = True
    sheet.rotate(90, "y", rotate_cell=True)
    sheet.wrap()
    made = lammps_calculator("sw/mod", ["Mo", "S"], "tmd.sw.mod")
    found = at_rest(sheet, made)
    assert len(found.cell) == 3
    assert found.said["axes"] == "turned: x along an edge of the cell, z across"
    with refused("structure: expected a sheet across z"):
        at_rest(sheet, made, hold=["xx"])
    assert found.thickness == approx(3.118 + 3.6, abs=0.01)
    near(usual_spacing(found.cell, True), np.sqrt(3) * found.cell.cell.lengths()[0], 1e-6)


def test_a_solid_is_turned_to_axes_that_nodes_share():
    one = bulk("Si", "diamond", a=5.43)
    turned = one.copy()
    turned.set_cell(ase.cell.Cell.fromcellpar(one.cell.cellpar()), scale_atoms=True)
    found = at_rest(turned, lammps_calculator("sw", ["Si"], "Si.sw"))
    conventional = 5.431 * np.eye(3) @ np.linalg.inv(np.array(found.cell.cell))
    assert_allclose(conventional, np.rint(conventional), atol=1e-3)


@parametrize("flat", [True, False])
def test_a_strain_is_held_along_the_axes_that_it_was_said_in(flat):
    """A turned crystal, stretched along x: turned to its own axes it would give the strain up."""
    one = graphene(a=2.5297, vacuum=10) if flat else bulk("Si", a=5.431)
    one.rotate(*(17, "z") if flat else (40, (1, 2, 3)), rotate_cell=True)
    one.set_cell(np.array(one.cell) @ np.diag([1.02, 1.0, 1.0]), scale_atoms=True)
    made = lammps_calculator("tersoff", ["C"], TERSOFF) if flat else None
    found = at_rest(one, made or lammps_calculator("sw", ["Si"], "Si.sw"), hold=["xx"])
    off = found.stress / found.stress[0, 0]
    assert_allclose(off - np.diag(np.eye(len(off))[0]), 0, atol=1e-3)
    assert found.stress[0, 0] > (1e-2 if flat else 1e-3)
    assert "axes" not in found.said


def moduli(atoms):
    """C11, C12, C44 [GPa]."""
    C = 1e3 * voigt(atoms.elastic(CUBES))
    return C[0, 0], C[0, 1], C[3, 3]


@shared
def copper():
    """From the forces of its calculator."""
    return from_phonopy(EXAMPLES / "copper")


def test_force_sets_are_those_of_the_calculator_and_what_a_supercell_cuts_off_is_an_error(copper):
    """Of copper's forces 3 % of the moment are at half the width; moduli by strains are within."""
    assert len(copper.positions) == 1
    assert moduli(copper) == approx(COPPER, rel=1e-2)  # its supercell is a little narrow
    with refused("nodes about as far apart as a cell of the atoms"):
        crystal_from_force_constants(copper, spacing=3.59e-10)
    with refused(r"they break .* moduli unsure by \d+%"):  # half of x, none of z: mean moduli stay
        wrong = copper.values[None] @ np.diag([0.5, 0, -0.5])
        crystal_from_force_constants(replace(copper, doubt=wrong))
    found = crystal_from_force_constants(copper)
    bars = found.content()["standard_errors_GPa"]
    for name, true in zip(("C11", "C12", "C44"), COPPER):
        assert abs(found.law.moduli("GPa")[name] - true) < bars[name] < 0.05 * true


def test_born_charges_make_the_field_of_ions_part_of_every_wave():
    """Magnesium oxide of rigid ions: moduli of finite strains, which a Coulomb cut-off has not."""
    found = from_phonopy(EXAMPLES / "magnesia")
    assert found.polar is not None
    assert moduli(found) == approx(STRAINED, rel=5e-3)


def test_what_is_no_file_of_phonopy_and_charges_of_a_sheet_are_refused(tmp_path):
    with refused("a file of phonopy .* `phonopy-init"):
        from_phonopy(tmp_path)
    given = (EXAMPLES / "copper" / "phonopy_disp.yaml").read_text()
    assert "- [   3,   0,   0 ]" in given
    forces = (EXAMPLES / "copper" / "FORCE_SETS").read_text().splitlines()
    one, rows = " 1 0 0 0 1 0 0 0 1\n", "\n".join(forces)
    for name, text, words in (
        ("phonopy.yaml", "nothing: here\n", "phonopy does not read phonopy.yaml"),
        ("phonopy.yaml", given.replace("3,", "1.5,", 1), "supercell_matrix: .* whole .* got 1.5"),
        ("FORCE_SETS", "", r"FORCE_SETS: expected 108, .* got 0 sets behind \[0\]"),
        ("FORCE_SETS", "\n".join(forces[:-1]), r"got 0 sets behind \[108\.0, 1\.0\]"),
        ("FORCE_SETS", rows.replace("\n\n1", "\n\n0"), "one of an atom from 1 .* got .* of 0"),
        ("FORCE_SETS", "\n".join([*forces[:-1], "nan 0 0"]), "force constants: expected finite"),
        ("FORCE_CONSTANTS", "1 1000000000\n1 1\n1 0 0", "FORCE_CONSTANTS: expected 1 or 108"),
        ("BORN", f"14.4\n{one}{one}", "born: expected charges .* whose sum is 0 within 0.1 e"),
        ("BORN", f"14.4\n{one}{one}\n{one}", "Too many atoms in the BORN file"),
        ("BORN", f"27\n{one}{one}", r"BORN: expected the factor 14\.3997 or none, got 27"),
        ("BORN", f"nan\n{one}{one}", "BORN: expected the factor .* got nan"),
        ("BORN", f"# e\n 1e12{one[2:]}{9 * ' 0'}", "dielectric: expected at most .* waves"),
    ):
        for one, whole in {"phonopy.yaml": given, "FORCE_SETS": rows, name: text}.items():
            (tmp_path / one).write_text(whole)
        with refused(words):
            from_phonopy(tmp_path)
        (tmp_path / name).unlink()
    cell, two = bulk("Cu"), np.zeros((2, 3, 3))
    assert_refused({
        f"^({'|'.join(EARLY)}): expected": tuple(
            partial(wp.fit_crystal, cell, Calculator(), **{name: value})
            for name in EARLY for value in EARLY[name]
        ),
        "hold: expected all, or of": lambda: wp.fit_crystal(cell, EMT(), hold=[1]),
        "atoms: expected ForceConstants": lambda: wp.crystals.fit_phonons(cell, 3.59, 8.8),
        "calculator: expected an ASE calculator": (
            lambda: from_calculator(cell, None, (2, 2, 2)), lambda: wp.fit_crystal(cell, EMT),
        ),
        "structure: expected one atom": lambda: from_calculator(bulk("Cu", a=np.nan), EMT(), ()),
        "repeats: expected (three counts|a whole number) ≥ 1": tuple(
            lambda n=n: from_calculator(cell, EMT(), (n, 2, 2)) for n in (0, 10**6)
        ),
        "thickness: .* solid": lambda: from_calculator(cell, EMT(), (2, 2, 2), thickness=3.0),
        "structure: expected three edges":
            partial(from_calculator, graphene(), EMT(), (2, 2, 1), thickness=3.0),
        "thickness: .* missing": lambda: from_calculator(graphene(), EMT(), (2, 2, 1)),
        "born: expected 1 charges, got 2":
            lambda: Supercell(cell, cell, [0], polar=NonAnalyticCorrection(two, np.eye(3))),
        "BORN: expected a solid": lambda: from_phonopy(EXAMPLES / "magnesia", thickness=4.0),
    })  # fmt: skip


def test_forces_that_have_not_decayed_at_half_the_width_are_told_by_number(copper):
    """Of eight atoms of copper every other one is as near as its images: nothing can decay."""
    narrow = from_calculator(bulk("Cu", a=3.59), EMT(), (2, 2, 2))
    assert (copper.edge, narrow.edge) == (approx(0.026, abs=0.002), approx(1))
    with warned(r"100% of what moduli are made of, .* is at half the"):
        found = crystal_from_force_constants(narrow, symmetry="m-3m")
    assert found.said["at the supercell's edge"] == "100.0% of Σ |Φ| r²"
