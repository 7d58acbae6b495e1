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
from warp_peri.files.atomic import locked, whole_file, write_json, write_text
from warp_peri.sources.dic import frames_of_folder, noise_of


def run_dic(given: argparse.Namespace) -> dict[str, Any]:
    """Frames → material.json, curves.csv, curves.png and every candidate's file, in a folder."""
    from warp_peri.tissue import choose_sheet, in_words, save_febio

    frames = frames_of_folder(given.folder, given.count, pixel=given.pixel, radius=given.smooth)
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
        choice = choose_sheet(
            frames, fibres=given.fibres, uneven=not given.even, done=done, progress=not given.json
        )
        material = choice.material
        warp_peri.save(given.out / "material.json", material)
        words = in_words(material)
        try:
            save_febio(material, given.out / "material.feb")
            words.append("material.feb carries all but the deviations and the thickness")
        except InputError as error:
            words.append(f"no file for FEBio: {error}")
        top = max(1.05, material.stretch or 1.2)
        stretches = np.linspace(1.0, top, 25)[1:]
        curves = {f"{a:g} deg": choice.curves(stretches, np.radians(a)) for a in (0, 45, 90)}
        _write_curves(given.out, stretches, curves)
        result = {
            "frames": len(frames),
            "interior": int(frames.interior.sum()),
            "noise_in_spacings": float(np.median(noise_of(frames)) / frames.spacing),
            "units": list(material.units),
            "material": choice.best.name,
            "words": words,
            "held_out_E_u": {
                c.name: c.held_out for c in choice.candidates if np.isfinite(c.held_out)
            },
            "passed_over": failed,
            "largest_stretch": float(material.stretch or np.nan),
        }
        write_json(given.out / "dic.json", result)
        keep(given, given.out / "dic.toml")
    return result


def _write_curves(folder: Path, stretches: np.ndarray, curves: dict[str, Any]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    columns, names = [stretches], ["stretch"]
    for name, (middle, low, high) in curves.items():
        (line,) = axes.plot(stretches, middle, label=name)
        axes.fill_between(stretches, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
        columns += [middle, low, high]
        names += [f"P {name}", f"low {name}", f"high {name}"]
    axes.set(xlabel="stretch", ylabel="nominal stress / initial stiffness")
    axes.legend(frameon=False, title="tension along")
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=110)
    with whole_file(folder / "curves.png") as path:
        path.write_bytes(drawn.getvalue())
    rows = "\n".join(",".join(f"{value:.8g}" for value in row) for row in np.array(columns).T)
    write_text(folder / "curves.csv", ",".join(names) + "\n" + rows + "\n")
