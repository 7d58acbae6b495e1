"""`learn`: a structure and a calculator to a law, a picture and what is told of it."""

from __future__ import annotations

import argparse
import io
import re
import tempfile
import time
from pathlib import Path
from typing import Any

import warp_peri
from warp_peri.cli.settings_file import keep
from warp_peri.errors import InputError
from warp_peri.files.atomic import finite, locked, plain, whole_file, write_json, write_text
from warp_peri.sources.dump_files import LARGEST_HEADER, MARKS, encoding_of, unpacked
from warp_peri.storage import save


def run_learn(given: argparse.Namespace) -> dict[str, Any]:
    """A structure → model.json, learn.json, report.txt and law.png, in a folder."""
    begin = time.perf_counter()
    units = given.units[0] if len(given.units) == 1 else tuple(given.units)
    nodes = {"spacing": given.spacing, "horizon": given.horizon, "symmetry": given.symmetry}
    with locked(given.out):  # a place that takes no files is told before the calculator works
        if given.calculator is None:
            constants = warp_peri.atoms.from_phonopy(given.structure, thickness=given.thickness)
            found = warp_peri.atoms.from_force_constants(constants, **nodes, units=units)
        else:
            found = _from_structure(given, nodes, units)
        save(given.out / "model.json", found.material)
        write_json(given.out / "learn.json", finite(plain(found.content())))
        given.told = "\n".join(repr(found).split("\n")[1:])
        write_text(given.out / "report.txt", given.told + "\n")
        with whole_file(given.out / "law.png") as path:
            drawn = io.BytesIO()
            found.plot().savefig(drawn, format="png", dpi=110)
            path.write_bytes(drawn.getvalue())
        keep(given, given.out / "learn.toml")
    seconds = time.perf_counter() - begin
    given.told += (
        f"\n  {seconds:.1f} s; written to {given.out}: model.json, learn.json, report.txt, law.png"
    )
    return {**found.content(), "model": str(given.out / "model.json")}


def _from_structure(given: argparse.Namespace, nodes: dict[str, Any], units: Any) -> Any:
    structure = read_structure(given.structure)
    calculator = warp_peri.atoms.named_calculator(
        given.calculator,
        structure.get_chemical_symbols(),
        given.potential,
        trusted=given.trust or "calculator" not in getattr(given, "from_file", ()),
    )
    return warp_peri.from_atoms(
        structure,
        calculator,
        source=given.source,
        thickness=given.thickness,
        hold=given.hold,
        supercell=given.supercell,
        **nodes,
        units=units,
    )


def read_structure(path: Path) -> Any:
    """The last structure of a file that ASE reads, packed or not; InputError for any other.

    Of a dump that names no elements, or a data file of LAMMPS without masses, ASE would take the
    types for atomic numbers.
    """
    import ase.io

    if path.is_dir():
        raise InputError(f"{path}: expected a file; a folder of phonopy goes without a calculator")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    with path.open("rb") as file:
        start = file.read(LARGEST_HEADER)
    with tempfile.TemporaryDirectory() as folder:
        readable = path
        try:
            with unpacked(path, start) as stream:
                head = stream.read(LARGEST_HEADER)
                if head != start or head.startswith(MARKS):  # ASE goes by the ending alone
                    readable = (
                        Path(folder) / path.with_suffix("" if head != start else path.suffix).name
                    )
                    whole = head + stream.read()
                    if whole.startswith(MARKS):
                        whole = whole.decode(encoding_of(whole)).encode()
                    readable.write_bytes(whole)
                    head = whole[:LARGEST_HEADER]
            if head.startswith(b"ITEM:") and b" element" not in head:
                raise InputError("expected a structure with its elements, got a dump without")
            of_lammps = re.search(rb"xlo\s+xhi", head) is not None
            if of_lammps and not re.search(rb"(?m)^\s*Masses", head):
                raise InputError("expected the masses of the types in a LAMMPS data file, got none")
            form = "lammps-data" if of_lammps else None  # None: as ASE guesses
            found: Any = ase.io.read(readable, index=-1, format=form)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except Exception as error:  # ASE's readers raise whatever their parsing runs into
            why = f"{type(error).__name__}: {error}"
            raise InputError(f"{path}: ASE reads no structure from it ({why})") from None
    return found
