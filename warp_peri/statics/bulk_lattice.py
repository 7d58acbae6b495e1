"""The cheapest lattice that a body's bulk can do with (B15)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.mesh import Mesh
from warp_peri.points.unit_names import symbols
from warp_peri.statics.bulk import check_extent
from warp_peri.statics.rim import Field
from warp_peri.transfer.cache import on_lattice
from warp_peri.transfer.lattice import LEAST, TOLERANCE

RATIOS = (2.0, 1.5, 1.0, 0.75, 0.5)
"""Spacings that are tried, over the coarsest that the model is certified on; coarse ones first."""
SHARE = 0.5
"""Of the body's area that lies two horizons inside, at least."""
SAMPLES = 20_000
"""About how many points of the box around a body its depth and its load are looked at."""


@dataclass(frozen=True)
class Tried:
    """A lattice that was looked at.

    Attributes:
        spacing: h [Å].
        horizon: δ of the model there [Å]; the least there can be where that is too much already.
        share: of the body's area that lies two horizons inside.
        wave_error: relative error, against the model at home, of the displacement by waves of the
            length that the load has; NaN where nothing was transferred.
        verdict: "taken", or why not.
    """

    spacing: float
    horizon: float
    share: float
    wave_error: float
    verdict: str


@dataclass(frozen=True)
class _Seen:
    """What a lattice is chosen for: depth of points of the body, its smallest hole [Å], the wave
    number of its load [1/Å] and the overlap, None for two horizons."""

    depth: np.ndarray
    hole: float
    wave_number: float
    overlap: float | None

    def share(self, horizon: float) -> float:
        return float(np.mean(self.depth > 2 * horizon))

    def refusal(self, horizon: float) -> str:
        """Why a horizon is too large for the body; empty where it is not."""
        if self.hole < (2 * horizon if self.overlap is None else self.overlap):
            return "a hole is smaller than the overlap"
        if self.share(horizon) < SHARE:
            return f"only {self.share(horizon):.0%} of the body is two horizons inside"
        return ""


def bulk_lattice(
    model: Model, mesh: Mesh, b: Field | None, overlap: float | None
) -> tuple[Model, tuple[Tried, ...]]:
    """The model on the coarsest lattice that resolves the loads and the body, and the search.

    The loads are resolved where waves as long as those of the body force, by its mean square
    slope, agree with the model at home to the tolerance of a transfer. The body is where half of
    its area lies two horizons inside, and no hole is smaller than the overlap. Where no lattice
    does, the finest is taken, with a warning when it is for the loads.

    Args:
        model: certified on some lattice.
        mesh: of the body.
        b: body force density [TPa/Å] as a function of positions; None for none.
        overlap: of rim and bulk [Å]; None for two horizons.

    Returns:
        The model on the lattice that was chosen, and what was tried; the last is what was taken.

    Raises InputError for a model that is certified on no lattice, or a mesh that is not in Å.
    """
    if not model.certified_on:
        raise InputError(
            "model: expected one that is certified on a lattice, which others are fitted to; "
            "this one is certified on none"
        )
    home = max(model.certified_on)
    check_extent(mesh, home, model.units)
    depth, wave_number = _depth_and_wave_number(mesh, b)
    seen = _Seen(depth, float(mesh.hole_sizes.min(initial=np.inf)), wave_number, overlap)
    tried: list[Tried] = []
    for ratio in RATIOS:
        last = ratio == RATIOS[-1]
        attempt, here = _attempt(model, home * ratio, seen, wanted=last)
        if here is not None and (last or attempt.verdict == "taken"):
            if wave_number and attempt.wave_error > TOLERANCE:
                unit = symbols(model.units)[0]
                warnings.warn(
                    f"b: waves of {2 * np.pi / wave_number:.3g} {unit} are not resolved to "
                    f"{TOLERANCE:.1%} on the lattice of {attempt.spacing:g} {unit}, the finest",
                    stacklevel=3,
                )
            return here, (*tried, attempt)
        tried.append(attempt)
    raise InputError(f"model: {tried[-1].verdict}; give a spacing")


def _attempt(
    model: Model, spacing: float, seen: _Seen, *, wanted: bool
) -> tuple[Tried, Model | None]:
    """One lattice, and the model there; None where it does not get so far, unless it is wanted."""
    least = LEAST * spacing
    refusal = seen.refusal(least)
    if refusal and not wanted:
        return Tried(spacing, least, seen.share(least), np.nan, refusal), None
    try:
        here = on_lattice(model, spacing=spacing)
    except InputError as error:
        return Tried(spacing, least, seen.share(least), np.nan, str(error)), None
    if model.is_certified_on(spacing) and here.horizon >= model.horizon * (1 - 1e-9):
        here, wave_error = model, 0.0  # fewer bonds do not serve: no copy of what is there
    else:
        wave_error = _wave_error(here, seen.wave_number)
    refusal = seen.refusal(here.horizon)
    if not refusal and wave_error > TOLERANCE:
        refusal = "the waves of the load are not resolved"
    share = seen.share(here.horizon)
    return Tried(spacing, here.horizon, share, wave_error, refusal or "taken"), here


def _wave_error(model: Model, wave_number: float) -> float:
    """Largest error of waves as long, or longer, that the transfer's record knows."""
    record = model.provenance["transfer"]
    numbers = 2 * np.pi / np.array(record["wavelength"])
    errors = np.maximum.accumulate(record["error"])
    return float(np.interp(wave_number, numbers, errors, right=np.inf))


def _depth_and_wave_number(mesh: Mesh, b: Field | None) -> tuple[np.ndarray, float]:
    """Distance of points of a body from its outline [Å], and √(Σ |∇b|² / Σ |b|²) of its load."""
    low, high = mesh.x.min(axis=0), mesh.x.max(axis=0)
    step = float(np.sqrt(np.prod(high - low) / SAMPLES))
    axes = [np.arange(start + step / 2, end, step) for start, end in zip(low, high)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    held = mesh.holding(grid.reshape(-1, 2)) >= 0
    depth = mesh.distance(grid.reshape(-1, 2)[held], step / 10)
    if b is None:
        return depth, 0.0
    x = grid.reshape(-1, 2)[held]
    size = float(np.square(b(x)).sum())
    slopes = [(b(x + d) - b(x - d)) / step for d in step / 2 * np.eye(2)]
    slope = float(sum(np.square(s).sum() for s in slopes))
    return depth, float(np.sqrt(slope / size)) if size else 0.0
