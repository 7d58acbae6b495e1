"""`dic`: frames of image correlation to a sheet's material, its curves, and a file for FEBio."""

from __future__ import annotations

import argparse
import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri
from warp_peri.cli.settings_file import keep
from warp_peri.errors import InputError
from warp_peri.files.atomic import finite, locked, whole_file, write_json, write_text
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import USUAL
from warp_peri.sources.dic import frames_of_folder, noise_of

NO_FORCE = "are scaled: C11 + C22 + C66 at rest is 1, no force is known (--stress gives one)"
UNSAID = "as in the tables; no unit was said"
FITS = "fits"
"""Of the folder, where a second start goes on from."""
STEP, PRINTED, ROWS = 0.025, 4, 8
"""Of the stretch in curves; every fourth of them is printed, or fewer, for at most so many rows."""


def run_dic(given: argparse.Namespace) -> dict[str, Any]:
    """Frames → material.json, curves.csv, curves.png and every candidate's file, in a folder."""
    if given.stress is not None and not 0 < given.stress < np.inf:
        raise InputError(f"stress: expected a number > 0 [MPa], got {given.stress}")

    frames = frames_of_folder(
        given.folder, given.count, pixel=given.pixel, radius=given.smooth, positions=given.positions
    )
    length_known = frames.points.units != USUAL  # what frames without a unit are taken for
    if given.stress is not None and not length_known:
        raise InputError("stress: it needs a length; expected --pixel with a unit, as 0.012mm")
    failed: list[str] = []

    def done(candidate: Any) -> None:
        """Each is kept as it ends."""
        if candidate.fit is None:
            failed.append(candidate.why)
            warnings.warn(f"passed over: {candidate.why}", stacklevel=2)
            return
        name = candidate.name.replace(", ", "_").replace(" ", "_")
        warp_peri.save(given.out / f"{name}.json", candidate.fit.material)
        if not given.json:
            print(
                f"{candidate.name}: E_u of frames left out {100 * candidate.held_out:.3f} %",
                flush=True,
            )

    with locked(given.out):
        choice = warp_peri.tissue.choose_sheet(
            frames,
            fibres=given.fibres,
            uneven=not given.even,
            folder=given.out / FITS,
            done=done,
            progress=not given.json,
        )

        def scaled(fit: Any) -> Any:
            return fit.material if given.stress is None else _scaled(fit, frames, given)

        material = scaled(choice.fit)
        warp_peri.save(given.out / "material.json", material)
        told = NO_FORCE if given.stress is None else "are in MPa, by the stress that was given"
        words = [*warp_peri.tissue.in_words(material), *_beside(choice.fit, material)]
        words.append(f"stresses and coefficients {told}")
        try:
            warp_peri.tissue.save_febio(material, given.out / "material.feb")
            words.append("material.feb carries all but the deviations and the thickness")
        except InputError as error:
            words.append(f"no file for FEBio: {error}")
        top = max(1.05, material.stretch or 1.2)
        stretches = np.arange(1.0, top + 1e-9, STEP)[1:]
        try:
            curves = {
                f"{a:g} deg": choice.curves(stretches, np.radians(a), scaled=scaled)
                for a in (0, 45, 90)
            }
            _write_curves(given.out, stretches, curves, "MPa" if given.stress else "scaled")
        except InputError as error:
            curves = {}
            words.append(f"no curves: {error}")
        each = PRINTED * -(-len(stretches) // (PRINTED * ROWS))
        result = {
            "frames": len(frames),
            "interior": int(frames.interior.sum()),
            "noise_in_spacings": float(np.median(noise_of(frames)) / frames.spacing),
            "lengths": frames.points.units[0] if length_known else UNSAID,
            "stresses": told,
            "material": choice.best.name,
            "words": words,
            "held_out_E_u": {
                c.name: c.held_out for c in choice.candidates if np.isfinite(c.held_out)
            },
            "passed_over": failed,
            "largest_stretch": float(material.stretch or np.nan),
            "tension_with_90_percent_band": {
                f"along {name}": {
                    f"stretch {stretches[n]:g}": [float(value) for value in np.array(curve)[:, n]]
                    for n in range(each - 1, len(stretches), each)
                }
                for name, curve in curves.items()
            },
        }
        result = dict(finite(result))
        write_json(given.out / "dic.json", result)
        keep(given, given.out / "dic.toml")
    return result


def _beside(fit: Any, material: Any) -> list[str]:
    """What is in a sheet beside its material: deviations, which are the lattice's, a thickness."""
    own = slice(material.dictionary.first_deviation, material.dictionary.first_term)
    numbers = ", ".join(f"{value:.4g}" for value in material.coefficients[own])
    lines = [f"deviations, which belong to the lattice: {numbers}"]
    if fit.thickness is not None:
        pairs = zip(fit.thickness.names, fit.thickness.numbers)
        shown = ", ".join(f"{name}: {value:.4g}" for name, value in pairs)
        lines.append(f"logarithm of the thickness, positions from -1 to 1: {shown}")
    return lines


def _scaled(fit: Any, frames: Samples, given: argparse.Namespace) -> Any:
    """The material whose mean stress in the last frame is the one that was given."""
    return warp_peri.tissue.scaled_by_force(
        fit.material,
        Samples(frames.points, frames.u[-1:]),
        np.array([given.stress]),
        width=1.0,
        axis="xy".index(given.along),
        thickness=None if fit.thickness is None else fit.thickness.at(frames.x),
    )


def _write_curves(folder: Path, stretches: np.ndarray, curves: dict[str, Any], unit: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    columns, names = [stretches], ["stretch"]
    for name, (middle, low, high) in curves.items():
        (line,) = axes.plot(stretches, middle, label=name)
        axes.fill_between(stretches, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
        columns += [middle, low, high]
        names += [f"P {name}", f"low {name}", f"high {name}"]
    axes.set(xlabel="stretch", ylabel=f"nominal stress [{unit}]")
    axes.legend(frameon=False, title="tension along")
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=110)
    with whole_file(folder / "curves.png") as path:
        path.write_bytes(drawn.getvalue())
    rows = "\n".join(",".join(f"{value:.8g}" for value in row) for row in np.array(columns).T)
    write_text(folder / "curves.csv", ",".join(names) + "\n" + rows + "\n")
