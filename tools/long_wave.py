"""Elastic constants from the response to the longest waves: the truth at a finite temperature."""

from collections.abc import Sequence

import numpy as np

from tools.elastic import lame_constants
from tools.graphene import THICKNESS, area_per_atom
from tools.loads import Load, WaveLoad
from tools.samples import Piece
from warp_peri.sources.coarse_graining import EV_PER_CUBIC_ANGSTROM

LONGEST = 2
"""Loads with p₁² + p₂² up to this count as long waves."""


def long_wave_constants(
    body: Piece,
    reference: np.ndarray,
    loads: Sequence[Load],
    displacement: np.ndarray,
    force: np.ndarray,
) -> dict[str, float]:
    """λ and μ of the isotropic solid that answers the longest WaveLoads as the atoms do.

    A load B cos k₁x cos k₂y along x moves such a solid by u = (U cos cos, V sin sin) with
    ((λ+2μ) k₁² + μ k₂²) U − (λ+μ) k₁k₂ V = B and (μ k₁² + (λ+2μ) k₂²) V = (λ+μ) k₁k₂ U. U, V and B
    are least-squares amplitudes over the atoms; λ and μ solve all these equations, relative to B,
    in the least-squares sense.

    Args:
        body: a periodic sheet.
        reference: of the atoms [Å], shape [A, 2].
        loads: of the samples; one of the longest waves at least.
        displacement, force: of the atoms [Å] and [eV/Å], shape [S, A, 2].

    Returns:
        `lambda`, `mu`, `E` [TPa] for the thickness THICKNESS, and `nu`.

    Raises ValueError without a long wave or without a box.
    """
    if body.box is None:
        raise ValueError("body: expected a periodic sheet")
    density = force * (EV_PER_CUBIC_ANGSTROM / (area_per_atom(body.bond) * THICKNESS))
    rows, right = [], []
    for load, u, b in zip(loads, displacement, density):
        if not isinstance(load, WaveLoad) or np.square(load.waves).sum() > LONGEST:
            continue
        k = load.wave_vector(body.box)
        cos, sin = np.cos(k * reference).prod(axis=1), np.sin(k * reference).prod(axis=1)
        along, across = load.axis, 1 - load.axis
        B, U = b[:, along] @ cos / (cos @ cos), u[:, along] @ cos / (cos @ cos)
        V = u[:, across] @ sin / (sin @ sin) if k.all() else 0.0
        own, other, mixed = k[along] ** 2, k[across] ** 2, k.prod()
        rows.append([own * U - mixed * V, (2 * own + other) * U - mixed * V])
        right.append(B)
        rows[-1] = [entry / B for entry in rows[-1]]
        right[-1] = 1.0
        if k.all():
            second = [other * V - mixed * U, (own + 2 * other) * V - mixed * U]
            rows.append([entry / B for entry in second])
            right.append(0.0)
    if not rows:
        raise ValueError(f"loads: expected a WaveLoad with p₁² + p₂² ≤ {LONGEST}")
    lam, mu = np.linalg.lstsq(np.array(rows), np.array(right))[0]
    return lame_constants(float(lam), float(mu))
