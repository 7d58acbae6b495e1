"""Commands that learn a material from a crystal and a potential, or from frames of a sheet."""

from __future__ import annotations

import itertools
import re
import shlex
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri
from warp_peri.atoms.dic import estimate_noise, frames_of_folder
from warp_peri.cli.commands import Result, Said, lines_of
from warp_peri.cli.options import keep
from warp_peri.cli.train import LINE, ONE
from warp_peri.errors import InputError, warn
from warp_peri.files.atomic import finite, locked, parsed, plain, whole_file, write_json, write_text
from warp_peri.files.foreign import MARKS, check_xml, content, encoding_of
from warp_peri.points.unit_names import USUAL

LARGEST_HEADER = 2**16
"""Bytes of a file of atoms by which its kind is told."""
PACKERS = (".gz", ".bz2", ".xz", ".zst")
REFUSED = ("castep", "bundle")
"""What names of ASE's formats begin with whose readers run a program or look elsewhere."""
NO_FORCE = "are scaled: C11 + C22 + C66 without load is 1, no force is known (--stress gives one)"
UNSAID = "as in the tables; no unit was said"
STEP, PRINTED, ROWS = 0.025, 4, 8
"""Of the stretch in curves; every fourth of them is printed, or fewer, for at most so many rows."""


def run_fit_crystal(given: Namespace) -> Said:
    """A structure → model.json, crystal.json, report.txt and law.png, in a folder."""
    begin, path = time.perf_counter(), given.out / "model.json"
    units = given.units[0] if len(given.units) == 1 else tuple(given.units)
    nodes = {"spacing": given.spacing, "horizon": given.horizon, "symmetry": given.symmetry}
    with locked(given.out):  # a place that takes no files is told before the calculator works
        if given.calculator is None:
            constants = warp_peri.atoms.from_phonopy(given.structure, thickness=given.thickness)
            found: Any = warp_peri.atoms.crystal_from_force_constants(
                constants, **nodes, units=units
            )
        else:
            structure = read_structure(given.structure)
            calculator = warp_peri.atoms.make_calculator(
                given.calculator,
                structure.get_chemical_symbols(),
                given.potential,
                trusted=given.trust or "calculator" not in getattr(given, "from_file", ()),
            )
            found = warp_peri.fit_crystal(
                structure,
                calculator,
                thickness=given.thickness,
                hold=given.hold,
                supercell=given.supercell,
                **nodes,
                units=units,
            )
        warp_peri.save(path, found.material)
        write_json(given.out / "crystal.json", finite(plain(found.content())))
        group, wave, proof = found.law.symmetry, found.holds_to["law"], found.certificate
        sheet = found.said.get("thickness")
        lines = [
            f"{path}: elastic crystal model of {given.structure.resolve().name}"
            + (f", point group {group}" if isinstance(group, str) else "")
            + (f"; moduli of a sheet {sheet} thick" if sheet else ""),
            "displacement under waves: error of at most 2 % down to "
            + (f"{wave:.3g} Å" if np.isfinite(wave) else "no wavelength"),
            f"proven: {ONE}" if proof is not None and proof.holds else "nothing is proven",
            f"next: {shlex.join(['warp-peri', 'info', str(path)])}, or wp.load and wp.solve in "
            "Python",
            LINE,
            *repr(found).split("\n")[1:],
        ]
        write_text(given.out / "report.txt", "\n".join([*lines, ""]))
        _save_figure(found.plot(), given.out / "law.png")
        keep(given, given.out / "fit-crystal.toml")
    names = "model.json, crystal.json, report.txt, law.png"
    lines.append(f"  {time.perf_counter() - begin:.1f} s; in {given.out}: {names}")
    return {**found.content(), "model": str(path)}, lines


def read_structure(path: Path) -> Any:
    """The last structure of a file that ASE reads; InputError for any other.

    Files may be packed; they are looked at first, and read as they were then, from a copy.

    Of a dump that names no elements, or a data file of LAMMPS without masses, ASE would take the
    types for atomic numbers.
    """
    import ase.io
    from ase.io.formats import filetype

    if path.is_dir():
        raise InputError(f"{path}: expected a file; a folder of phonopy goes without a calculator")
    whole = content(path)
    check_xml(path, whole)
    if whole.startswith(MARKS):
        whole = whole.decode(encoding_of(whole), "replace").encode()
    name = path.with_suffix("") if path.suffix.lower() in PACKERS else path
    with tempfile.TemporaryDirectory() as folder:  # ASE goes by the ending alone
        readable = Path(folder) / name.name
        readable.write_bytes(whole)
        try:
            head = whole[:LARGEST_HEADER]
            if head.startswith(b"ITEM:") and b" element" not in head:
                raise InputError("expected a structure with its elements, got a dump without")
            of_lammps = re.search(rb"xlo\s+xhi", head) is not None
            if of_lammps and not re.search(rb"(?m)^\s*Masses", head):
                raise InputError("expected the masses of the types in a LAMMPS data file, got none")
            form = "lammps-data" if of_lammps else filetype(str(readable))
            if form.startswith(REFUSED):
                raise InputError(
                    f"expected another format than {form}, whose reader runs a program"
                )
            if form == "json":  # brackets within brackets end the process
                parsed(whole)
            found: Any = ase.io.read(str(readable), -1, form, do_not_split_by_at_sign=True)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except Exception as error:  # ASE's readers raise whatever their parsing runs into
            why = f"{type(error).__name__}: {error}"
            if "atom_style" in why:
                why += "; a data file of LAMMPS says it behind Atoms, as in: Atoms # charge"
            raise InputError(f"{path}: ASE reads no structure from it ({why})") from None
    return found


def run_fit_sheet(given: Namespace) -> Said:
    """Frames → material.json, sheet.json, curves and every candidate's file, in a folder."""
    frames = frames_of_folder(
        given.folder,
        given.count,
        pixel=given.pixel,
        radius=given.smooth,
        positions=given.positions,
        stress=given.stress,
        along=given.along,
    )
    length_known = frames.points.units != USUAL  # what frames without a unit are taken for
    if given.stress and not length_known:
        raise InputError("stress: it needs a length; expected --pixel with a unit, as 0.012mm")

    def done(candidate: Any) -> None:
        """Each is kept as it ends."""
        if candidate.fit is None:
            warn(f"passed over: {candidate.why}")
            return
        name = candidate.name.replace(", ", "_").replace(" ", "_")
        warp_peri.save(given.out / f"{name}.json", candidate.fit.material)
        if not given.json:
            error = f"{100 * candidate.held_out:.3f} %"
            print(f"{candidate.name}: error of displacement {error}", flush=True)

    with locked(given.out):
        choice = warp_peri.hyperelastic.select_model(
            frames,
            fibres=given.fibres,
            uneven=not given.even,
            folder=given.out / "fits",  # where a second start goes on from
            done=done,
            progress=given.progress,
        )
        warp_peri.save(given.out / "material.json", choice.material)
        result, shown = _written(given, choice)
        told = {
            "frames": len(frames),
            "interior": int(frames.interior.sum()),
            "noise_in_spacings": float(np.median(estimate_noise(frames)) / frames.spacing),
            "lengths": frames.points.units[0] if length_known else UNSAID,
        }
        result = finite(told | result)
        write_json(given.out / "sheet.json", result)
        keep(given, given.out / "fit-sheet.toml")
    path, stress = given.out / "material.json", "; stresses in MPa need a force: --stress"
    first = [
        f"{path}: material of a sheet, {choice.best.name}",
        f"error of displacement: {100 * choice.best.held_out:.2g} % on frames left out",
        shown,
        f"next: warp-peri info {shlex.quote(str(path))}{'' if given.stress else stress}",
    ]
    return result, [*first, LINE, *lines_of(result)]


def _written(given: Namespace, choice: Any) -> tuple[Result, str]:
    """What a sheet is made of, its curves in files where there are any, and a line on them."""
    material, candidates = choice.material, choice.candidates
    told = NO_FORCE
    if given.stress:
        scatter = f"{100 * choice.fit.scatter:.2g}"
        told = f"are in MPa by --stress; sections and frames scatter by {scatter} % around it"
    words = [*warp_peri.hyperelastic.in_words(material), *_beside(choice.fit)]
    words.append(f"stresses and coefficients {told}")
    try:
        warp_peri.hyperelastic.save_febio(material, given.out / "material.feb")
        words.append("material.feb carries all but the deviations and the thickness")
    except InputError as error:
        words.append(f"no file for FEBio: {error}")
    stretches = np.arange(1.0, max(1.05, material.stretch or 1.2) + 1e-9, STEP)[1:]
    curves: Result = {}
    shown = f"curves: {given.out / 'curves.png'}, stress over stretch with a 90 % band"
    try:
        curves = {f"{a:g} deg": choice.curves(stretches, np.radians(a)) for a in (0, 45, 90)}
        _write_curves(given.out, stretches, curves, "MPa" if given.stress else "scaled")
    except InputError as error:
        words.append(shown := f"no curves: {error}")
    each = PRINTED * -(-len(stretches) // (PRINTED * ROWS))
    result = {
        "stresses": told,
        "material": choice.best.name,
        "words": words,
        "held_out_E_u": {one.name: one.held_out for one in candidates if np.isfinite(one.held_out)},
        "passed_over": [one.why for one in candidates if one.fit is None],
        "largest_stretch": float(material.stretch or np.nan),
        "tension_with_90_percent_band": {
            f"along {name}": {
                f"stretch {stretches[n]:g}": np.array(curve)[:, n].tolist()
                for n in range(each - 1, len(stretches), each)
            }
            for name, curve in curves.items()
        },
    }
    return result, shown


def _beside(fit: Any) -> list[str]:
    """What is in a sheet beside its material: deviations, which are the lattice's, a thickness."""
    own = slice(fit.material.dictionary.first_deviation, fit.material.dictionary.first_term)
    numbers = ", ".join(f"{value:.4g}" for value in fit.material.coefficients[own])
    lines = [f"deviations, which belong to the lattice: {numbers}"]
    if fit.thickness is not None:
        pairs = zip(fit.thickness.names, fit.thickness.numbers)
        shown = ", ".join(f"{name}: {value:.4g}" for name, value in pairs)
        lines.append(f"logarithm of the thickness, positions from -1 to 1: {shown}")
    return lines


def _write_curves(folder: Path, stretches: np.ndarray, curves: dict[str, Any], unit: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    columns, names = [stretches], ["stretch"]
    for (name, band), style in zip(curves.items(), itertools.cycle(("-", "--", ":"))):
        middle, low, high = band  # which may coincide with another's
        (line,) = axes.plot(stretches, middle, linestyle=style, label=name)
        axes.fill_between(stretches, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
        columns += band
        names += [f"P {name}", f"low {name}", f"high {name}"]
    ends = [middle[-1] for middle, _, _ in curves.values()]
    said = f"Directions differ by {100 * (max(ends) / min(ends) - 1):.1f} % in stress"
    axes.set(xlabel="stretch", ylabel=f"nominal stress [{unit}]", title=said)
    axes.legend(frameon=False, title="tension along\n(90 % bands)")
    _save_figure(figure, folder / "curves.png")
    with whole_file(folder / "curves.csv") as path:
        table = np.transpose(columns)
        np.savetxt(path, table, "%.8g", ",", header=",".join(names), comments="")


def _save_figure(figure: Any, path: Path) -> None:
    with whole_file(path) as part, open(part, "wb") as file:
        figure.savefig(file, format="png", dpi=110)
