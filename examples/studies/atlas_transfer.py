"""Stability atlas: what a transfer to other lattices and to scattered points cannot give."""

import warnings
from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import warp_peri
from examples.studies.atlas_entry import Entry, words, written
from warp_peri import Model, Points
from warp_peri.statics.scattered import ThroughLattice
from warp_peri.transfer.lattice import home_of, new_lattice
from warp_peri.transfer.waves import dispersion, rings, wave_errors

SPACINGS = (2.5, 4.0, 7.5, 10.0)
WAVELENGTHS = np.geomspace(200, 12, 60)
"""[Å]"""
CARRIED = 4.0
"""Spacing [Å] on which K is also taken as it is."""
LONG, SHORT = 100.0, 25.0
"""Waves [Å] whose errors are named."""
NODES, SHIFT = 5.0, 0.3
"""Spacing [Å] of the scattered nodes, and how far they are shifted, in spacings."""


def transfers(model: Model) -> Entry:
    """Errors against home by wavelength: carried as it is, transferred, and beyond the data."""
    home = home_of(model, CARRIED)
    k = 2 * np.pi / WAVELENGTHS
    target = dispersion(model, home.spacing, rings(k))

    def errors(other: Model, spacing: float) -> np.ndarray:
        """Of the worst direction at each wavelength; NaN where the lattice carries none."""
        worst = wave_errors(dispersion(other, spacing, rings(k)), target).max(axis=1)
        return np.where(k < np.pi / spacing, worst, np.nan)

    curves = {f"{CARRIED:g} Å, K as it is": errors(model, CARRIED)}
    for spacing in SPACINGS:
        there = new_lattice(model, spacing=spacing)
        curves[f"{spacing:g} Å, δ = {there.horizon:.3g} Å"] = errors(there, spacing)
    named = {
        label: [_near(curve, length) for length in (LONG, SHORT)] for label, curve in curves.items()
    }
    carried, *_, coarse = named.values()
    return Entry(
        *written(
            "transfer",
            shortest=2 * np.pi / home.largest,
            long=LONG,
            short=SHORT,
            carried=100 * carried[0],
            transferred=100 * list(named.values())[SPACINGS.index(CARRIED) + 1][0],
            coarse_long=100 * coarse[0],
            coarse_short=100 * coarse[1],
            smallest=warp_peri.certify(model, spacing=CARRIED).symbol_min,
        ),
        [
            words(lambda: new_lattice(model, spacing=SPACINGS[0], shortest_wave=10.0)),
            words(lambda: new_lattice(model, spacing=SPACINGS[-1], tolerance=1e-3)),
            words(lambda: through(model, 8)),
            words(lambda: model.on(nodes(20), allow_uncertified=True)),
        ],
        draw(curves, 2 * np.pi / home.largest),
        {"wavelength": WAVELENGTHS, "error": curves},
    )


def _near(curve: np.ndarray, wavelength: float) -> float:
    """A curve's value at a wavelength."""
    return float(np.interp(1 / wavelength, 1 / WAVELENGTHS, curve))


def nodes(half: int, interior: float = 20.0) -> Points:
    """Scattered nodes, `half` spacings to all sides of an interior of that half width [Å]."""
    lattice = np.argwhere(np.ones(2 * [2 * half + 1])) - half
    shift = np.random.default_rng(0).uniform(-SHIFT, SHIFT, lattice.shape)
    x = NODES * (lattice + shift)
    return Points(x, np.abs(x).max(axis=1) <= interior, 0.0)


def through(model: Model, half: int) -> ThroughLattice:
    """The operator on scattered nodes whose collar is as wide as `half` leaves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the transfer says so
        return ThroughLattice(model, nodes(half))


def draw(curves: Mapping[str, np.ndarray], shortest: float) -> Figure:
    """Errors by wavelength, with the shortest wave of the data."""
    figure, ax = plt.subplots(figsize=(6.8, 4.2), layout="constrained")
    for number, (label, curve) in enumerate(curves.items()):
        ax.loglog(WAVELENGTHS, 100 * curve, "k--" if number == 0 else "-", label=label)
    ax.axvspan(WAVELENGTHS.min(), shortest, color="0.9", label="beyond the data")
    ticks = (12, 20, 30, 50, 100, 200)
    ax.set_xticks(ticks, [f"{tick}" for tick in ticks])
    ax.minorticks_off()
    ax.set(xlabel="wavelength [Å]", ylabel="displacement against home [%]", ylim=(0.1, 3000))
    ax.legend(frameon=False, fontsize=8)
    return figure
