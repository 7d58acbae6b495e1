"""Stability atlas: supercells narrower than forces reach, and crystals that are none."""

import ase.build
import matplotlib.pyplot as plt
import numpy as np
from ase.calculators.emt import EMT

import warp_peri
from examples.studies.atlas_entry import Entry, words, written
from warp_peri.core.elastic import voigt

REPEATS = (2, 3, 4, 5, 6, 7)


def narrow_supercells() -> Entry:
    """Moduli of copper from supercells of several widths, and simple cubic copper."""
    off = {}
    for n in REPEATS:
        found = warp_peri.from_atoms(ase.build.bulk("Cu"), EMT(), supercell=(n, n, n))
        assert found.strained is not None
        law, true = voigt(found.tensor), voigt(found.strained)
        off[n**3] = float(100 * np.abs(law - true).max() / np.abs(true).max())
    figure, axes = plt.subplots(figsize=(4.8, 3.4), layout="constrained")
    axes.loglog(list(off), list(off.values()), "o-")
    axes.set(xlabel="atoms of the supercell", ylabel="moduli off finite strains [%]")
    least, middle, most = min(off), REPEATS[2] ** 3, max(off)
    numbers = {"worst": off[least], "half": off[middle], "good": off[most]}
    return Entry(
        *written("supercell", least=least, middle=middle, most=most, **numbers),
        [words(simple_cubic)],
        figure,
        {"atoms": list(off), "off": list(off.values())},
    )


def simple_cubic() -> None:
    """Copper on a lattice that is no minimum of its energy."""
    warp_peri.from_atoms(ase.build.bulk("Cu", "sc", a=2.4), EMT(), supercell=(4, 4, 4))
