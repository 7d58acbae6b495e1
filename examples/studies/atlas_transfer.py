"""Stability atlas: what a transfer, a family, and a supercell cannot give."""

from typing import Any

import ase.build
import numpy as np
from ase.calculators.emt import EMT

import warp_peri as wp
from examples.figures import curves, note, panels, ticks
from examples.studies.atlas_entry import Entry, entry
from warp_peri import Model, Points
from warp_peri.core.elastic import voigt
from warp_peri.points.samples import part
from warp_peri.prediction import Family
from warp_peri.transfer.lattice import dispersion, home_of, new_lattice, rings, wave_errors

SPACINGS = (2.5, 4.0, 7.5, 10.0)
WAVELENGTHS = np.geomspace(200, 12, 60)
"""[Å]"""
CARRIED = 4.0
"""Spacing [Å] on which K is also taken as it is."""
LONG, SHORT = 100.0, 25.0
"""Waves [Å] whose errors are named."""
NODES, SHIFT = 5.0, 0.3
"""Spacing [Å] of the scattered nodes, and how far they are shifted, in spacings."""
LEARNED = 45.0
"""Waves that the family learns from are longer [Å]."""
REPEATS = (2, 3, 4, 5, 6, 7)


def transfers(model: Model) -> Entry:
    """Errors against home by wavelength: carried as it is, transferred, and beyond the data."""
    home = home_of(model, CARRIED)
    k = 2 * np.pi / WAVELENGTHS
    target = dispersion(model, home.spacing, rings(k))

    def errors(other: Model, spacing: float) -> np.ndarray:
        """Of the worst direction at each wavelength; NaN where the lattice carries none."""
        worst = wave_errors(dispersion(other, spacing, rings(k)), target).max(axis=1)
        return np.where(k < np.pi / spacing, worst, np.nan)

    table = {f"{CARRIED:g} Å, K as it is": errors(model, CARRIED)}
    for spacing in SPACINGS:
        there = new_lattice(model, spacing=spacing)
        table[f"{spacing:g} Å, δ = {there.horizon:.3g} Å"] = errors(there, spacing)
    named = [
        [100 * float(np.interp(1 / length, 1 / WAVELENGTHS, curve)) for length in (LONG, SHORT)]
        for curve in table.values()
    ]
    shortest = 2 * np.pi / home.largest
    numbers = {
        "shortest": shortest, "long": LONG, "short": SHORT, "carried": named[0][0],
        "transferred": named[SPACINGS.index(CARRIED) + 1][0],
        "coarse_long": named[-1][0], "coarse_short": named[-1][1],
        "smallest": wp.certify(model, spacing=CARRIED).symbol_min,
    }  # fmt: skip
    seen = (
        lambda: new_lattice(model, spacing=SPACINGS[0], shortest_wave=10.0),
        lambda: new_lattice(model, spacing=SPACINGS[-1], tolerance=1e-3),
        lambda: model.on(nodes(20), allow_uncertified=True),
    )
    figure, ax = panels(6.8, 4.2)
    axes: dict[str, Any] = {"xlabel": "wavelength [Å]", "xlim": (210, 11), "ylim": (0.1, 3000)}
    axes["ylabel"] = "displacement against the model's own [%]"
    styles = ["k--"] + ["-"] * len(SPACINGS)
    curves(ax, "loglog", WAVELENGTHS, table, *styles, scale=100, **axes)
    ax.axvspan(WAVELENGTHS.min(), shortest, color="0.9")
    note(ax, "beyond the data", (shortest, 0.1), (-4, 4), ha="right")
    ticks(ax, (12, 20, 30, 50, 100, 200))
    values = {"wavelength": WAVELENGTHS, "error": table}
    return entry("transfer", numbers, seen, figure, values)


def nodes(half: int, interior: float = 20.0) -> Points:
    """Scattered nodes, `half` spacings to all sides of an interior of that half width [Å]."""
    lattice = np.argwhere(np.ones(2 * [2 * half + 1])) - half
    shift = np.random.default_rng(0).uniform(-SHIFT, SHIFT, lattice.shape)
    x = NODES * (lattice + shift)
    return Points(x, np.abs(x).max(axis=1) <= interior, 0.0)


def short_waves(data: wp.Dataset) -> Entry:
    """Likely and true errors of waves that are shorter than all that an ensemble learned from."""
    train = data["train"]
    problem = wp.Dirichlet(train.points, train.loads, train.u)
    length = 2 * np.pi / np.asarray(train.arrays["wave_number"])
    seen = np.flatnonzero(length >= LEARNED)
    law = wp.Micromodulus(15.0, "4mm", moduli="long waves")
    family = wp.fit(part(train, seen), Family(law), progress=False).material
    answers = wp.predict(family, problem, None)
    assert isinstance(answers, tuple)
    inside = train.interior
    true = np.array(
        [
            np.linalg.norm((a.u - u)[inside]) / np.linalg.norm(u[inside])
            for a, u in zip(answers, train.u)
        ]
    )
    told = np.array([answer.error for answer in answers])
    ratio, short, unknown = told / true, length < LEARNED, np.isnan(told)
    figure, ax = panels()
    ax.semilogy(length[~unknown], 100 * told[~unknown], "C0o", label="likely error")
    ax.semilogy(length[~unknown], 100 * true[~unknown], "k.", label="true error")
    ax.semilogy(length[unknown], 100 * true[unknown], "C3x", label="true, likely error unknown")
    ax.set(xlabel="wavelength [Å]", ylabel="error of displacement [%]")
    ax.legend(frameon=False)
    worst = int(np.argmax(np.where(unknown, true, 0.0)))
    numbers = {
        "long": LEARNED, "loads": len(seen), "covered": 100 * float(np.mean(ratio[~short] >= 1)),
        "least": float(ratio[~short].min()), "short": int(np.count_nonzero(short)),
        "unknown": int(np.count_nonzero(short & unknown)), "worst": 100 * float(true[worst]),
        "low": int(np.count_nonzero(short & (ratio < 1))),
    }  # fmt: skip
    # The second is a law that is no family.
    told_of = (answers[worst].why, lambda: wp.predict(family.rich, problem))
    values = {"wavelength": length.tolist(), "true": true.tolist(), **numbers}
    return entry("predictions", numbers, told_of, figure, values)


def narrow_supercells() -> Entry:
    """Moduli of copper from supercells of several widths; simple cubic copper is no minimum."""
    off = {}
    for n in REPEATS:
        found = wp.from_atoms(ase.build.bulk("Cu"), EMT(), supercell=(n, n, n))
        assert found.strained is not None
        law, true = voigt(found.tensor), voigt(found.strained)
        off[n**3] = float(100 * np.abs(law - true).max() / np.abs(true).max())
    figure, axes = panels(4.8, 3.4)
    axes.loglog(list(off), list(off.values()), "o-")
    axes.set(xlabel="atoms of the supercell", ylabel="error of the moduli [%]")
    least, middle, most = min(off), REPEATS[2] ** 3, max(off)
    numbers = {"worst": off[least], "half": off[middle], "good": off[most]}
    numbers |= {"least": least, "middle": middle, "most": most}
    cubic = ase.build.bulk("Cu", "sc", a=2.4)
    seen = (lambda: wp.from_atoms(cubic, EMT(), supercell=(4, 4, 4)),)
    values = {"atoms": list(off), "off": list(off.values())}
    return entry("supercell", numbers, seen, figure, values)
