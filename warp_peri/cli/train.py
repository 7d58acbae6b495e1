"""Commands that learn: dumps to data, and data, a crystal or frames of a sheet to a model."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import shlex
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

import warp_peri
from warp_peri.atoms import dumps
from warp_peri.atoms.coarse_graining import smoothing_matrix
from warp_peri.atoms.dic import estimate_noise, frames_of_folder
from warp_peri.cli.commands import Said, chosen, error_table, keep, lines_of, writing
from warp_peri.cli.main import beside, check_made, hash_of
from warp_peri.errors import InputError, Values, warn
from warp_peri.files.atomic import (
    SMALL,
    content,
    finite,
    locked,
    read_arrays,
    whole_file,
    write_json,
)
from warp_peri.fitting.evaluate import Run, train
from warp_peri.materials import lps_law
from warp_peri.points.arguments import REDUCED, USUAL, checked, is_number, symbols, usual_lengths
from warp_peri.points.dataset import Dataset, content_hash, load_dataset, save_dataset
from warp_peri.points.points import Points, Samples

HORIZON = 20.0
"""δ [Å] that is learned where nothing else was asked for."""
OF_LPS = "influence", "noise", "method", "loss", "degree"
OF_CALCULATORS = "potential", "trust", "hold", "supercell"
"""Options that mean nothing to other laws, and to force constants."""
KINDS = {
    "lps": "linear peridynamic solid (LPS)",
    "tensors": "crystal model",
    "third-order": "crystal model with third-order constants",
}
HELD_OUT = "test", "val"
"""Materials by the word of --law; sets that say how good a model is, the first that is there."""
TYPED_BOX = 1e-3
"""Relative difference of a typed period from that of the dump."""
ONE = "exactly one equilibrium for every load"
GRAINED: Values = {"source": "warp-peri coarse-grain"}
LINE = 72 * "-"
"""Between what there is, how good it is and what comes next, and the details."""

STEP = 0.025
"""Of the stretch in curves."""


def run_coarse_grain(given: Namespace) -> Said:
    """Coarse-grain dumps to a set of a data file; other sets of the file stay."""
    _take_sheet(given)
    if not 0 < given.spacing <= given.interior < given.reach:
        raise InputError(
            "spacing, interior, reach: expected 0 < spacing ≤ interior < reach, got "
            f"{given.spacing:g}, {given.interior:g}, {given.reach:g} Å"
        )
    size, around = given.interior, {"spacing": given.spacing}
    around["horizon"] = (given.reach - size) / 2
    sheet = Points.block(2 * [2 * size], **around) if given.box else Points.disk(size, **around)
    none = Samples(sheet, np.zeros((0, *sheet.x.shape)))
    Dataset({given.set: none}, given.thickness, given.density)  # checked before dumps are read
    frame = next(dumps.iter_dump(given.reference))
    reference, box = frame.x, frame.box if given.box else None  # typed lengths are rounded
    if given.box:
        dumps.check_box(given.reference, tuple(given.box), box, TYPED_BOX)
    limit = min(box) / 2 if box else float(np.ptp(reference, axis=0).max())
    if given.radius > limit:
        what = "half the smallest period" if box else "the extent of the body"
        raise InputError(f"radius: expected at most {limit:g} Å, {what}, got {given.radius:g} Å")
    force = np.stack([atom_forces(path, len(reference)) for path in given.force])
    mass = dumps.read_masses(given.reference, given.mass) if given.mass else 1.0
    points = dataclasses.replace(sheet, x=sheet.x + reference.mean(axis=0))
    omega = smoothing_matrix(reference, points.x, box=box, **chosen(given, "radius", "spacing"))
    atoms = dumps.ReferenceAtoms(reference, mass, frame.ids, box)
    how = chosen(given, "thickness", "skip", "progress") | {"unloaded": given.unloaded or []}
    how |= {"force": force, "node_area": given.spacing**2}
    samples = dumps.coarse_grain_dumps(given.dumps, omega, points, atoms, **how)
    with locked(given.out):
        data = _take_sheet(given)  # another job may have written it meanwhile
        data = data or Dataset({given.set: samples}, given.thickness, given.density, GRAINED)
        alike = {*data} <= {given.set} or radius_of(data) == given.radius
        cone = {"shape": "cone", "radius": given.radius if alike else None}
        said = {**data.provenance, "smoothing": cone}
        made = dataclasses.replace(data, sets={**data.sets, given.set: samples}, provenance=said)
        with whole_file(given.out) as aside:
            save_dataset(aside, made)
            keep(given, *_set_of(given, made))  # a job that is killed between is done again
    result = {"file": str(given.out), "set": given.set, **samples.summary()}
    return result, lines_of(result)


def _take_sheet(given: Namespace) -> Dataset | None:
    """Set thickness and density from the data file, if it exists, and return its data."""
    before = load_dataset(given.out) if given.out.exists() else None
    for name, unit, why in (
        ("thickness", "Å", "forces become stresses by it: all moduli go as one over it"),
        ("density", "kg/m³", "waves go by it"),
    ):
        asked, kept = getattr(given, name), getattr(before, name, None)
        if asked is None and kept is None:
            raise InputError(f"{name}: expected --{name} of the sheet [{unit}], got none; {why}")
        if before and asked not in (None, kept):
            raise InputError(
                f"{name}: {given.out} has {kept:g} {unit}, got {asked:g} {unit}; in Python "
                f"wp.load(path).of_sheet({name}={asked:g}) is the file corrected"
            )
        given.options[name] = asked if before is None else kept
        setattr(given, name, given.options[name])
    if before and given.set in before:
        check_made(given, *_set_of(given, before))
    return before


def _set_of(given: Namespace, data: Dataset) -> tuple[Path, dict[str, str]]:
    """Settings file of a set of a data file, and the set's hash, by its name."""
    own = dataclasses.replace(data, sets={given.set: data[given.set]}, provenance=GRAINED)
    name = given.set.replace("%", "%25").replace(".", "%2E")  # a.h5 can have b.c, and a.b.h5 c
    return beside(given.out, f"{name}.coarse-grain"), {
        f"{given.out}: set '{given.set}'": content_hash(own)
    }


def atom_forces(path: Path, atoms: int) -> ndarray:
    """Read external forces on the atoms [eV/Å], shape [A, 2], from .npz or text with commas."""
    try:
        if path.suffix == ".npz":
            (force,) = read_arrays(path, SMALL + 32 * atoms).values()
        else:
            force = np.loadtxt(io.BytesIO(content(path)), delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: expected one array in .npz (numpy.savez, not compressed), or a .csv file "
            f"({error})"
        ) from None
    columns = f"{path}: f_x, f_y [eV/Å] alone, rows in the order of the atoms' ids"
    return checked(columns, force, float, (atoms, 2))


def run_fit(given: Namespace) -> Said:
    """Fit a material to data; writes model.json, metrics.json and the settings to a folder."""
    data = load_dataset(given.data, units=given.units)
    made = {"data_provenance": data.provenance, "sha256": hash_of(given.data)}
    samples = data[given.set]
    options: Values = {} if given.noise is None else {"noise": data[given.noise]}
    if given.horizon is None:
        given.horizon = float(usual_lengths("horizon", HORIZON, data.units))
    law = _law(given, data)
    with writing(given) as begin:
        run = train(law, samples, data.sets, progress=given.progress, **options)
        metrics, why = _metrics(run), []
        with contextlib.suppress(InputError):  # scattered points, too few samples, third order
            found = warp_peri.diagnose(run.fit.material, samples, **options)
            metrics["residual"] = {"why": found.sentence, **found.shares}
            shares = ", ".join(f"{name} {100 * one:.1f}" for name, one in found.shares.items())
            why = [f"why: {found.sentence}", f"shares of the squared residual [%]: {shares}"]
            if found.advice:
                warn(found.advice)
        metrics |= chosen(data, "thickness", "density")
        begin()
        run.save(given.out, metrics, data=given.data, provenance=made)
    tables = {name: {"samples": len(data[name]), **one} for name, one in run.tables.items()}
    tables |= {name: {"error": why} for name, why in run.refused.items()}
    lines = [*_first(given, metrics, data), LINE, *repr(run.fit.material).split("\n")[1:], *why]
    model = str(given.out / "model.json")
    return {**metrics, "model": model}, [*lines, *error_table(tables, data.units)]


def radius_of(data: Dataset) -> float | None:
    """Radius, in the data's unit, that a file names of the cone that smoothed them; or None."""
    smoothing = data.provenance.get("smoothing")
    radius: Any = smoothing.get("radius") if isinstance(smoothing, Mapping) else None
    known = is_number(radius) and radius > 0 and data.units != REDUCED
    return float(usual_lengths("radius", radius, data.units)) if known else None


def _law(given: Namespace, data: Dataset) -> Any:
    """Material to learn, by the options; InputError for options of an LPS with another material."""
    if given.law == "lps":
        if given.influence is not None and given.degree is not None:
            raise InputError("degree, influence: expected one of the two")
        kernel: Any = None if given.degree is None else lps_law.Bernstein(given.degree)
        if given.influence is not None:
            kernel = warp_peri.influence.named(given.influence, given.horizon)
        method = lps_law.METHODS[given.method]()
        return warp_peri.LPS(given.horizon, kernel, method, loss=given.loss)
    _check_idle(given, OF_LPS, f"--law lps, not {given.law}")
    law = warp_peri.Crystal(given.horizon)
    if given.law == "tensors":
        return law
    if (radius := radius_of(data)) is None:
        radius, unit = 2 * data[given.set].spacing, symbols(data.units)[0]
        warn(f"smoothing: the data name no radius; taken is {radius:g} {unit}, two spacings")
    return warp_peri.ThirdOrder(law, warp_peri.methods.Smoothing(radius))


def _check_idle(given: Namespace, names: tuple[str, ...], what: str) -> None:
    """Raise InputError for options that have no meaning without something else."""
    if idle := [name for name in names if getattr(given, name) != given.usual[name]]:
        raise InputError(f"{', '.join(idle)}: expected with {what}")


def _metrics(run: Run) -> Values:
    """Collect constants, certificate and errors of a training run."""
    fit, material = run.fit, run.fit.material
    proof = fit.certificate
    metrics = {"units": list(material.units), "certified": False}
    if proof is not None:
        metrics |= {"certified": bool(proof.holds), "statement": proof.statement}
    if fit.loss.reason:
        metrics["loss"] = str(fit.loss)
    names = [name for name in ("mu", "E", "nu", "t3", "tq2", "q3") if hasattr(material, name)]
    metrics |= chosen(material, *names)
    if hasattr(material, "lam"):
        metrics["lambda"] = material.lam
    solid = getattr(material, "linear", material)
    metrics["moduli"] = fit.moduli[0] if fit.moduli else solid.moduli()
    metrics |= {error: run.mean(error) for error in ("E_res", "E_u")}
    metrics["not_evaluated"] = run.refused
    return metrics | (material.provenance if fit.influence is not None else {})


def _first(given: Namespace, metrics: Values, data: Dataset) -> list[str]:
    """Lines on what was learned, its error in one number, and the next command."""
    path, solved, samples = given.out / "model.json", metrics["E_u"], data[given.set]
    kind = f"{KINDS[given.law]}, horizon {given.horizon:g} {symbols(data.units)[0]}"
    known = [name for name in HELD_OUT if solved.get(name) is not None]
    name = next((name for name in known if data[name].spacing == samples.spacing), given.set)
    seen = "loads that the fit did not see" if name != given.set else "the loads of the fit"
    error = "not known" if solved.get(name) is None else f"{100 * solved[name]:.2g} %"
    of = "the linear part has " if given.law == "third-order" else ""
    last = ["solve", path, given.data, "--set", name, "--out", given.out / "solved.h5"]
    return [
        f"{path}: {kind}, learned from {len(samples)} loads",
        f"moduli: {_sheet_of(data)}",
        f"error of displacement: {error} on set {name!r}, {seen}",
        f"proven: {of}{ONE}" if metrics["certified"] else "nothing is proven",
        f"next: warp-peri {shlex.join(map(str, last))}",
    ]


def _sheet_of(data: Dataset) -> str:
    """Describe the sheet's thickness and density, on which stresses depend."""
    size = f"{data.thickness:g} {symbols(data.units)[0]}"
    return f"of a sheet {size} thick, of {data.density:g} kg/m³, as the data file says"


def run_sweep(given: Namespace) -> Said:
    """Run Algorithm 2 on a data file; writes sweep.json and the models to a folder."""
    data = load_dataset(given.data, units=given.units)
    how = chosen(given, "horizons", "degrees", "jobs", "progress")
    named = chosen(given, "test", "noise").items()
    how |= {role: data[name] for role, name in named if name is not None}
    how["law"] = warp_peri.LPS(HORIZON, None, lps_law.GaussNewton(moduli=None))
    sweep = warp_peri.methods.sweep(data[given.set], data[given.val], given.out, **how)
    result = {
        "fits": len(sweep.trials),
        "units": list(data.units),
        "smallest_AvgE": dataclasses.asdict(sweep.printed),
        "cheapest": dataclasses.asdict(sweep.cheapest),
        "moduli": _sheet_of(data),
    }
    with writing(given) as begin:
        begin()
        write_json(given.out / "sweep.json", result)
    return result, lines_of(result)


def run_fit_crystal(given: Namespace) -> Said:
    """Fit a crystal; writes model.json, crystal.json and law.png to a folder."""
    path = given.out / "model.json"
    units = given.units[0] if len(given.units) == 1 else tuple(given.units)
    how = chosen(given, "spacing", "horizon", "symmetry") | {"units": units}
    with writing(given) as begin:  # a place that takes no files is told before the calculator works
        if given.calculator is None:
            _check_idle(given, OF_CALCULATORS, "--calculator")
            constants = warp_peri.atoms.from_phonopy(given.structure, thickness=given.thickness)
            found = warp_peri.atoms.crystal_from_force_constants(constants, **how)
        else:
            structure = dumps.read_structure(given.structure)
            trusted = given.trust or "calculator" not in given.filed
            calculator = warp_peri.atoms.make_calculator(
                given.calculator, list(structure.symbols), given.potential, trusted=trusted
            )
            how |= chosen(given, "thickness", "hold", "supercell")
            found = warp_peri.fit_crystal(structure, calculator, **how)
        begin()
        warp_peri.save(path, found.material)
        write_json(given.out / "crystal.json", finite(found.content()))
        group, wave, proof = found.law.symmetry, found.holds_to["law"], found.certificate
        sheet = found.said.get("thickness")
        lines = [
            f"{path}: elastic crystal model of {given.structure.resolve().name}"
            + (f", point group {group}" if isinstance(group, str) else "")
            + (f"; moduli of a sheet {sheet} thick" if sheet else ""),
            "displacement under waves: error of at most 2 % down to "
            + (f"{wave:.3g} Å" if np.isfinite(wave) else "no wavelength"),
            f"proven: {ONE}" if proof is not None and proof.holds else "nothing is proven",
            f"next: warp-peri info {shlex.quote(str(path))}, or wp.load and wp.solve in Python",
            LINE,
            *repr(found).split("\n")[1:],
        ]
        _save_figure(found.plot(), given.out / "law.png")
    return {**found.content(), "model": str(path)}, lines


def run_fit_sheet(given: Namespace) -> Said:
    """Fit a sheet; writes material.json, sheet.json, curves and every candidate to a folder."""
    how = chosen(given, "pixel", "positions", "stress", "along")
    frames = frames_of_folder(given.folder, given.count, radius=given.smooth, **how)
    usual = frames.points.units == USUAL  # what frames without a unit are taken for
    if given.stress and usual:
        raise InputError("stress: it needs a length; expected --pixel with a unit, as 0.012mm")

    def done(candidate: Any) -> None:
        """Save a candidate as soon as it is fitted."""
        if candidate.fit is None:
            warn(f"passed over: {candidate.why}")
            return
        name = candidate.name.replace(", ", "_").replace(" ", "_")
        begin()
        warp_peri.save(given.out / f"{name}.json", candidate.fit.material)
        if not given.json:
            error = f"error of displacement {100 * candidate.held_out:.3f} %"
            print(candidate.why or f"{candidate.name}: {error}", flush=True)

    with writing(given) as begin:
        choice = warp_peri.hyperelastic.select_model(
            frames, uneven=not given.even, done=done, **chosen(given, "fibres", "progress")
        )
        warp_peri.save(given.out / "material.json", choice[0].fit.material)
        result, shown = _written(given, choice)
        told = {
            "frames": len(frames),
            "interior": int(frames.interior.sum()),
            "noise_in_spacings": float(np.median(estimate_noise(frames)) / frames.spacing),
            "lengths": "as in the tables; no unit was said" if usual else frames.points.units[0],
        }
        result = finite(told | result)
        write_json(given.out / "sheet.json", result)
    path, stress = given.out / "material.json", "; stresses in MPa need a force: --stress"
    first = [
        f"{path}: material of a sheet, {choice[0].name}",
        f"error of displacement: {100 * choice[0].held_out:.2g} % on frames left out",
        shown,
        f"next: warp-peri info {shlex.quote(str(path))}{'' if given.stress else stress}",
    ]
    return result, [*first, LINE, *lines_of(result)]


def _written(given: Namespace, choice: Any) -> tuple[Values, str]:
    """Write a sheet's material and its curves, if any, to files; returns values and words."""
    best, fit, material = choice[0], choice[0].fit, choice[0].fit.material
    told = "are scaled: C11 + C22 + C66 without load is 1, no force is known (--stress gives one)"
    if given.stress:
        told = f"are in MPa by --stress along {given.along}; sections and frames scatter by "
        told += f"{100 * fit.scatter:.2g} % around it"
    words = [*warp_peri.hyperelastic.in_words(material), *_beside(fit)]
    words.append(f"stresses and coefficients {told}")
    try:
        warp_peri.hyperelastic.save_febio(material, given.out / "material.feb")
        words.append("material.feb carries all but the deviations and the thickness")
    except InputError as error:
        words.append(f"no file for FEBio: {error}")
    stretches = np.arange(1.0, max(1.05, material.stretch or 1.2) + 1e-9, STEP)[1:]
    shown = f"curves: {given.out / 'curves.png'}, stress over stretch with a 90 % band"
    try:
        curves = {f"{a:g} deg": best.curves(stretches, np.radians(a)) for a in (0, 45, 90)}
        _write_curves(given.out, stretches, curves, "MPa" if given.stress else "scaled")
    except InputError as error:
        words.append(shown := f"no curves: {error}")
    result = {
        "stresses": told,
        "material": best.name,
        "words": words,
        "held_out_E_u": {one.name: one.held_out for one in choice if np.isfinite(one.held_out)},
        "passed_over": [one.why for one in choice if one.why],
        "largest_stretch": float(material.stretch or np.nan),
    }
    return result, shown


def _beside(fit: Any) -> list[str]:
    """Lines on a sheet's other values: deviations, which are the lattice's, a thickness."""
    own = fit.material.coefficients[: fit.material.dictionary.first_term]
    lines = [f"deviations, which belong to the lattice: {', '.join(f'{v:.4g}' for v in own)}"]
    if fit.thickness is not None:
        pairs = zip(fit.thickness.names, fit.thickness.numbers)
        shown = ", ".join(f"{name}: {value:.4g}" for name, value in pairs)
        lines.append(f"logarithm of the thickness, positions from -1 to 1: {shown}")
    return lines


def _write_curves(folder: Path, stretches: ndarray, curves: Values, unit: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    columns, names, ends = [stretches], ["stretch"], []
    for (name, band), style in zip(curves.items(), ("-", "--", ":")):
        middle, low, high = band  # which may coincide with another's
        (line,) = axes.plot(stretches, middle, linestyle=style, label=name)
        axes.fill_between(stretches, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
        columns += band
        names += [f"{part} {name}" for part in ("P", "low", "high")]
        ends.append(middle[-1])
    said = f"Directions differ by {100 * (max(ends) / min(ends) - 1):.1f} % in stress"
    axes.set(xlabel="stretch", ylabel=f"nominal stress [{unit}]", title=said)
    axes.legend(frameon=False, title="tension along\n(90 % bands)")
    _save_figure(figure, folder / "curves.png")
    with whole_file(folder / "curves.csv") as path:
        np.savetxt(path, np.transpose(columns), "%.8g", ",", header=",".join(names), comments="")


def _save_figure(figure: Any, path: Path) -> None:
    with whole_file(path) as part:
        figure.savefig(part, dpi=110)
