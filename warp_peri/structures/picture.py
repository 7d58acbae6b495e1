"""A learned crystal in one picture: dispersion, Young's modulus over direction, unseen loads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from warp_peri.structures.learn import LearnedCrystal

PATHS: dict[int, dict[str, tuple[int, ...]]] = {
    2: {"[10]": (1, 0), "[01]": (0, 1), "[11]": (1, 1)},
    3: {"[100]": (1, 0, 0), "[110]": (1, 1, 0), "[111]": (1, 1, 1), "[001]": (0, 0, 1)},
}
"""Directions that are drawn, along the axes of the nodes."""


def picture(found: LearnedCrystal) -> Figure:
    """Acoustic branches, E over direction, and the errors of unseen loads beside the rival's."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    dispersion = figure.add_subplot(1, 3, 1)
    law, d = found.law, found.atoms.dimension
    reach = np.linspace(0.03, 1, 40) * np.pi / 2
    for number, (label, direction) in enumerate(PATHS[d].items()):
        k = reach[:, None] / law.spacing * np.array(direction) / np.linalg.norm(direction)
        branches = (found.atoms.effective, law.symbol, found.local)
        true, own, local = (np.sqrt(1e3 * np.linalg.eigvalsh(D(k)).clip(0)) for D in branches)
        names = [label, *[None] * (d - 1)]
        dispersion.plot(reach, own, color=f"C{number}", label=names)
        dispersion.plot(reach, local, ":", color=f"C{number}", linewidth=0.8)
        dispersion.plot(reach[::3], true[::3], ".", color=f"C{number}")
    dispersion.set(xlabel="|k| h", ylabel="√Λ(k) [√(GPa/Å²)]")
    dispersion.set_title("law (lines), atoms (dots), local (dotted)")
    dispersion.legend(frameon=False)
    polar: Any = figure.add_subplot(1, 3, 2, projection="polar")
    angle, young = found.directional()
    polar.plot(angle, young)
    polar.set_rlim(min(0.0, 1.1 * young.min()), 1.1 * young.max())
    polar.set_rlabel_position(67.5)
    polar.set_title(f"E [GPa], axes 1 and {d}")
    bars = figure.add_subplot(1, 3, 3)
    place = np.arange(len(found.unseen))
    for shift, name in ((-0.2, "law"), (0.2, "local")):
        bars.bar(place + shift, [e[name] for e in found.unseen.values()], 0.38, label=name)
    bars.set_xticks(place, [name.replace(" of ", "\n") for name in found.unseen])
    bars.set(ylabel="E_u [%]", title="loads that the law never saw")
    bars.legend(frameon=False)
    return figure
