"""A learned law as JSON, with its units: `warp_peri.flow_law`, version 1."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.flow.cloud import OUTSIDE, Gradients
from warp_peri.flow.gaussian_process import KERNELS, GaussianProcess
from warp_peri.flow.law_content import FORMAT, UNITS, VERSION
from warp_peri.flow.rate_law import RateLaw
from warp_peri.flow.shear_law import ShearLaw
from warp_peri.flow.spring_law import SpringLaw
from warp_peri.flow.twisted_law import TwistedSpringLaw

KINDS = {
    "rate": RateLaw,
    "shear": ShearLaw,
    "spring": SpringLaw,
    "twisted": TwistedSpringLaw,
}


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
        known = {"provenance": dict(content["provenance"])}
        if outside not in OUTSIDE:
            raise ValueError(f"outside {outside!r}")
        numbers = content.get("gradients")  # files of before have none
        gradients = None if numbers is None else Gradients(*map(float, numbers))
        if head["kind"] == "rate":
            first, second, third = processes
            return RateLaw((first, second, third), kinematics, outside, **known)
        if head["kind"] == "twisted":
            spring, turn, excess = processes
            base = SpringLaw(spring, outside, gradients)
            law = TwistedSpringLaw(base, turn, excess, float(content["b"]), **known)
            _ = law.twin  # an InputError where b is none
            return law
        (process,) = processes
        if head["kind"] == "shear":
            return ShearLaw(process, kinematics, outside, **known)
        return SpringLaw(process, outside, gradients, **known)
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: its numbers do not fit together ({error})") from None


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
