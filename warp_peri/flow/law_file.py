"""A learned law as JSON, with its units: `warp_peri.flow_law`, version 1."""

from __future__ import annotations

import json
import os
from dataclasses import astuple
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.flow.cloud import OUTSIDE, Gradients
from warp_peri.flow.gaussian_process import KERNELS, GaussianProcess
from warp_peri.flow.rate_law import RateLaw
from warp_peri.flow.shear_law import ShearLaw
from warp_peri.flow.spring_law import SpringLaw
from warp_peri.flow.twisted_law import TwistedSpringLaw

FORMAT, VERSION = "warp_peri.flow_law", 1
UNITS = {"time": "relaxation time", "stress": "n k T", "conformation": "<q q> of a Hookean at rest"}
KINDS = {
    "rate": RateLaw,
    "shear": ShearLaw,
    "spring": SpringLaw,
    "twisted": TwistedSpringLaw,
}


def save_law(path: str | os.PathLike[str], law: Any, provenance: dict[str, Any]) -> None:
    """Write a learned law, whole or not at all.

    Args:
        path: of the file.
        law: a RateLaw, ShearLaw, SpringLaw or TwistedSpringLaw; tables are made again.
        provenance: what it was learned from; plain values.

    Raises InputError for a law that is not learned.
    """
    kind = next((name for name, cls in KINDS.items() if isinstance(law, cls)), None)
    if kind is None:
        raise InputError(f"law: expected a learned one, got {type(law).__name__}")
    b, base = None, law
    if isinstance(law, TwistedSpringLaw):
        b, base = law.b, law.spring_law
        processes = [base.process, law.process, law.excess]
    else:
        processes = law.processes if kind == "rate" else [law.process]
    content = {"format": FORMAT, "version": VERSION, "kind": kind, "units": UNITS}
    content |= {"outside": base.outside, "kinematics": getattr(law, "kinematics", None), "b": b}
    gradients = getattr(base, "gradients", None)
    content |= {"gradients": None if gradients is None else list(astuple(gradients))}
    content |= {"provenance": provenance, "processes": [vars_of(p) for p in processes]}
    write_json(path, content)


def load_law(
    path: str | os.PathLike[str],
) -> RateLaw | ShearLaw | SpringLaw | TwistedSpringLaw:
    """Read a learned law.

    Raises InputError for a file that cannot be read, of another format or version, in other units,
    or whose numbers do not fit together.
    """
    try:
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
        head = {key: content[key] for key in ("format", "version", "units", "kind")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a law of flow ({error})") from None
    if (head["format"], head["version"]) != (FORMAT, VERSION):
        raise InputError(f"{path}: expected {FORMAT} version {VERSION}, got {head}")
    if head["units"] != UNITS:
        raise InputError(f"{path}: expected the units {UNITS}, got {head['units']}")
    if head["kind"] not in KINDS:
        raise InputError(f"{path}: expected a kind of {', '.join(KINDS)}, got {head['kind']!r}")
    try:
        processes = [process_of(saved) for saved in content["processes"]]
        outside, kinematics = str(content["outside"]), bool(content["kinematics"])
        if outside not in OUTSIDE:
            raise ValueError(f"outside {outside!r}")
        known = content.get("gradients")  # files of before have none
        gradients = None if known is None else Gradients(*map(float, known))
        if head["kind"] == "rate":
            first, second, third = processes
            return RateLaw((first, second, third), kinematics, outside)
        if head["kind"] == "twisted":
            spring, turn, excess = processes
            base = SpringLaw(spring, outside, gradients)
            law = TwistedSpringLaw(base, turn, excess, float(content["b"]))
            _ = law.twin  # an InputError where b is none
            return law
        (process,) = processes
        if head["kind"] == "shear":
            return ShearLaw(process, kinematics, outside)
        return SpringLaw(process, outside, gradients)
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: its numbers do not fit together ({error})") from None


def vars_of(process: GaussianProcess) -> dict[str, Any]:
    """What a process is made of, without what is computed from it."""
    names = GaussianProcess.__dataclass_fields__
    return {name: getattr(process, name) for name in names}


def process_of(content: dict[str, Any]) -> GaussianProcess:
    """The process again. Raises ValueError for shapes that do not fit or numbers not finite."""
    arrays = ("X", "y", "noise", "log_lengths", "centre", "scale")
    values: dict[str, Any] = {
        name: np.array(value, dtype=float) if name in arrays else value
        for name, value in content.items()
    }
    process = GaussianProcess(**values)
    n, d = process.X.shape
    shapes = [process.y.shape, process.noise.shape[:1], process.log_lengths.shape]
    shapes += [process.centre.shape, process.scale.shape]
    if shapes != [(n,), (n,), (d,), (d,), (d,)]:
        raise ValueError(f"shapes {shapes}")
    numbers = [values[name] for name in ("log_amplitude", "log_pairs", "mean", "size")]
    if not all(isinstance(number, (int, float)) for number in numbers):
        raise ValueError(f"numbers {numbers}")
    if not all(np.isfinite(part).all() for part in (*numbers, *(values[a] for a in arrays))):
        raise ValueError("numbers that are not finite")
    if process.kernel not in KERNELS:
        raise ValueError(f"kernel {process.kernel!r}")
    return process
